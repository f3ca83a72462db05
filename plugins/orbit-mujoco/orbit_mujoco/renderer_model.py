"""The model that pictures are drawn from, with the sizes of MuJoCo's buffers in it."""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import SceneLayout
from orbit_mjmodel.visuals import looks_spec

SHADOW_RADIUS = 3.0
"""Metres around the scene's middle that shadows reach."""


def build_model(
    layout: SceneLayout, size: tuple[int, int], far: float, shadow_size: int, samples: int
) -> mujoco.MjModel:
    """The model to draw from, with the bodies of :func:`looks_spec`.

    Args:
        layout: of the scene.
        size: width and height of the largest picture.
        far: the greatest distance that is drawn, in metres.
        shadow_size: width of the shadow map in pixels.
        samples: per pixel.
    """
    spec = looks_spec(layout)
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = size
    visual.quality.shadowsize, visual.quality.offsamples = shadow_size, samples
    spec.stat.extent = 1.0  # the lengths below count in extents
    visual.map.zfar, visual.map.znear = far, 0.01
    visual.map.shadowclip = SHADOW_RADIUS
    return spec.compile()


def quaternion_matrix(quaternion: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Rotation matrix (3, 3)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
