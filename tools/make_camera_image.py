"""Draws one camera's channels side by side, two environments of Lift below each other, their expert acting.

python tools/make_camera_image.py warp docs/images/warp_cameras.png
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import torch

from orbit_core.envs import make
from orbit_core.scene import CameraSpec, Channel, Scene, look_at
from orbit_tasks.lift import Lift
from orbit_viewer.viewer import picture_of

CAMERA = CameraSpec(
    name="camera",
    width=200,
    height=200,
    channels=tuple(Channel),
    pose=look_at((1.05, -0.55, 0.65), (0.42, 0.0, 0.12)),
    vertical_fov=0.8,
    far=3.0,
)
SECONDS = 1.3


@dataclass(kw_only=True)
class SeenLift(Lift):
    """Lift with a camera that looks at the table."""

    def scene(self) -> Scene:
        scene = super().scene()
        return replace(scene, sensors=(*scene.sensors, CAMERA))


def main(backend: str, path: Path) -> None:
    environment = make(SeenLift(), num_envs=2, backend=backend, seed=4)
    expert = environment.expert()
    environment.reset(seed=4)
    with torch.inference_mode():
        for _ in range(round(SECONDS / environment.step_dt)):
            environment.step(expert.compute({})["action"])
    images = environment.world.sensors["camera"].images
    rows = [np.concatenate([picture_of(channel, images[channel][env]) for channel in Channel], 1) for env in range(2)]
    iio.imwrite(path, np.concatenate(rows))
    environment.close()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
