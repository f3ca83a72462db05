"""Draws each robot of the catalogue at home, and writes the page that shows them.

    python tools/robot_gallery.py [--only NAME ...] [--no-pictures] [--result docs/conformance ...]

draws docs/images/robots/NAME.png and writes docs/robots.md. ``--result`` are folders of finished runs of
``orbit conformance --part robots``, whose verdicts the page tells, of each robot those of the last that has it; without
it the engines are left open. With ``--only`` the pictures of these robots are drawn, and the page is left as it is.
"""

from __future__ import annotations

import io
import math
import re
import string
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import tyro
from PIL import Image

from orbit_assets.audit.checks import shape_points
from orbit_assets.audit.robots.postures import home_posture
from orbit_assets.audit.robots.report import RobotReport, audit_spec
from orbit_assets.catalogue import RobotEntry, robot_info, robot_names
from orbit_assets.sources import installed_version
from orbit_conformance.jobs import Kind
from orbit_conformance.results import Record, load
from orbit_conformance.robots.checks import CHECKS
from orbit_conformance.verdict import Status
from orbit_core.preparation.validation import link_poses
from orbit_core.rollout.pictures import OverviewCamera
from orbit_core.scene import AmbientLight, DirectionalLight, Plane, Pose, RobotSpec, Scene, Shape, look_at
from orbit_core.world import simulate

FOLDER = Path(__file__).parents[1] / "docs"
PAGE, PICTURES = FOLDER / "robots.md", FOLDER / "images" / "robots"
FloatArray = npt.NDArray[np.float64]
SIZE = (360, 300)
"""Width and height in pixels."""
COLORS, LARGEST = 128, 40_000
"""Colours of a picture's palette, halved until the file is no larger than so many bytes."""
COMPOSED = (
    "base_omni+franka_panda+allegro_right", "kinova_gen3+panda_hand", "kuka_iiwa7+wsg50", "tiago_base+ur5",
    "ur5+robotiq_2f85", "xarm7+robotiq_2f85",
)  # fmt: skip
"""Compositions that are shown beside the catalogue's own, where their parts are there."""
_FIELD_OF_VIEW = 0.8
"""Radians, that of the spectator's camera."""
_AROUND, _ABOVE = math.radians(35.0), math.radians(30.0)
"""From where the camera looks: to the side of straight ahead, and above level."""
_MARGIN = 1.15
_MARKS = {Status.PASS: "✓", Status.GAP: "≈", Status.UNSUPPORTED: "–", Status.FAIL: "✗", Status.STALE: "!"}
_GROUPS = (
    ("Legged robots and humanoids", ("legged", "humanoid")),
    ("Mobile robots", ("mobile",)),
    ("Arms", ("arm",)),
    ("Grippers and hands", ("gripper", "hand")),
    ("Others", ()),
)
_COMPUTED = ("stiffness/damping for the inertia", "armature where the model has none")
"""Beginnings of notes that list numbers joint by joint."""


@dataclass(frozen=True, kw_only=True)
class GallerySettings:
    """Draw the catalogue's robots at home, and write the page that shows them."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME...")] = ()
    """Draw these robots' pictures, and leave the page as it is."""
    pictures: bool = True
    """Whether pictures are drawn; without, the page alone is written."""
    result: tuple[Path, ...] = ()
    """Folders of finished runs of the conformance suite's part 'robots', the latest last."""


def main(settings: GallerySettings) -> None:
    """Draw, and write."""
    names = settings.only or shown()
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name in names if settings.pictures else ():
        path = PICTURES / file_name(name)
        path.write_bytes(compressed(picture(robot_info(name).load())))
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")
    if not settings.only:
        PAGE.write_text(page(names, settings.result), encoding="utf-8")
        print(PAGE)


def shown() -> list[str]:
    """The catalogue's robots whose models are installed, and compositions of those."""
    known = [name for name in robot_names() if installed(robot_info(name))]
    return [*known, *(name for name in COMPOSED if {*name.split("+")} <= {*known})]


def installed(entry: RobotEntry) -> bool:
    """Whether the packages that the model comes from are there."""
    return all(installed_version(package) is not None for package in entry.source.split(", ") if package)


def file_name(name: str) -> str:
    """Of a robot's picture."""
    return f"{name.replace('+', '_with_')}.png"


def picture(spec: RobotSpec) -> npt.NDArray[np.uint8]:
    """(height, width, 3) of the whole robot at home, on plain ground."""
    points = seen(spec)
    ground = Shape(Plane(), color=(0.76, 0.78, 0.8, 1.0), name="ground")
    floor = float(points[:, 2].min()) if spec.fixed_base else 0.0
    scene = Scene(
        robots=(spec,),
        terrain=(replace(ground, pose=Pose((0.0, 0.0, floor))),),
        lights=(AmbientLight(color=(0.45, 0.45, 0.45)), DirectionalLight()),
    )
    world = simulate(scene, 1, "mujoco", {"antialiasing": 8, "shadow_size": 4096})
    try:
        camera = OverviewCamera(world, *SIZE, view(points))
        image = camera.pictures()[0].numpy()
        camera.close()
    finally:
        world.close()
    return image


def seen(spec: RobotSpec) -> FloatArray:
    """Points (P, 3) in the world, at home, whose hulls are what is seen of the robot."""
    poses = link_poses(spec.articulation, home_posture(spec))
    return np.concatenate(
        [
            (spec.pose @ poses[link.name]).transform(shape_points(shape))
            for link in spec.articulation.links
            for shape in link.visuals or link.collisions
        ]
    )


def view(points: FloatArray) -> Pose:
    """The camera's pose from which points (P, 3) fill the picture."""
    center = (points.min(0) + points.max(0)) / 2.0
    toward = np.array([math.cos(_AROUND) * math.cos(_ABOVE), math.sin(_AROUND) * math.cos(_ABOVE), math.sin(_ABOVE)])
    right = np.cross((0.0, 0.0, 1.0), toward)
    right /= np.linalg.norm(right)
    upward = np.cross(toward, right)
    center = center + sum(
        axis * (float((offsets := (points - center) @ axis).max()) + float(offsets.min())) / 2.0
        for axis in (right, upward)
    )
    offsets = points - center
    tangent = math.tan(_FIELD_OF_VIEW / 2.0)
    needed = np.maximum(np.abs(offsets @ upward) / tangent, np.abs(offsets @ right) / (tangent * SIZE[0] / SIZE[1]))
    distance = _MARGIN * float((needed + offsets @ toward).max())
    return look_at(eye=_vector(center + distance * toward), target=_vector(center))


def _vector(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def compressed(image: npt.NDArray[np.uint8]) -> bytes:
    """A PNG file with a palette."""
    colors = COLORS
    while True:
        buffer = io.BytesIO()
        Image.fromarray(image).quantize(colors, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
        if buffer.tell() <= LARGEST or colors <= 8:
            return buffer.getvalue()
        colors //= 2


def page(names: Sequence[str], results: Sequence[Path]) -> str:
    """The page in Markdown."""
    reports = {name: audit_spec(robot_info(name), robot_info(name).load()) for name in names}
    verdicts, checked = verdicts_of(results)
    lines = [
        "# Robots",
        "",
        "The robots of the catalogue at home, and some compositions of their parts, drawn by MuJoCo. `orbit info NAME`",
        "lists every joint, `orbit check-robot NAME` what is implausible; [add a robot](add-a-robot.md) of your own.",
        "",
        "*Drives*: natural frequency and damping ratio of the joints over the workspace. *Engines*: the robot passes",
        f"the [checks of robots](conformance.md#robots) ✓, misses one as declared ≈, or misses one ✗{checked}.",
        "*Simplified*: letters are simplifications that several robots share:",
        "",
        "| | simplified |",
        "|---|---|",
    ]
    shared = shared_notes(simplifications(report.spec.articulation.notes) for report in reports.values())
    lines += [f"| {letter} | {note} |" for note, letter in shared.items()]
    headings = ("robot", "", "joints", "mass", "drives", "simplified", "source, licence", "engines")
    table = [f"| {' | '.join(headings)} |", "|---" * len(headings) + "|"]
    for title, own in grouped(reports):
        lines += ["", f"## {title}", "", *table]
        lines += [row(name, reports[name], verdicts.get(name, "not run"), shared) for name in own]
    return "\n".join(lines) + "\n"


def grouped(reports: dict[str, RobotReport]) -> Iterable[tuple[str, list[str]]]:
    """Names under headings: compositions last, each other robot under the first kind that it is of."""
    left = [name for name in reports if "+" not in name]
    for title, kinds in _GROUPS:
        own = [name for name in left if not kinds or {c.value for c in reports[name].spec.categories} & {*kinds}]
        left = [name for name in left if name not in own]
        if own:
            yield title, own
    composed = [name for name in reports if "+" in name]
    if composed:
        yield "Compositions", composed


def row(name: str, report: RobotReport, verdict: str, shared: Mapping[str, str]) -> str:
    """Return one robot's line in its table, with shared notes as their letters."""
    spec, entry = report.spec, report.entry
    kinds = ", ".join(category.value for category in spec.categories)
    about = f"**{name}**<br>{entry.description}" + (f"<br>({kinds})" if kinds else "")
    followers = sum(joint.mimic is not None for joint in spec.articulation.movable_joints)
    joints = f"{len(report.joints)}" + (f", {followers} that follow" if followers else "")
    cells = (
        f"![{name}](images/robots/{file_name(name)})",
        about,
        joints,
        f"{spec.articulation.mass:.3g} kg",
        drives(report),
        cell_of_notes(simplifications(spec.articulation.notes), shared),
        f"{entry.source}<br>{entry.licence}",
        verdict,
    )
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"


def drives(report: RobotReport) -> str:
    """Ranges of natural frequency and damping ratio."""
    found = [joint.response for joint in report.joints if joint.response]
    if not found:
        return "efforts alone"
    slow, fast = min(r.slowest for r in found), max(r.fastest for r in found)
    least, most = min(r.least_damped for r in found), max(r.most_damped for r in found)
    return f"{slow:.2g} to {fast:.2g} Hz<br>ratio {least:.2g} to {most:.2g}"


def simplifications(notes: Iterable[str]) -> list[str]:
    """Notes of the description in short: numbers joint by joint and unread tags are left to `orbit info`."""
    told = (re.split(r": (?=\w+ )", note)[0] if len(note) > 160 else note for note in notes
            if not note.startswith((*_COMPUTED, "<")))  # fmt: skip
    computed = ["armature from the motors' limits"] if any(note.startswith(_COMPUTED[1]) for note in notes) else []
    return [*dict.fromkeys(told), *computed]


def shared_notes(robots: Iterable[Sequence[str]]) -> dict[str, str]:
    """Return a letter for each note of at least three robots, the most frequent first."""
    counts = Counter(note for notes in robots for note in notes)
    frequent = (note for note, count in counts.most_common() if count >= 3)
    return dict(zip(frequent, string.ascii_lowercase, strict=False))


def cell_of_notes(notes: Sequence[str], shared: Mapping[str, str]) -> str:
    """Return a robot's simplifications: letters of the shared ones, then its own in full."""
    letters = ", ".join(sorted(shared[note] for note in notes if note in shared))
    return "; ".join([*([letters] if letters else []), *(note for note in notes if note not in shared)]) or "nothing"


def verdicts_of(folders: Sequence[Path]) -> tuple[dict[str, str], str]:
    """Of each robot its standing by engine, and with what that is."""
    found: dict[str, dict[str, str]] = {}
    versions: dict[str, str] = {}
    for result in map(load, folders):
        versions |= {name: version for info in result.header.backends for name, version in info.versions.items()}
        for record in result.of(Kind.ROBOT):
            told = f"{record.job.backend}&nbsp;{_MARKS[record.status]}{missed(record)}"
            found.setdefault(record.job.name, {})[record.job.backend] = told
    used = ", ".join(f"{name} {version}" for name, version in versions.items())
    marks = {name: "<br>".join(told for _, told in sorted(own.items())) for name, own in found.items()}
    return marks, f" ({used})" if used else ""


def missed(record: Record) -> str:
    """Titles of the checks that the robot does not pass, in brackets; empty where it passes all."""
    titles = {check.name: check.title for check in CHECKS}
    checks = record.robot.checks if record.robot else ()
    found = ", ".join(titles[check.check] for check in checks if check.status is not Status.PASS)
    return f" ({found})" if found else ""


if __name__ == "__main__":
    main(tyro.cli(GallerySettings))
