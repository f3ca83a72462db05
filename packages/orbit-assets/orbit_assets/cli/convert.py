"""``orbit convert``: convert robots and objects between formats, and meshes into rigid bodies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from orbit_assets.cli.reading import ReadSettings, remedies_in_flags
from orbit_core.cli.output import console
from orbit_core.cli.settings import check_output, parse_words
from orbit_core.files import check_apart
from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.scene import Articulation, MeshCollision

_MESHES = (".obj", ".stl", ".glb", ".gltf", ".dae", ".ply", ".off")
_COLLISIONS = {
    "hull": MeshCollision.CONVEX_HULL,
    "pieces": MeshCollision.CONVEX_DECOMPOSITION,
    "triangles": MeshCollision.TRIANGLES,
}
# Options that apply to a mesh only; each is a field of :class:`orbit_assets.usd.writer.MeshBody`.
_MESH_OPTIONS = ("friction", "restitution", "density", "mass", "collision", "scale", "up")


@dataclass(frozen=True, kw_only=True)
class ConvertSettings(ReadSettings):
    """Convert a robot or object between URDF, MJCF and USD, or a mesh (OBJ, STL, glTF and others) into one rigid body
    with collider, mass and friction; print what was changed and what the target cannot hold."""

    source: Annotated[Positional[Path], arg(metavar="IN")]
    """The file to read."""
    target: Annotated[Positional[Path], arg(metavar="OUT")]
    """The file to write: .urdf, .xml, .mjcf, .usda, .usdc or .usd. A URDF's and an MJCF's meshes go to a folder next
    to it."""
    friction: float | None = None
    """Of a mesh, static and dynamic; 1 if left out."""
    restitution: float | None = None
    """Of a mesh; 0 if left out."""
    density: float | None = None
    """Of a mesh, in kg/m^3; 500 if left out."""
    mass: float | None = None
    """Of a mesh, in kg; wins over the density."""
    collision: Literal["hull", "pieces", "triangles"] | None = None
    """Collision shape of a mesh: its convex hull, which is the default, several convex pieces, or its own triangles."""
    scale: float | None = None
    """Metres of a mesh file's unit."""
    up: Literal["y", "z"] | None = None
    """A mesh file's up axis; y for glTF and z for others if left out."""
    overwrite: bool = False
    """Replace the file that is there already."""


def main(words: Sequence[str]) -> None:
    """Read one file, write the other, and report changes and losses."""
    settings = parse_words(ConvertSettings, words, "orbit convert")
    write = _writer(settings.target)
    # Checks come before imports of readers: a typing error in a path is reported at once.
    check_apart(settings.target, (settings.source,))
    check_output(settings.target, settings.target.suffix, settings.overwrite)
    from orbit_assets.files import check_written
    from orbit_assets.options import ReadOptions, Unsupported

    articulation = _read(settings)
    lost = write(articulation, settings.target)
    unchecked = check_written(articulation, settings.target, ReadOptions(unsupported=Unsupported.DROP))
    out = console()
    body = f"{articulation.mass:.4g} kg, links: {len(articulation.links)}, joints: {len(articulation.joint_names)}"
    out.print(f"{settings.target}: {articulation.name}, {body}", markup=False, highlight=False)
    for kind, lines in (("changed", articulation.notes), ("not held", lost), ("not checked", unchecked)):
        for line in lines:
            out.print(f"{kind}: {line}", markup=False, highlight=False)


@remedies_in_flags()
def _read(settings: ConvertSettings) -> Articulation:
    given = {name for name in _MESH_OPTIONS if getattr(settings, name) is not None}
    if settings.source.suffix.lower() in _MESHES:
        return _read_mesh(settings, given)
    if given:
        named = ", ".join(f"--{name}" for name in sorted(given))
        raise ConfigurationError(f"{named} is for meshes, and {settings.source} is none: leave it out")
    from orbit_assets.files import load_articulation

    return load_articulation(settings.source, merge=False, options=settings.options())


def _read_mesh(settings: ConvertSettings, given: set[str]) -> Articulation:
    from orbit_assets.usd.writer import MeshBody, mesh_articulation

    values = {name: getattr(settings, name) for name in given}
    if settings.collision is not None:
        values["collision"] = _COLLISIONS[settings.collision]
    return mesh_articulation(settings.source, MeshBody(**values), options=settings.options())


def _writer(target: Path) -> Callable[[Articulation, Path], tuple[str, ...]]:
    """Return the writer of files of that suffix."""
    suffix = target.suffix.lower()
    if suffix == ".urdf":
        from orbit_assets.urdf import write_urdf

        return write_urdf
    if suffix in (".xml", ".mjcf"):
        from orbit_assets.mjcf import write_mjcf

        return write_mjcf
    if suffix in (".usda", ".usdc", ".usd"):
        from orbit_assets.usd import write_usd

        return write_usd
    formats = ".urdf, .xml, .mjcf, .usda, .usdc or .usd"
    raise ConfigurationError(f"{target} is of no format that is written: name it {formats}")
