"""The contents of a compiled model, read back for the core to compare with the description."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import BuiltModel
from orbit_mjmodel.addresses import Addresses

VARYING = (
    "body_mass", "body_ipos", "body_iquat", "body_inertia", "jnt_range", "dof_armature", "actuator_forcerange",
)  # fmt: skip
"""Fields of ``mjModel`` that are read, and may differ between environments."""
ALIKE = ("jnt_limited", "actuator_forcelimited")
"""The fields that may not differ between kinds of environments."""


class Fields(Protocol):
    """A ``mjModel``, or those fields of what was made from one."""

    body_mass: npt.NDArray
    """(bodies,) kg."""
    body_ipos: npt.NDArray
    """(bodies, 3) m, centre of mass in the body's frame."""
    body_iquat: npt.NDArray
    """(bodies, 4) principal axes in the body's frame."""
    body_inertia: npt.NDArray
    """(bodies, 3) principal moments, kg m^2."""
    jnt_limited: npt.NDArray
    """(joints,) True if limits hold."""
    jnt_range: npt.NDArray
    """(joints, 2) rad or m."""
    dof_armature: npt.NDArray
    """(degrees of freedom,) kg m^2 or kg."""
    actuator_forcelimited: npt.NDArray
    """(actuators,) True if a limit holds."""
    actuator_forcerange: npt.NDArray
    """(actuators, 2) N m or N."""


def read_back(fields: Fields, addresses: Addresses) -> BuiltModel:
    """The numbers of one kind of environment, in the layout's order."""
    bodies, joints = addresses.bodies, addresses.joints
    limits = _limits(fields.jnt_limited[joints], fields.jnt_range[joints])
    efforts = _limits(fields.actuator_forcelimited, fields.actuator_forcerange)
    axes = _rotation_matrices(np.asarray(fields.body_iquat[bodies], dtype=np.float64))
    return BuiltModel(
        masses=np.asarray(fields.body_mass[bodies], dtype=np.float64),
        centers_of_mass=np.asarray(fields.body_ipos[bodies], dtype=np.float64),
        inertias=np.einsum("lij,lj,lkj->lik", axes, fields.body_inertia[bodies], axes),
        lower_limits=limits[:, 0],
        upper_limits=limits[:, 1],
        armatures=np.asarray(fields.dof_armature[addresses.joint_velocities], dtype=np.float64),
        effort_limits=np.minimum(-efforts[:, 0], efforts[:, 1]),
    )


def _limits(limited: npt.NDArray, ranges: npt.NDArray) -> npt.NDArray[np.float64]:
    """(n, 2) lower and upper; infinite where there are none."""
    return np.where(np.asarray(limited, dtype=bool)[:, None], ranges, (-np.inf, np.inf))


def _rotation_matrices(quaternions: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(n, 3, 3) of unit quaternions (n, 4), (w, x, y, z)."""
    w, x, y, z = quaternions.T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), -1, 0)
