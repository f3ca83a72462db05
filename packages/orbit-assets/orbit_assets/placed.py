"""Contents of an asset file with their poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Articulation, Light, Pose, Shape
from orbit_core.scene.pose import Vector3


@dataclass(frozen=True, eq=False)
class PlacedArticulation:
    """An articulation of a file, and the pose of its root link in the file's world, z up."""

    articulation: Articulation
    """Links and joints."""
    pose: Pose = field(default_factory=Pose)
    """Pose of the root link in the file's world."""
    fixed_base: bool = False
    """True if its root does not move."""
    path: str = ""
    """Path in the file, such as a prim's, in formats that have any."""


@dataclass(frozen=True, eq=False)
class SceneParts:
    """All contents of a file: articulations, ground, light and gravity as far as the file describes them."""

    placed: tuple[PlacedArticulation, ...]
    """Articulations with their poses."""
    terrain: tuple[Shape, ...] = ()
    """Static shapes in the world's frame."""
    lights: tuple[Light, ...] | None = None
    """Lights of the file; None if it has none."""
    gravity: Vector3 | None = None
    """Gravity in m/s^2."""
    physics_dt: float | None = None
    """Time step in seconds."""
    notes: tuple[str, ...] = ()
    """Changes against the file as a whole."""


def chosen(placed: Sequence[PlacedArticulation], name: str | None) -> PlacedArticulation:
    """Return the one of a file's articulations that a caller named, or the only one.

    ``name`` is an articulation's name, its path in the file, or a path below which it is the only one.

    Raises:
        AssetError: there are several and none is named, or none or several match the name.
    """
    known = ", ".join(f"'{each.articulation.name}' ({each.path})" for each in placed)
    if name is None:
        if len(placed) > 1:
            raise AssetError(
                f"the file holds {len(placed)} articulations, {known}: name one by ReadOptions(articulation=...), or "
                "read them all by orbit_assets.scene_files.load_scene"
            )
        return placed[0]
    above = name.rstrip("/")
    exact = [each for each in placed if each.articulation.name == name or each.path == above]
    found = exact or [each for each in placed if each.path.startswith(f"{above}/")]
    if len(found) != 1:
        told = f"answer to '{name}'" if found else f"is called '{name}'"
        raise AssetError(f"{len(found) or 'none'} of the file's articulations {told}: name one of {known}")
    return found[0]
