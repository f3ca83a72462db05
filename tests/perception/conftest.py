"""Depth pictures in closed form: rays through the pixels' centres, in double precision."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
import torch
from torch import Tensor

from orbit_conformance.raytracing import pixel_directions, trace
from orbit_core.scene import CameraSpec, Pose
from orbit_core.scene.shapes import Geometry

Things = Sequence[tuple[Geometry, Pose]]


@pytest.fixture
def picture() -> Callable[[Things, CameraSpec], Tensor]:
    """``picture(things, camera)``: the depth (1, H, W, 1) of what stands before a camera, infinite where nothing is."""

    def take(things: Things, camera: CameraSpec) -> Tensor:
        directions = pixel_directions(camera)
        hits = trace(things, np.broadcast_to(camera.pose.position, directions.shape), directions)
        return torch.tensor(hits.distances, dtype=torch.float32).view(1, camera.height, camera.width, 1)

    return take
