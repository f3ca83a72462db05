"""Base of control laws for compliant motion of the hand: goal, gains, and dynamics of the hand's frame.

Khatib, A Unified Approach for Motion and Force Control of Robot Manipulators: The Operational Space Formulation, IEEE
Journal on Robotics and Automation 3(1), 1987. With the Jacobian J of a frame, ``x' = J v`` and ``x'' = J a + J' v``;
``Lambda = (J M^-1 J^T)^-1`` is the inertia that the frame shows. Joint accelerations

``a = M^-1 J^T Lambda (x''* - J' v - J a0) + a0``

give the frame the acceleration x''*, and what joints are left free by it the acceleration a0 (dynamically consistent
null space), which draws them home here.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.arm_dynamics import ArmState
from orbit_core.actions.base import CommandMode, LastTargets
from orbit_core.actions.differential_ik import PoseTermConfig
from orbit_core.actions.ik import COMPONENTS, PoseFollower
from orbit_core.dynamics.kinematics import PointJacobian
from orbit_core.dynamics.linear import solve_spd
from orbit_core.dynamics.transforms import pose_error
from orbit_core.dynamics.workspace import workspace_positions
from orbit_core.interfaces import Robot
from orbit_core.scene import RobotSpec
from orbit_motion.gains import CommandedGains, GainCommand, GainRange
from orbit_motion.servo import Servo, check_rate

# Added to the inverse inertia (1/kg and 1/(kg m^2)), so that efforts stay bounded in singular poses.
_REGULAR = 1e-4


@dataclass(frozen=True, kw_only=True)
class CompliantConfig(PoseTermConfig):
    """A command is a pose of the hand, or its change, and, if asked for, six stiffnesses and six damping ratios."""

    unwanted_gains: ClassVar[tuple[str, ...]] = ("stiffness", "damping")
    none_below_zero: ClassVar[tuple[str, ...]] = (
        "stiffness", "rotational_stiffness", "damping_ratio", "posture_stiffness",
    )  # fmt: skip

    mode: CommandMode = CommandMode.INTEGRATED
    position_lead: float = 0.1
    rotation_lead: float = 0.5
    stiffness: float = 150.0
    """Stiffness of the hand's position."""
    rotational_stiffness: float = 150.0
    """Stiffness of the hand's rotation."""
    damping_ratio: float = 1.0
    gains: GainCommand = GainCommand.FIXED
    stiffness_factor: GainRange = GainRange(low=0.1, high=4.0)
    """Factor of the stiffnesses, from the command's -1 to its 1."""
    ratio_range: GainRange = GainRange(low=0.5, high=2.0)
    """Damping ratio, from the command's -1 to its 1."""
    posture_stiffness: float = 10.0
    """1/s^2: draws joints home, critically damped, where that does not move the hand."""

    def components(self, spec: RobotSpec, name: str) -> tuple[str, ...]:
        return (*COMPONENTS, *CommandedGains.components(self.gains, COMPONENTS))


@dataclass(frozen=True, eq=False)
class HandState:
    """The frame's motion: measured pose (N, 7), velocity (N, 6), and its response to efforts."""

    pose: Tensor
    velocity: Tensor
    jacobian: Tensor
    """Jacobian of the frame, (N, 6, k)."""
    response: Tensor
    """``M^-1 J^T``, (N, k, 6): joint accelerations per unit of wrench at the frame."""
    inverse_inertia: Tensor
    """``J M^-1 J^T``, (N, 6, 6), regularised."""
    drift: Tensor
    """``J' v``, (N, 6)."""
    links: Tensor
    """Poses of all links, (N, L, 7)."""

    def wrench(self, acceleration: Tensor) -> Tensor:
        """Return the wrench (N, 6) that accelerates the frame by (N, 6), as if at rest."""
        return solve_spd(self.inverse_inertia, acceleration.unsqueeze(-1)).squeeze(-1)

    def joint_accelerations(self, wrench: Tensor) -> Tensor:
        """Return the joint accelerations (N, k) that a wrench (N, 6) causes."""
        return torch.bmm(self.response, wrench.unsqueeze(-1)).squeeze(-1)


class Compliant(PoseFollower, Servo):
    """Six commands, or more for gains, :class:`CompliantConfig`."""

    def __init__(self, name: str, robot: Robot, config: CompliantConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, len(config.components(robot.spec, name)))
        self.frame = config.frame_of(robot)
        self.gains = CommandedGains(
            config.gains, [config.stiffness] * 3 + [config.rotational_stiffness] * 3, config.damping_ratio,
            config.stiffness_factor, config.ratio_range, self.num_envs, self.device,
        )  # fmt: skip
        self._pose = config.pose_command(robot)
        self._goal = LastTargets(self.num_envs, (7,), self.device)
        self._home = robot.home_positions[joints]
        self._posture = config.posture_stiffness
        self._jacobian = PointJacobian(robot.spec.articulation, link_of(robot, self.frame), joints, self.device)
        self._regular = _REGULAR * torch.eye(6, device=self.device)

    @abstractmethod
    def hand_accelerations(self, hand: HandState, free: Tensor, aims: Mapping[str, Tensor]) -> Tensor:
        """Return joint accelerations (N, k); ``free`` (N, k) are those of the null space, which leave the hand in
        place.
        """

    def workspace_mobility(self) -> Tensor:
        """Compute ``J M^-1 J^T`` of the frame (P, 6, 6), float64, in P postures all over the workspace."""
        positions = torch.as_tensor(workspace_positions(self.robot.spec.articulation), device=self.device).float()
        model = self.dynamics.model
        root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], device=self.device)
        poses = model.kinematics.forward(root.repeat(len(positions), 1), positions)
        jacobian = model.kinematics.jacobian(poses, self.frame)[:, :, self.joints].double()
        mass = model.mass_matrix(poses)[:, self.joints][:, :, self.joints].double()
        return jacobian @ torch.linalg.solve(mass, jacobian.mT)

    def check_posture(self) -> None:
        """Reject a posture's stiffness with which physics steps diverge."""
        step, stiffness = self.physics_dt, self._posture
        # Load of a critically damped spring: (step w)^2 + 2 zeta step w, with w^2 = stiffness, doubled for its damper.
        load = step**2 * stiffness + 4.0 * step * stiffness**0.5
        check_rate(self.name, load, f"a posture_stiffness of {stiffness:g}")

    def aim(self, command: Tensor) -> None:
        self._goal.keep(self._pose.target(command[:, :6]))
        self.gains.take(command[:, 6:])

    def aims(self) -> dict[str, Tensor]:
        return {**self._goal.parts(), **self.gains.varying()}

    def accelerations(self, state: ArmState, aims: Mapping[str, Tensor]) -> Tensor:
        # Critically damped towards home: the damping is 2 sqrt(stiffness).
        free = self._posture * (self._home - state.positions) - 2.0 * self._posture**0.5 * state.velocities
        return self.hand_accelerations(self.hand_state(state), free, aims)

    def hand_state(self, state: ArmState) -> HandState:
        """Return the hand's state for an arm's state."""
        pose = self.dynamics.model.kinematics.frame_pose(state.poses, self.frame)
        jacobian = self._jacobian(state.poses, pose[:, :3])
        response = solve_spd(state.mass, jacobian.mT)
        inverse = torch.bmm(jacobian, response) + self._regular
        velocity = torch.bmm(jacobian, state.velocities.unsqueeze(-1)).squeeze(-1)
        drift = self.dynamics.drift(state, self.frame)
        return HandState(pose, velocity, jacobian, response, inverse, drift, state.poses)

    def error(self, hand: HandState, aims: Mapping[str, Tensor]) -> Tensor:
        """Return the error (N, 6) from the measured pose to the goal."""
        return pose_error(hand.pose, LastTargets.read_of(aims, hand.pose))

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return torch.cat((self._pose.encode(pose), self.gains.encode(self.num_envs)), 1)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._pose.reset(env_ids)
        self._goal.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        pose = {f"pose_{key}": value for key, value in self._pose.memory().items()}
        return {**pose, **self._goal.memory(), **self.gains.memory()}


def link_of(robot: Robot, frame: str) -> int:
    """Return the index of the link that carries a link's own or a named frame."""
    return robot.link_names.index(robot.spec.articulation.frame(frame).link)


def without_free(hand: HandState, free: Tensor) -> Tensor:
    """Return the frame's acceleration (N, 6) without the task: ``J' v + J a0``."""
    return hand.drift + torch.bmm(hand.jacobian, free.unsqueeze(-1)).squeeze(-1)
