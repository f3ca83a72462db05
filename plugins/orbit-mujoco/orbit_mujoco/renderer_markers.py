"""Markers as MuJoCo scene geoms, which no model holds."""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbit_core.plugin_kit.markers import AXIS_COLORS
from orbit_core.scene import MarkerShape, MarkerSpec
from orbit_mujoco.renderer_model import quaternion_matrix

MAX_GEOMS = 3
"""That one marker takes at most."""

_SHAFT = 0.05  # of an arrow's length
_GEOM = mujoco.mjtGeom


def add_markers(scene: mujoco.MjvScene, markers: Sequence[MarkerSpec], poses: npt.NDArray[np.float64]) -> None:
    """Append the scene's markers at poses (M, 7) to what is drawn."""
    for marker, pose in zip(markers, poses, strict=True):
        position, rotation = pose[:3], quaternion_matrix(pose[3:])
        color, opacity = marker.color[:3], marker.color[3]
        match marker.shape:
            case MarkerShape.FRAME:
                for axis, axis_color in enumerate(AXIS_COLORS):
                    _add_arrow(scene, position, rotation[:, axis], marker.size, (*axis_color, opacity))
            case MarkerShape.ARROW:
                _add_arrow(scene, position, rotation[:, 0], marker.size, (*color, opacity))
            case MarkerShape.SPHERE:
                _add_solid(scene, _GEOM.mjGEOM_SPHERE, position, rotation, marker)
            case MarkerShape.BOX:
                _add_solid(scene, _GEOM.mjGEOM_BOX, position, rotation, marker)


def _add_arrow(
    scene: mujoco.MjvScene,
    start: npt.NDArray[np.float64],
    direction: npt.NDArray[np.float64],
    length: float,
    color: tuple[float, ...],
) -> None:
    geom = _next_geom(scene, _GEOM.mjGEOM_ARROW, np.zeros(3), start, np.eye(3), color)
    # MuJoCo draws an arrow half as long as it is told.
    mujoco.mjv_connector(geom, _GEOM.mjGEOM_ARROW, _SHAFT * length, start, start + 2 * length * direction)


def _add_solid(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    position: npt.NDArray[np.float64],
    rotation: npt.NDArray[np.float64],
    marker: MarkerSpec,
) -> None:
    _next_geom(scene, kind, np.full(3, marker.size / 2), position, rotation, marker.color)


def _next_geom(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    size: npt.NDArray[np.float64],
    position: npt.NDArray[np.float64],
    rotation: npt.NDArray[np.float64],
    color: tuple[float, ...],
) -> mujoco.MjvGeom:
    geom = scene.geoms[scene.ngeom]
    rgba = np.asarray(color, dtype=np.float32)
    mujoco.mjv_initGeom(geom, kind, size, position, rotation.ravel(), rgba)
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    scene.ngeom += 1
    return geom
