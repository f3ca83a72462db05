"""Inertia that joints move over the workspace, and the response of their drives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from orbit_core.dynamics.kinematics import mimic_matrix
from orbit_core.dynamics.rigid_body import RigidBodyModel
from orbit_core.interfaces.layout import SceneLayout, actuator_of_joint
from orbit_core.scene import Articulation, Joint, JointType, RobotSpec, Scene

_SAMPLES = 256
# Range in which joints without limits are sampled, to either side of zero
_TURN = math.pi


def workspace_mass_matrices(
    articulation: Articulation, *, free_root: bool = False, armature: Sequence[float] | None = None
) -> npt.NDArray[np.float64]:
    """Return mass matrices (S, D, D) at configurations drawn evenly within the joints' limits, the same at each call.

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
    # Mass matrices do not depend on the pose of the root.
    root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], dtype=torch.float64).repeat(_SAMPLES, 1)
    full = model.mass_matrix(model.kinematics.forward(root, positions)).numpy()
    if free_root:
        fold = np.block([[np.eye(6), np.zeros((6, len(joints)))], [np.zeros((len(joints), 6)), fold]])
    return fold.T @ full @ fold


def workspace_positions(articulation: Articulation) -> npt.NDArray[np.float64]:
    """Return configurations (S, J) drawn evenly within the joints' limits, the same at each call.

    Followers are where their leaders put them.
    """
    joints = articulation.movable_joints
    low, high = (np.array([_ends(joint)[end] for joint in joints]) for end in (0, 1))
    # A fixed seed: gains that are designed from these samples must be the same on every machine.
    drawn = np.random.default_rng(0).uniform(low, high, (_SAMPLES, len(joints)))
    offsets = np.array([joint.mimic.offset if joint.mimic else 0.0 for joint in joints])
    return drawn @ mimic_matrix(articulation).T + offsets


def leaders(articulation: Articulation) -> list[int]:
    """Return for each movable joint (J) its own index, or that of the joint that it follows."""
    names = articulation.joint_names
    return [
        index if joint.mimic is None else names.index(joint.mimic.joint)
        for index, joint in enumerate(articulation.movable_joints)
    ]


@dataclass(frozen=True)
class ReflectedInertia:
    """Inertia (J,) that each joint moves while all others are at rest, over the workspace: kg m^2 or kg, with armature.

    Joints that mimic another have the value of the joint that they follow.
    """

    smallest: npt.NDArray[np.float64]
    mean: npt.NDArray[np.float64]
    largest: npt.NDArray[np.float64]


def reflected_inertia(articulation: Articulation, armature: Sequence[float] | None = None) -> ReflectedInertia:
    """Return the diagonal of the mass matrix over configurations drawn evenly within the joints' limits.

    ``armature`` (J,) takes the place of the joints' own. A free base does not follow the joints' motion here, as that
    of a robot that stands does not.
    """
    # The diagonal is the inertia of a joint while all others are at rest.
    diagonal = np.diagonal(workspace_mass_matrices(articulation, armature=armature), axis1=1, axis2=2)
    leading = leaders(articulation)
    smallest, mean, largest = (reduce(diagonal, axis=0)[leading] for reduce in (np.min, np.mean, np.max))
    return ReflectedInertia(smallest, mean, largest)


@dataclass(frozen=True)
class DriveResponse:
    """Second-order response of a joint to its position target over the workspace, all other joints at rest.

    Frequencies are natural ones, Hz; a damping ratio of 1 is critical. The slowest response, at the largest inertia, is
    the least damped.
    """

    joint: str
    slowest: float
    fastest: float
    least_damped: float
    most_damped: float


def drive_responses(robot: RobotSpec) -> tuple[DriveResponse, ...]:
    """Return the response of each joint whose actuator has a stiffness, in the joints' order; followers are left out.

    The mechanism's own damping counts, as do armatures that an actuator group gives.

    Raises:
        UnknownNameError: an actuator group names no joint of the robot.
    """
    articulation = robot.articulation
    parameters = SceneLayout.of(Scene(robots=(robot,))).joint_parameters
    inertia = reflected_inertia(articulation, parameters.armature.tolist())
    responses: list[DriveResponse] = []
    for index, group in sorted(actuator_of_joint(robot).items()):
        joint = articulation.movable_joints[index]
        if group.stiffness <= 0 or joint.mimic is not None:
            continue
        damping = group.damping + parameters.damping[index]
        ends = [(float(most[index]), group.stiffness) for most in (inertia.largest, inertia.smallest)]
        slowest, fastest = (math.sqrt(stiffness / moved) / (2 * math.pi) for moved, stiffness in ends)
        least, most = (float(damping) / (2 * math.sqrt(stiffness * moved)) for moved, stiffness in ends)
        responses.append(DriveResponse(joint.name, slowest, fastest, least, most))
    return tuple(responses)


def _ends(joint: Joint) -> tuple[float, float]:
    if joint.type is JointType.CONTINUOUS:
        return -_TURN, _TURN
    low, high = (
        limit if math.isfinite(limit) else math.copysign(_TURN, limit)
        for limit in (joint.lower_limit, joint.upper_limit)
    )
    return low, high
