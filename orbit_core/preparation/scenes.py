"""What is done to a scene before an engine sees it."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from orbit_assets.decomposition import decomposed_entity, decomposed_shapes
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import validate_entity
from orbit_core.scene import Entity, Scene

_EntityType = TypeVar("_EntityType", bound=Entity)


def prepared(scene: Scene) -> Scene:
    """The scene with every articulation checked, and links that cannot move against each other made one."""
    return replace(
        scene,
        robots=tuple(_prepared_entity(entity) for entity in scene.robots),
        objects=tuple(_prepared_entity(entity) for entity in scene.objects),
        terrain=decomposed_shapes(scene.terrain, "the terrain"),
    )


def _prepared_entity(entity: _EntityType) -> _EntityType:
    validate_entity(entity)
    return decomposed_entity(replace(entity, articulation=merge_fixed_links(entity.articulation)))
