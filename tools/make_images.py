"""Draws the pictures of the documentation: each task in the midst of an episode, its expert acting.

python tools/make_images.py docs/images
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import numpy.typing as npt
import torch

from orbit_core.envs import make
from orbit_core.rollout.pictures import OverviewCamera
from orbit_core.scene import Pose, look_at
from orbit_viewer.video import tile

SETTINGS = {"antialiasing": 4, "shadow_size": 4096}
WIDTH, HEIGHT = 480, 400
LIFT_VIEW = look_at(eye=(1.25, 0.95, 0.95), target=(0.3, 0.0, 0.26))


@dataclass(frozen=True)
class Picture:
    """One task, when to draw it and from where."""

    task: str
    seconds: float
    view: Pose


TASKS = (
    Picture("Lift", 3.0, LIFT_VIEW),
    Picture("Reach", 0.7, LIFT_VIEW),
    Picture("Cabinet", 4.0, look_at(eye=(-0.2, 1.6, 1.35), target=(0.5, 0.0, 0.4))),
    Picture("Velocity-Flat", 0.8, look_at(eye=(1.0, 1.35, 1.2), target=(0.0, 0.0, 0.42))),
    Picture("Handover", 3.6, look_at(eye=(0.75, 1.75, 0.95), target=(0.75, 0.0, 0.25))),
    Picture("Handover", 6.5, look_at(eye=(0.75, 1.75, 0.95), target=(0.75, 0.0, 0.25))),
)
ROOM_VIEW = look_at(eye=(-0.2, -4.6, 4.8), target=(0.0, -0.1, 0.0))
MOBILE = (
    Picture("Mobile-Reach", 5.0, look_at(eye=(2.6, 2.6, 1.6), target=(0.9, 0.9, 0.4))),
    Picture("Mobile-Cabinet", 6.0, look_at(eye=(-1.0, 2.2, 1.7), target=(0.5, 0.0, 0.5))),
    Picture("Mobile-Lift", 6.5, look_at(eye=(-0.4, 2.2, 1.7), target=(1.1, 0.0, 0.4))),
    Picture("Room-Reorganization", 4.5, ROOM_VIEW),
    Picture("Room-Reorganization", 13.5, ROOM_VIEW),
    Picture("Room-Reorganization", 40.0, ROOM_VIEW),
)
LIFT_TIMES = (0.02, 0.4, 1.3, 3.4)


def frames(picture: Picture, times: tuple[float, ...]) -> npt.NDArray[np.uint8]:
    """(times, height, width, 3) of one episode at the given seconds."""
    environment = make(picture.task, num_envs=1, seed=4, settings=SETTINGS)
    camera = OverviewCamera(environment.world, WIDTH, HEIGHT, picture.view)
    expert = environment.expert()
    environment.reset(seed=4)
    taken: list[npt.NDArray[np.uint8]] = []
    with torch.inference_mode():
        for step in range(round(max(times) / environment.step_dt)):
            environment.step(expert.compute({})["action"])
            taken += [camera.pictures()[0].numpy() for time in times if step + 1 == round(time / environment.step_dt)]
    camera.close()
    environment.close()
    return np.stack(taken)


def main(folder: Path) -> None:
    """Write the pictures into a folder."""
    tasks = np.concatenate([frames(picture, (picture.seconds,)) for picture in TASKS])
    iio.imwrite(folder / "tasks.png", tile(tasks, 3), optimize=True)
    mobile = np.concatenate([frames(picture, (picture.seconds,)) for picture in MOBILE])
    iio.imwrite(folder / "mobile.png", tile(mobile, 3), optimize=True)
    iio.imwrite(folder / "lift.png", tile(frames(TASKS[0], LIFT_TIMES), 4), optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
