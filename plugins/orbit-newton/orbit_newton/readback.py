"""The contents of a Newton model, read back for the core to compare with the description."""

# pyright: reportMissingImports=false
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportOptionalMemberAccess=false

from __future__ import annotations

import numpy as np

from orbit_core.interfaces import BuiltModel as HeldModel
from orbit_newton.builder import BuiltModel


def read_back(built: BuiltModel, num_envs: int, maximal: bool) -> HeldModel:
    """The numbers of the first environment, whose replicas the others are.

    Where a solver is ``maximal``, inertias are those of links and motors together, and are not read.
    """
    model, dofs = built.model, built.velocities

    def first(array: object, *shape: int) -> np.ndarray:
        return np.asarray(array.numpy(), dtype=np.float64).reshape(num_envs, -1, *shape)[0]

    return HeldModel(
        masses=first(model.body_mass),
        centers_of_mass=first(model.body_com, 3),
        inertias=None if maximal else first(model.body_inertia, 3, 3),
        # Back to the contract's positions, from coordinates that count from the middle of the limits.
        lower_limits=first(model.joint_limit_lower)[dofs] + built.zeros,
        upper_limits=first(model.joint_limit_upper)[dofs] + built.zeros,
        armatures=None if maximal else first(model.joint_armature)[dofs],
    )
