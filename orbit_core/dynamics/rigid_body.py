"""Batched rigid-body dynamics of articulations: mass matrix, gravity forces and bias forces.

The algorithms are the composite-rigid-body and the recursive Newton-Euler algorithm (Featherstone, Rigid Body Dynamics
Algorithms, 2008, chapters 5 and 6), with all spatial vectors about one point, the root link's origin, and in world
axes. There, sums up and down the tree are products with the constant ancestry matrix, so that nothing loops over links.
Spatial vectors are linear, then angular.

The equation of motion is ``M(q) a + bias(q, v) = efforts``. Generalized velocity and its D components: of a fixed base,
the joints' velocities; of a floating base, linear velocity of the root frame's origin and angular velocity of the
root, both in world axes, then the joints'. Mimic joints count as free.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import (
    KinematicTree,
    child_links,
    cross_motion,
    joint_ancestry,
    link_ancestry,
    mimic_matrix,
)
from orbit_core.dynamics.transforms import quat_to_matrix
from orbit_core.interfaces.layout import SceneLayout, actuator_of_joint
from orbit_core.scene import Articulation, Joint, JointType, RobotSpec, Scene


class RigidBodyModel:
    """Dynamics of one articulation in N environments.

    Args:
        articulation: the description.
        fixed_base: whether the root link cannot move.
        device: where tensors live.
        armature: (J,) reflected motor inertias in place of the articulation's own.
        gravity: m/s^2, world axes.
        dtype: of the tensors that are given and returned. Single precision loses up to 4e-5 of the mass matrix of a
            hand, whose fingers' moments are small differences of large ones; float64 loses nothing that counts.
    """

    def __init__(
        self,
        articulation: Articulation,
        fixed_base: bool,
        device: torch.device | str = "cpu",
        armature: Sequence[float] | None = None,
        gravity: Sequence[float] = (0.0, 0.0, -9.81),
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self.kinematics = KinematicTree(articulation, device, dtype)
        """Poses, velocities and Jacobians of the same articulation."""
        self.dtype = dtype
        self.fixed_base = fixed_base
        self.device = torch.device(device)
        joints = articulation.movable_joints
        base = 0 if fixed_base else 6
        ancestry = link_ancestry(articulation)
        children = [0] * base + child_links(articulation)
        moves = np.concatenate((np.ones((len(ancestry), base), dtype=bool), joint_ancestry(articulation)), axis=1)
        # An argument, because actuator groups may override a joint's armature.
        own = [joint.armature for joint in joints] if armature is None else list(armature)
        self._children = torch.tensor(children, dtype=torch.int64, device=self.device)
        self._moves = self._tensor(moves[:, base:])
        self._subtree = self._tensor(ancestry.T)
        self._above = self._tensor(np.triu(moves[children].T.astype(float), 1))
        self._armature = self._tensor([0.0] * base + own)
        self._gravity = self._tensor(gravity)
        self._mass = self._tensor([[link.mass] for link in articulation.links])
        self._center = self._tensor([link.center_of_mass for link in articulation.links])
        # An inertia is its least moment in all directions, and what the two other principal axes have beyond it.
        moments, axes = np.linalg.eigh([link.inertia for link in articulation.links])
        self._least = self._tensor(moments[:, 0])
        self._spread = self._tensor(axes[:, :, 1:] * np.sqrt(moments[:, None, 1:] - moments[:, None, :1]))
        self._root_mass, self._identity = self._mass.sqrt(), self._tensor(np.eye(3))
        self._composite_mass = self._subtree @ self._mass

    def equation_of_motion(
        self, link_poses: Tensor, root_velocity: Tensor, joint_velocities: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return :meth:`mass_matrix` and :meth:`bias_forces`, with what they share computed once."""
        subspaces, inertias = self._subspaces(link_poses), self._spatial_inertias(link_poses)
        return self._mass_of(subspaces, inertias), self._bias_of(subspaces, inertias, root_velocity, joint_velocities)

    def mass_matrix(self, link_poses: Tensor) -> Tensor:
        """Return (N, D, D), armature included, for link poses (N, L, 7)."""
        return self._mass_of(self._subspaces(link_poses), self._spatial_inertias(link_poses))

    def gravity_forces(self, link_poses: Tensor) -> Tensor:
        """Return (N, D) efforts that hold the articulation against gravity at rest."""
        weights = (-self._gravity * self._mass).expand(link_poses.shape[0], -1, 3)
        moments = torch.linalg.cross(self._centers(link_poses), weights)
        return self._project(self._subspaces(link_poses), torch.cat((weights, moments), -1))

    def bias_forces(self, link_poses: Tensor, root_velocity: Tensor, joint_velocities: Tensor) -> Tensor:
        """Return (N, D) efforts at zero acceleration: Coriolis and centrifugal forces plus :meth:`gravity_forces`.

        Args:
            link_poses: (N, L, 7).
            root_velocity: (N, 6) of the root link, world axes; not used with a fixed base, which does not move.
            joint_velocities: (N, J).
        """
        subspaces, inertias = self._subspaces(link_poses), self._spatial_inertias(link_poses)
        return self._bias_of(subspaces, inertias, root_velocity, joint_velocities)

    def _mass_of(self, subspaces: Tensor, inertias: Tensor) -> Tensor:
        """Return (N, D, D) of subspaces (N, D, 6) and inertias (N, L, 12)."""
        composite = (self._subtree @ inertias)[:, self._children]
        forces = _momenta(self._composite_mass[self._children], composite, subspaces)
        products = subspaces @ forces.transpose(1, 2)
        # A joint feels the composite body of a joint below it, and only along one branch.
        upper = products * self._above
        diagonal = products.diagonal(dim1=1, dim2=2) + self._armature
        return upper + upper.transpose(1, 2) + torch.diag_embed(diagonal)

    def _bias_of(self, subspaces: Tensor, inertias: Tensor, root_velocity: Tensor, joint_velocities: Tensor) -> Tensor:
        """Return the bias forces (N, D)."""
        root = torch.zeros_like(root_velocity) if self.fixed_base else root_velocity
        base = 0 if self.fixed_base else 6
        joint_twists = subspaces[:, base:] * joint_velocities[..., None]
        twists = root[:, None] + self._moves @ joint_twists
        turning = cross_motion(twists[:, self._children[base:]], joint_twists)
        # With the origin's velocity held constant, the spatial acceleration of the root is that of a turning axis.
        linear = -torch.linalg.cross(root[:, 3:], root[:, :3]) - self._gravity
        accelerations = torch.cat((linear, torch.zeros_like(linear)), -1)[:, None] + self._moves @ turning
        inertial, momenta = (_momenta(self._mass, inertias, motion) for motion in (accelerations, twists))
        return self._project(subspaces, inertial + _cross_force(twists, momenta))

    def _subspaces(self, link_poses: Tensor) -> Tensor:
        """Return (N, D, 6) twist about the root's origin per unit of each generalized velocity."""
        joints = self.kinematics.motion_subspaces(link_poses, link_poses[:, 0, :3])
        if self.fixed_base:
            return joints
        return torch.cat((torch.eye(6, dtype=self.dtype, device=self.device).expand(joints.shape[0], 6, 6), joints), 1)

    def _project(self, subspaces: Tensor, forces: Tensor) -> Tensor:
        """Return (N, D) efforts that balance spatial forces (N, L, 6) on the links."""
        carried = (self._subtree @ forces)[:, self._children]
        return (subspaces * carried).sum(-1)

    def _centers(self, link_poses: Tensor) -> Tensor:
        """Return (N, L, 3) centres of mass from the root's origin, world axes."""
        rotations = quat_to_matrix(link_poses[..., 3:])
        return link_poses[..., :3] - link_poses[:, :1, :3] + (rotations @ self._center.unsqueeze(-1)).squeeze(-1)

    def _spatial_inertias(self, link_poses: Tensor) -> Tensor:
        """Return (N, L, 12) first moments of mass, then matrices of inertia, about the root's origin, world axes."""
        centers = self._centers(link_poses)
        spread = quat_to_matrix(link_poses[..., 3:]) @ self._spread
        heavy = self._root_mass * centers
        # Steiner's theorem: m (c.c - c c^T). All products are of a vector with itself, so that two halves are one.
        round_part = (self._least + heavy.square().sum(-1))[..., None, None] * self._identity
        about_origin = round_part + spread @ spread.mT - heavy.unsqueeze(-1) * heavy.unsqueeze(-2)
        return torch.cat((self._mass * centers, about_origin.flatten(-2)), -1)

    def _tensor(self, values: object) -> Tensor:
        return torch.as_tensor(np.asarray(values, dtype=np.float64), dtype=self.dtype, device=self.device)


def _momenta(mass: Tensor, inertias: Tensor, twists: Tensor) -> Tensor:
    """Return (N, B, 6) of bodies with masses (B, 1) and inertias (N, B, 12), at twists (N, B, 6)."""
    first, second = inertias[..., :3], inertias[..., 3:].unflatten(-1, (3, 3))
    linear, angular = twists[..., :3], twists[..., 3:]
    moment = torch.linalg.cross(first, linear) + (second * angular.unsqueeze(-2)).sum(-1)
    return torch.cat((mass * linear + torch.linalg.cross(angular, first), moment), -1)


def _cross_force(twist: Tensor, force: Tensor) -> Tensor:
    """Return rate of change (..., 6) of a spatial force or momentum as it is carried along by ``twist``."""
    linear, angular = twist[..., :3], twist[..., 3:]
    moment = torch.linalg.cross(angular, force[..., 3:]) + torch.linalg.cross(linear, force[..., :3])
    return torch.cat((torch.linalg.cross(angular, force[..., :3]), moment), -1)


# Inertia that joints move over the workspace, and the response of their drives ----------------------------------------

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
    """(J,) at the postures where the joint moves least."""
    mean: npt.NDArray[np.float64]
    """(J,) over the sampled postures."""
    largest: npt.NDArray[np.float64]
    """(J,) at the postures where the joint moves most."""


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
    """Name of the joint."""
    slowest: float
    """Hz, at the largest inertia."""
    fastest: float
    """Hz, at the smallest inertia."""
    least_damped: float
    """Damping ratio of the slowest response."""
    most_damped: float
    """Damping ratio of the fastest response."""


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
