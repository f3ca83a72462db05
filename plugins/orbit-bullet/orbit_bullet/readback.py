"""The model that Bullet holds of one environment, for the core to compare with the description."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_bullet.actuation import Actuation
from orbit_bullet.stage import Stage
from orbit_bullet.urdf import child_poses
from orbit_core.interfaces import BuiltModel

FloatArray = npt.NDArray[np.float64]


def read_model(stage: Stage, actuation: Actuation) -> BuiltModel:
    """The first environment of a world."""
    limits = _limits(stage)
    masses, centers, inertias = _inertials(stage)
    return BuiltModel(
        masses=masses,
        centers_of_mass=centers,
        inertias=inertias,
        lower_limits=limits[:, 0],
        upper_limits=limits[:, 1],
        armatures=actuation.armatures(),
    )


def _inertials(stage: Stage) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Masses (L,), centres of mass (L, 3) and inertias (L, 3, 3), in the links' frames."""
    masses, centers, inertias = [], [], []
    for entity in stage.layout.entities:
        for index, place in zip(stage.links[entity.index], child_poses(entity.spec), strict=True):
            body = stage.bodies[0][entity.index]
            mass, _, moments = stage.client.getDynamicsInfo(body, index)[:3]
            inertial = place.inverse() @ stage.inertial(body, index)
            axes = inertial.rotation_matrix()
            masses.append(mass)
            centers.append(inertial.position)
            inertias.append(axes @ np.diag(moments) @ axes.T)
    return np.array(masses), np.array(centers).reshape(-1, 3), np.array(inertias).reshape(-1, 3, 3)


def _limits(stage: Stage) -> FloatArray:
    """Lower and upper limits (J, 2); Bullet knows a joint without limits by a lower one above the upper."""
    found = [
        stage.client.getJointInfo(stage.bodies[0][entity.index], joint)[8:10]
        for entity in stage.layout.entities
        for joint in stage.joints[entity.index]
    ]
    limits = np.array(found, dtype=np.float64).reshape(-1, 2)
    limits[limits[:, 0] > limits[:, 1]] = (-np.inf, np.inf)
    return limits
