"""Preparation of a whole scene: articulations checked, fixed links merged, meshes split into convex pieces."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from typing import TypeVar

from orbit_core.installing import install_command
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import validate_entity
from orbit_core.registry import Registry
from orbit_core.scene import Articulation, Entity, Mesh, MeshCollision, ObjectSpec, Scene, Shape

_EntityType = TypeVar("_EntityType", bound=Entity)
Decomposition = Callable[..., tuple[Mesh, ...]]
"""Takes a mesh, and its name for messages as ``where``; gives convex pieces in the mesh's frame."""


def prepared(scene: Scene) -> Scene:
    """Return the scene with every articulation checked, and links that cannot move against each other made one.

    Meshes that ask for convex pieces are replaced by them.

    Raises:
        AssetError: no body can be so, or a mesh cannot be split.
    """
    return replace(
        scene,
        robots=tuple(_prepared_entity(entity) for entity in scene.robots),
        objects=tuple(_prepared_entity(entity) for entity in scene.objects),
        terrain=decomposed_shapes(scene.terrain, "the terrain"),
    )


def decomposed_shapes(shapes: tuple[Shape, ...], where: str) -> tuple[Shape, ...]:
    """Return the shapes, with the pieces of each mesh that asks for them in its place.

    Raises:
        AssetError: a mesh cannot be split, or no installed package splits meshes.
    """
    # Splitting is slow and its library optional: neither is touched without need.
    if not any(_asks(shape) for shape in shapes):
        return shapes
    return tuple(piece for shape in shapes for piece in _pieces_of(shape, where))


def decomposed_entity(entity: _EntityType) -> _EntityType:
    """Return the entity, and its variants, with the pieces of each colliding mesh that asks for them in its place.

    Raises:
        AssetError: as :func:`decomposed_shapes`.
    """
    if isinstance(entity, ObjectSpec) and entity.variants:
        variants = tuple(_decomposed(variant, entity.name) for variant in entity.variants)
        entity = replace(entity, variants=variants)
    return replace(entity, articulation=_decomposed(entity.articulation, entity.name))


@cache
def decompositions() -> Registry[Decomposition]:
    """Return what splits meshes, by name, from the entry-point group ``orbit.decompositions``; the first is used."""
    return Registry[Decomposition]("decomposition", "orbit.decompositions")


def _prepared_entity(entity: _EntityType) -> _EntityType:
    # Validated before links are merged, so that messages name the links of the file.
    validate_entity(entity)
    return decomposed_entity(replace(entity, articulation=merge_fixed_links(entity.articulation)))


def _decomposed(articulation: Articulation, name: str) -> Articulation:
    if not any(_asks(shape) for link in articulation.links for shape in link.collisions):
        return articulation
    links = tuple(
        replace(link, collisions=decomposed_shapes(link.collisions, f"link '{link.name}' of '{name}'"))
        for link in articulation.links
    )
    return replace(articulation, links=links)


def _asks(shape: Shape) -> bool:
    return isinstance(shape.geometry, Mesh) and shape.geometry.collision is MeshCollision.CONVEX_DECOMPOSITION


def _pieces_of(shape: Shape, where: str) -> Iterator[Shape]:
    if not (isinstance(shape.geometry, Mesh) and _asks(shape)):
        yield shape
        return
    named = f"mesh '{shape.name}' of {where}" if shape.name else f"a mesh of {where}"
    names = decompositions().names
    if not names:
        raise AssetError(
            f"{named} asks for convex pieces, which the distribution orbit-assets makes: "
            f"{install_command('orbit-assets')}, or have the mesh collide as its hull"
        )
    # Numbered names, since the names of shapes in a link must differ.
    for number, piece in enumerate(decompositions().get(names[0])(shape.geometry, where=named)):
        yield replace(shape, geometry=piece, name=f"{shape.name}_{number}" if shape.name else "")
