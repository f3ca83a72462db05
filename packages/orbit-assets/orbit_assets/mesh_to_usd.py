"""Mesh files as one rigid body: visual and collision shapes, mass and friction."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from orbit_assets.mass_properties import mass_properties
from orbit_assets.meshes import MeshPart, load_mesh, load_parts
from orbit_assets.naming import names_file
from orbit_assets.options import ReadOptions
from orbit_assets.usd import write_usd
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.validation import validate
from orbit_core.scene import Articulation, Link, Mesh, MeshCollision, PhysicsMaterial, Pose, Shape

# Formats that have y up by their specification.
_Y_UP = (".glb", ".gltf")
# Density (kg/m^3) of an object for which the caller gives none.
_SOFT_WOOD = 500.0


@dataclass(frozen=True, kw_only=True)
class MeshBody:
    """Properties of a rigid body that its mesh file does not describe."""

    friction: float = 1.0
    """Static and dynamic."""
    restitution: float = 0.0
    density: float | None = None
    """kg/m^3; 500, that of soft wood, where neither it nor the mass is given."""
    mass: float | None = None
    """kg; overrides the density."""
    collision: MeshCollision = MeshCollision.CONVEX_HULL
    scale: float = 1.0
    """Metres of one unit of the file, on top of a unit that the file itself names."""
    up: Literal["y", "z"] | None = None
    """The file's up axis; y for glTF, z for others, where it is left out."""


@names_file
def mesh_articulation(
    path: Path | str, body: MeshBody = MeshBody(), *, options: ReadOptions = ReadOptions()
) -> Articulation:
    """Build one rigid body with the surface of an OBJ, STL, glTF or other mesh file, z up, its frame the file's own.

    The whole mesh collides as one shape; what is drawn has a shape for each colour of the file. Mass is spread evenly
    over the volume within the mesh, or over that of its hull where it is not closed.

    Raises:
        AssetError: the file cannot be read, the mesh encloses no volume, or a number cannot be.
    """
    path = Path(path)
    for name in ("friction", "restitution", "density", "mass", "scale"):
        _check(name, getattr(body, name), may_be_zero=name in ("friction", "restitution"))
    scale = (body.scale, body.scale, body.scale)
    upright = Pose() if (body.up or ("y" if path.suffix.lower() in _Y_UP else "z")) == "z" else _Y_TO_Z
    whole = _upright(load_mesh(path, scale, options=options), upright)
    parts = load_parts(path, scale, options=options)
    material = PhysicsMaterial(body.friction, body.friction, restitution=body.restitution)
    # A mass overrides the density: with both given, the density is not used.
    density = (body.density or _SOFT_WOOD) if body.mass is None else None
    properties = mass_properties(whole, mass=body.mass, density=density)
    solid = Shape(replace(whole, collision=body.collision), material=material, name="collision")
    visuals = tuple(_visual(part, upright, number) for number, part in enumerate(parts, start=1))
    notes = (f"mesh {path.name} is one rigid body of {properties.mass:.4g} kg",)
    if any(part.textured for part in parts):
        notes = (*notes, "textures are left out: the median colour of each replaces it")
    link = Link(path.stem, properties.mass, properties.center_of_mass, properties.inertia, (solid,), visuals)
    return validate(Articulation(path.stem, (link,), notes=notes))


def mesh_to_usd(
    path: Path | str, out: Path | str, body: MeshBody = MeshBody(), *, options: ReadOptions = ReadOptions()
) -> tuple[str, ...]:
    """Write a mesh file as a rigid body to USD; return changes and losses, a sentence each.

    Raises:
        AssetError: as :func:`mesh_articulation`, or the name of ``out`` is no USD file's.
        StorageError: ``out`` cannot be written.
    """
    articulation = mesh_articulation(path, body, options=options)
    return (*articulation.notes, *write_usd(articulation, out))


# The rotation that takes y to z.
_Y_TO_Z = Pose.from_euler(math.pi / 2, 0.0, 0.0)


def _upright(mesh: Mesh, turn: Pose) -> Mesh:
    return replace(mesh, vertices=turn.transform(mesh.vertices)) if turn != Pose() else mesh


def _visual(part: MeshPart, upright: Pose, number: int) -> Shape:
    shape = Shape(_upright(part.mesh, upright), name=f"visual_{number}")
    return shape if part.color is None else replace(shape, color=part.color)


def _check(name: str, value: float | None, *, may_be_zero: bool) -> None:
    if value is None or (math.isfinite(value) and (value > 0 or (may_be_zero and value == 0))):
        return
    wanted = "that is not negative" if may_be_zero else "above zero"
    raise AssetError(f"{name} is {value}: give a finite number {wanted}")
