"""``orbit scene``: make scenes by seed, check them, and list things and furniture."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from orbit_core.cli.output import console, new_table
from orbit_core.cli.settings import check_output, check_positive, parse_words
from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError

if TYPE_CHECKING:
    from orbit_core.scene import Scene


# Times that a heap is settled again before it is rejected.
_SETTLE = 4


@dataclass(frozen=True, kw_only=True)
class MakeSettings:
    """Make a scene by seed and write it as USD, which every backend builds by orbit_assets.scene_files.load_scene."""

    kind: Annotated[Positional[str], arg(metavar="KIND")]
    """house, kitchen, living, bedroom, bathroom, study, table or bin."""
    seed: int = 0
    """Of all random choices; the same seed makes the same scene."""
    rooms: int = 1
    """Rooms; those after the first are of other kinds. A house has five unless told otherwise."""
    things: int | None = None
    """Things; 10 a room, and 12 on a table or in a bin, if left out."""
    output: Annotated[Path | None, arg(metavar="FILE")] = None
    """USD file to write; KIND_SEED.usda if left out."""
    backend: Annotated[str | None, arg(metavar="NAME")] = None
    """Backend that lets the scene settle and certifies that everything stays; a bin needs one. None checks overlaps
    only."""
    picture: Annotated[Path | None, arg(metavar="FILE")] = None
    """Draw the scene from above here, as PNG; needs a backend."""
    overwrite: bool = False
    """Replace files of those names that are there already."""


@dataclass(frozen=True, kw_only=True)
class CheckSettings:
    """Check a scene file: nothing overlaps, and nothing falls or moves while physics runs."""

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """USD or MJCF file of a whole scene."""
    backend: Annotated[str | None, arg(metavar="NAME")] = None
    """Backend that simulates it; None checks overlaps only."""
    seconds: float = 1.0
    """Simulated time."""


@dataclass(frozen=True, kw_only=True)
class ScanSettings:
    """Make a scene of a scanned mesh and write it as USD: cleaned, level on its floor at z = 0, in fewer triangles."""

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """OBJ, PLY, glTF or another mesh file."""
    output: Annotated[Path | None, arg(metavar="FILE")] = None
    """USD file to write; the scan's name with .usdc if left out."""
    unit: float | None = None
    """Metres of one unit of the file; needed unless it is glTF."""
    up: Literal["x", "y", "z"] | None = None
    """The file's axis that points up; needed unless it is glTF."""
    check_up: bool = True
    """Refuse a scan whose floor clearly faces another axis."""
    triangles: int = 50_000
    """Triangles that are drawn, and collide with --collision triangles."""
    collision: Literal["boxes", "triangles"] = "boxes"
    """Boxes of whole voxels, or the triangles themselves."""
    voxel: float = 0.05
    """Edge of the voxels of boxes, m."""
    overwrite: bool = False
    """Replace the file that is there already."""


@dataclass(frozen=True, kw_only=True)
class ListSettings:
    """List the library."""


def main(words: Sequence[str]) -> None:
    """Run one of the commands on scenes.

    Raises:
        UnknownNameError: the command does not exist.
    """
    if not words or words[0] in ("-h", "--help"):
        listed = "\n".join(f"  {name:<10} {about}" for name, (_, about) in _COMMANDS.items())
        print(f"usage: orbit scene COMMAND ...\n\n{listed}\n\n'orbit scene COMMAND --help' describes its options.")
        return
    if words[0] not in _COMMANDS:
        raise UnknownNameError("command of orbit scene", words[0], _COMMANDS)
    _COMMANDS[words[0]][0](words[1:])


def _make(words: Sequence[str]) -> None:
    settings = parse_words(MakeSettings, words, "orbit scene make")
    output = settings.output or Path(f"{settings.kind}_{settings.seed}.usda")
    check_output(output, output.suffix, settings.overwrite)
    check_output(settings.picture, ".png", settings.overwrite)
    if settings.backend is None and (settings.kind == "bin" or settings.picture is not None):
        what = "a heap falls into its bin" if settings.kind == "bin" else "a picture is drawn"
        raise ConfigurationError(f"{what} on an engine: name a --backend")
    from orbit_assets.usd.scene_writer import write_usd_scene
    from orbit_scenes.certify import certify, settled
    from orbit_scenes.house import make_scene

    # Reading the modules above is no part of making a scene.
    start = time.perf_counter()
    scene = make_scene(settings.kind, settings.seed, settings.rooms, settings.things)
    made = time.perf_counter() - start
    if settings.kind == "bin" and settings.backend is not None:
        scene = settled(scene, settings.backend)
    certificate = certify(scene, settings.backend)
    for _ in range(_SETTLE if settings.kind == "bin" else 0):
        # A heap that starts again without its contact forces may slip once more.
        if certificate.holds or settings.backend is None:
            break
        scene = settled(scene, settings.backend)
        certificate = certify(scene, settings.backend)
    certificate.check()
    lost = write_usd_scene(scene, output)
    if settings.picture is not None and settings.backend is not None:
        _draw(scene, settings.backend, settings.picture)
    out = console()
    free = sum(each.is_free_body for each in scene.objects)
    held = f"stays for {certificate.seconds:g} s on {settings.backend}" if settings.backend else "nothing overlaps"
    out.print(f"{output}: {len(scene.objects)} objects, {free} of them free, made in {made:.1f} s; {held}")
    for line in lost:
        out.print(f"not held: {line}", highlight=False)


def _check(words: Sequence[str]) -> None:
    settings = parse_words(CheckSettings, words, "orbit scene check")
    if not settings.seconds > 0.0:
        raise ConfigurationError(f"seconds must be above zero, not {settings.seconds}")
    from orbit_assets.scene_files import load_scene
    from orbit_scenes.certify import certify

    certificate = certify(load_scene(settings.file), settings.backend, settings.seconds)
    certificate.check()
    count = f"{len(certificate.movements)} objects stay" if settings.backend else "nothing overlaps"
    console().print(f"{settings.file}: {count}")


def _scan(words: Sequence[str]) -> None:
    settings = parse_words(ScanSettings, words, "orbit scene scan")
    output = settings.output or settings.file.with_suffix(".usdc")
    check_output(output, output.suffix, settings.overwrite)
    check_positive("triangles", settings.triangles)
    from orbit_assets.usd.scene_writer import write_usd_scene
    from orbit_scenes.scan import ScanCollision, cleaned, decimated, floor_map, on_floor, read_scan, scan_scene

    raw = read_scan(settings.file, unit=settings.unit, up=settings.up, check_up=settings.check_up)
    scan = on_floor(decimated(cleaned(raw), settings.triangles))
    scene = scan_scene(scan, collision=ScanCollision(settings.collision), voxel=settings.voxel)
    write_usd_scene(scene, output)
    shown = floor_map(scan, radius=0.05, height=2.0)
    out, (x, y, z) = console(), scan.size
    out.print(
        f"{output}: {x:.2f} x {y:.2f} x {z:.2f} m, {len(raw.faces)} triangles made {len(scan.faces)}, "
        f"{len(scan.names)} labels, {sum(len(each.articulation.root.collisions) for each in scene.objects)} collision "
        f"shapes, turned level by {scan.tilt:.3f} rad, "
        f"{shown.area:.1f} m^2 of free floor, holes of {shown.holes:.2f} m^2 in it"
    )


def _things(words: Sequence[str]) -> None:
    parse_words(ListSettings, words, "orbit scene things")
    from orbit_scenes.things import thing, thing_names

    table = new_table("thing", "size, m", "mass, kg", "pieces", "source")
    for name in thing_names():
        made = thing(name)
        size = " x ".join(f"{length:.3f}" for length in made.size)
        table.add_row(name, size, f"{made.link.mass:.4g}", str(len(made.link.collisions)), made.source)
    console().print(table)


def _furniture(words: Sequence[str]) -> None:
    parse_words(ListSettings, words, "orbit scene furniture")
    from orbit_scenes.furniture import furniture, furniture_kinds, furniture_table

    table = new_table("furniture", "depth x width x height, m", "joints", "supports", "source")
    for kind in furniture_kinds():
        made = furniture(kind)
        size = " x ".join(f"{length:.2f}" for length in made.size)
        joints, supports = made.articulation.joint_names, made.supports
        row = (", ".join(joints), ", ".join(each.name for each in supports), furniture_table()[kind].source)
        table.add_row(kind, size, *row)
    console().print(table)


def _draw(scene: Scene, backend: str, path: Path) -> None:
    from PIL import Image

    from orbit_core.rollout.pictures import OverviewCamera
    from orbit_core.world import simulate
    from orbit_scenes.views import overview

    world = simulate(scene, 1, backend)
    try:
        camera = OverviewCamera(world, 1280, 960, overview(scene))
        Image.fromarray(camera.pictures()[0].numpy()).save(path)
        camera.close()
    finally:
        world.close()


_COMMANDS: dict[str, tuple[Callable[[Sequence[str]], None], str]] = {
    "make": (_make, "make a house, a room, a table or a bin by seed, certify it and write it as USD"),
    "check": (_check, "check a scene file: overlaps, and things that fall or move"),
    "scan": (_scan, "make a scene of a scanned mesh: floor, unit, collision"),
    "things": (_things, "list the library of household things"),
    "furniture": (_furniture, "list kinds of furniture, with joints and supports"),
}
