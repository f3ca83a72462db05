"""What a robot's joints move, over all positions that they can take."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch

from orbit_core.dynamics.kinematics import mimic_matrix
from orbit_core.dynamics.rigid_body import RigidBodyModel
from orbit_core.scene import Articulation, Joint, JointType

_SAMPLES = 256
_TURN = math.pi
"""Range in which joints without limits are sampled, to either side of zero."""


def workspace_mass_matrices(
    articulation: Articulation, *, free_root: bool = False, armature: Sequence[float] | None = None
) -> npt.NDArray[np.float64]:
    """Mass matrices (S, D, D) at configurations drawn evenly within the joints' limits, the same at each call.

    Joints that follow others are folded into these, whose columns carry them; their own rows and columns are zero.

    Args:
        articulation: the description.
        free_root: whether the root's six directions come before the joints; else it is held.
        armature: (J,) reflected inertias in place of the joints' own.
    """
    joints = articulation.movable_joints
    fold = mimic_matrix(articulation)
    positions = torch.as_tensor(workspace_positions(articulation))
    model = RigidBodyModel(articulation, not free_root, armature=armature, dtype=torch.float64)
    root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], dtype=torch.float64).repeat(_SAMPLES, 1)
    full = model.mass_matrix(model.kinematics.forward(root, positions)).numpy()
    if free_root:
        fold = np.block([[np.eye(6), np.zeros((6, len(joints)))], [np.zeros((len(joints), 6)), fold]])
    return fold.T @ full @ fold


def workspace_positions(articulation: Articulation) -> npt.NDArray[np.float64]:
    """(S, J) drawn evenly within the joints' limits, the same at each call; followers where their leaders put them."""
    joints = articulation.movable_joints
    low, high = (np.array([_ends(joint)[end] for joint in joints]) for end in (0, 1))
    drawn = np.random.default_rng(0).uniform(low, high, (_SAMPLES, len(joints)))
    offsets = np.array([joint.mimic.offset if joint.mimic else 0.0 for joint in joints])
    return drawn @ mimic_matrix(articulation).T + offsets


def leaders(articulation: Articulation) -> list[int]:
    """For each movable joint (J) its own index, or that of the joint that it follows."""
    names = articulation.joint_names
    return [
        index if joint.mimic is None else names.index(joint.mimic.joint)
        for index, joint in enumerate(articulation.movable_joints)
    ]


def _ends(joint: Joint) -> tuple[float, float]:
    if joint.type is JointType.CONTINUOUS:
        return -_TURN, _TURN
    low, high = (
        limit if math.isfinite(limit) else math.copysign(_TURN, limit)
        for limit in (joint.lower_limit, joint.upper_limit)
    )
    return low, high
