"""Draw each task in the midst of an episode, and write the gallery of tasks, robots and sensors.

    python tools/task_gallery.py [--only NAME ...] [--no-pictures] [--traced]

draws docs/images/tasks/NAME.jpg on MuJoCo, its expert or a kept policy acting, and writes docs/gallery.md. ``--only``
limits the pictures to these tasks. ``--traced`` draws docs/images/traced/NAME.jpg of ten tasks by the path tracer
``sapien-rt``, which needs pyoidn (``pip install pyoidn``) and takes two idle cores some 20 s a picture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import torch
import tyro
from PIL import Image

from orbit_assets.catalogue import robot_info, robot_names
from orbit_core.envs import make, task_entries
from orbit_core.envs.actors import ExpertActor
from orbit_core.envs.environment import Environment
from orbit_core.rollout.pictures import Spectator
from orbit_core.scene import STUDIO
from orbit_learn.acting import make as create_policy_actor

DOCS = Path(__file__).parents[1] / "docs"
PAGE, PICTURES, TRACED = DOCS / "gallery.md", DOCS / "images" / "tasks", DOCS / "images" / "traced"
PATH_TRACER = "sapien-rt"
PATH_TRACED = (
    "Lift",
    "Stack-Pyramid",
    "Peg-In-Hole",
    "Hockey",
    "Cabinet",
    "Handover",
    "Mobile-Lift",
    "Room-Reorganization",
    "Velocity-Flat",
    "In-Hand-Repose",
)
"""Tasks whose pictures the path tracer draws, too."""
PATH_SETTINGS = {"samples_per_pixel": 6, "path_depth": 3, "denoiser": "oidn"}
"""Settings of the path tracer."""
WIDTH, HEIGHT = 360, 270
SEED = 4
MOMENTS = {"Cloth-Dropping": 0.25, "Hockey": 0.3, "Recover": 0.15, "Reach": 0.2, "Cartpole-Swing-Up": 0.12}
"""Share of the episode at which the picture is taken, where not half."""
LEARNED = {"Ant": "ant", "Humanoid": "humanoid", "In-Hand-Repose": "in_hand_repose"}
"""Kept policies that act where a task has no expert."""
GROUPS = (
    ("Manipulation", "manipulation-tasks.md", (
        "Reach", "Lift", "Gentle-Lift", "Pick-And-Place", "Cabinet", "Handover", "Stack", "Stack-Pyramid",
        "Peg-In-Hole", "Peg-In-The-Dark", "Nut-Bolt", "Jenga", "Hockey", "Beat-The-Buzz", "Dishwasher",
        "In-Hand-Repose",
    )),
    ("Mobile manipulation", "mobile-tasks.md", (
        "Mobile-Reach", "Mobile-Cabinet", "Mobile-Lift", "Room-Reorganization",
    )),
    ("Locomotion", "legs.md", ("Velocity-Flat", "Velocity-Rough", "Recover")),
    ("Cloth, rope, solids and liquids", "matter.md", (
        "Cloth-Lifting", "Cloth-Dropping", "Cloth-Spreading", "Cloth-Folding", "Flag-Hoisting", "Rope-Reshaping",
        "Soft-Lifting", "Soft-Stacking", "Soft-Placing", "Soft-Dropping", "Soft-Grasp", "Tower-Of-Hanoi",
        "Fluid-Transport", "Fluid-Pouring",
    )),
    ("Classic control", "classic-control.md", ("Cartpole-Balance", "Cartpole-Swing-Up", "Ant", "Humanoid")),
)  # fmt: skip
"""Title, page and tasks of each group."""
SENSORS = """## Sensors

Specified as data in a scene ([Sensors](sensors.md)); every engine serves the same classes of `orbit_core.sensors`.

| specification, in `orbit_core.scene` | measures |
|---|---|
| `CameraSpec` | colour, depth, positions, normals, albedo, instances, labels; point clouds, boxes |
| `RayCasterSpec` | distances, points, normals and links along rays: lidar, height scans |
| `ContactSensorSpec` | contact forces per link and pair, time in contact |
| `ImuSpec` | angular velocity, proper acceleration |
| `ForceTorqueSpec` | the wrench that a link receives from its parent |
| `FrameSensorSpec`, `JointSensorSpec` | poses and velocities of frames; positions and velocities of joints |

![Channels of a camera in two environments of Lift](images/warp_cameras.png)

*Colour, depth, normals, albedo, instances and labels of one camera, drawn by Warp.*

![Boxes over a picture, and a section through a distance field](images/perception.png)

*Bounding boxes, and a distance field from depth images ([Perception](perception.md)).*

![Kinds of terrain from left to right, levels from the back to the front](images/terrain.png)

*Ground for legged robots ([Terrain](terrain.md)).*
"""


@dataclass(frozen=True, kw_only=True)
class GallerySettings:
    """Draw the tasks in the midst of an episode, and write the gallery."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME...")] = ()
    """Draw these tasks' pictures only."""
    pictures: bool = True
    """False writes the page only."""
    traced: bool = False
    """Draw ten tasks by the path tracer instead."""


def main(settings: GallerySettings) -> None:
    """Draw the pictures and write the page."""
    if settings.pictures:
        folder, names = (TRACED, PATH_TRACED) if settings.traced else (PICTURES, tuple(task_entries()))
        folder.mkdir(parents=True, exist_ok=True)
        for name in settings.only or names:
            picture = draw(name, PATH_TRACER if settings.traced else None)
            picture.save(folder / f"{name}.jpg", quality=82, optimize=True)
            print(name, flush=True)
    PAGE.write_text(page(), encoding="utf-8")


def draw(name: str, renderer: str | None = None) -> Image.Image:
    """Return a picture of an episode of the task, drawn by the physics backend unless a renderer is named."""
    environment = in_the_midst(name, renderer)
    camera = Spectator(environment, WIDTH, HEIGHT, studio=replace(STUDIO, samples=16))
    picture = Image.fromarray(camera.pictures()[0].numpy())
    camera.close()
    environment.close()
    return picture


def in_the_midst(name: str, renderer: str | None = None) -> Environment:
    """Return an environment of the task in the midst of an episode, its expert or a kept policy acting."""
    looks: dict[str, Any] = {"settings": {"antialiasing": 4, "shadow_size": 4096}}
    if renderer:
        looks = {"renderer": renderer, "renderer_settings": PATH_SETTINGS}
    environment = make(name, num_envs=1, seed=SEED, backend="mujoco", **looks)
    actor = create_policy_actor(LEARNED[name], environment, SEED) if name in LEARNED else ExpertActor(environment, SEED)
    environment.reset(seed=SEED)
    with torch.inference_mode():
        for _ in range(round(environment.max_episode_steps * MOMENTS.get(name, 0.5))):
            environment.step(actor.act())
    return environment


def page() -> str:
    """Return the gallery as Markdown."""
    entries = task_entries()
    lines = [
        "# Gallery\n",
        "Made by `python tools/task_gallery.py`. `orbit list tasks|robots|sensors` prints the names, `orbit info NAME` "
        "everything about one of them, `orbit view TASK --backend mujoco` shows it live.\n",
    ]
    for title, more, names in GROUPS:
        lines += [f"## {title}\n", f"[Goals, experts, figures]({more})\n", '<div class="orbit-gallery" markdown>\n']
        lines += [_card(f"images/tasks/{name}.jpg", name, entries[name].description) for name in names]
        lines += ["\n</div>\n"]
    traced = [name for name in PATH_TRACED if (TRACED / f"{name}.jpg").exists()]
    if traced:
        lines += ["## Path traced\n", "The same tasks by `--renderer sapien-rt` ([Looks](looks.md#path-tracing))\n"]
        lines += ['<div class="orbit-gallery" markdown>\n']
        lines += [_card(f"images/traced/{name}.jpg", name, entries[name].description) for name in traced]
        lines += ["\n</div>\n"]
    shown = [name for name in robot_names() if (DOCS / "images" / "robots" / f"{name}.png").exists()]
    lines += ["## Robots\n", "[Joints, masses, drives, licences, verdicts of the checks](robots.md)\n"]
    lines += ['<div class="orbit-gallery orbit-small" markdown>\n']
    lines += [_card(f"images/robots/{name}.png", name, robot_info(name).description) for name in shown]
    return "\n".join([*lines, "\n</div>\n", SENSORS])


def _card(picture: str, name: str, text: str) -> str:
    return f"* ![{name}]({picture}) **{name}**<br>{text}"


if __name__ == "__main__":
    main(tyro.cli(GallerySettings, description=__doc__))
