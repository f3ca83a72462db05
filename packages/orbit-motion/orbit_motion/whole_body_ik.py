"""Inverse kinematics over an arm and the base that carries it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.base import JointTarget
from orbit_core.actions.differential_ik import bounded_targets
from orbit_core.actions.embodiment import base_joints
from orbit_core.actions.mobile_base import DifferentialWheels
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.scene import RobotSpec
from orbit_motion.prioritized_ik import PrioritizedIk, PrioritizedIkConfig


@dataclass(frozen=True, kw_only=True)
class WholeBodyIkConfig(PrioritizedIkConfig):
    """A command is a pose of the hand, or its change, to which base and arm go together.

    As :class:`PrioritizedIkConfig`, over the arm's joints and the base's motion: x, y and yaw of a planar base, forward
    and turn of two driven wheels. Moving the base counts ``base_cost`` times as much as moving a joint; what the arm is
    away from home draws the base along. Commands to the arm are positions, those to the base velocities.
    """

    name: ClassVar[str] = "whole_body_ik"
    above_zero: ClassVar[tuple[str, ...]] = (*PrioritizedIkConfig.above_zero, "base_cost")

    base_cost: float = 10.0

    def default_joints(self, spec: RobotSpec) -> Sequence[str]:
        return (*super().default_joints(spec), *base_joints(spec))

    def joint_indices(self, spec: RobotSpec, name: str) -> list[int]:
        """Return indices of the arm's joints, then of the base's."""
        joints = super().joint_indices(spec, name)
        base = _base_indices(spec)
        missing = [joint for joint in base if joint not in joints]
        if missing:
            raise ConfigurationError(
                f"action term '{name}' moves the base too: name its joints as well, {', '.join(base_joints(spec))}"
            )
        # The base's joints last, so that slices separate them from the arm's.
        return [*(joint for joint in joints if joint not in base), *base]

    def build(self, name: str, robot: Robot) -> WholeBodyIk:
        return WholeBodyIk(name, robot, self)


class WholeBodyIk(PrioritizedIk):
    """Motion generator of :class:`WholeBodyIkConfig`, with six commands."""

    def __init__(self, name: str, robot: Robot, config: WholeBodyIkConfig) -> None:
        super().__init__(name, robot, config)
        base = _base_indices(robot.spec)
        self.outputs = tuple(
            replace(self.outputs[0], name=target.value) for target in (JointTarget.POSITION, JointTarget.VELOCITY)
        )
        self._arm = self.joints[: len(self.joints) - len(base)]
        self._base_joints = base
        self._wheels = None if robot.spec.differential_base is None else DifferentialWheels(robot, base)
        moves = len(base)
        self._costs = torch.tensor([1.0] * len(self._arm) + [config.base_cost] * moves, device=self.device)
        self._ahead = torch.tensor([1.0, 0.0, 0.0], device=self.device)
        self._up = torch.tensor([0.0, 0.0, 1.0], device=self.device)

    def enter(self, world: World, step_dt: float) -> None:
        super().enter(world, step_dt)
        self._dt = step_dt

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        delta = self.solve(self._pose.displacement(inputs["command"]))
        arm = len(self._arm)
        motion = delta[:, arm:] / self._dt
        speeds = motion if self._wheels is None else self._wheels.speeds(motion)
        targets = bounded_targets(
            self, torch.cat((delta[:, :arm], torch.zeros_like(speeds)), 1), self.config.max_joint_step
        )
        # The arm follows positions at zero velocity, the base velocities.
        velocities = torch.cat((torch.zeros_like(delta[:, :arm]), speeds), 1)
        return {JointTarget.POSITION: targets, JointTarget.VELOCITY: velocities}

    def jacobian(self) -> Tensor:
        if self._wheels is None:
            return super().jacobian()
        root = self.robot.root_pose
        arm = self.robot.jacobian(self.frame, self._arm)
        ahead = quat_rotate(root[:, 3:], self._ahead)
        up = self._up.expand_as(ahead)
        # Turning moves the hand on a circle around the base's vertical axis.
        around = torch.linalg.cross(up, self.robot.frame_pose(self.frame)[:, :3] - root[:, :3])
        linear, angular = torch.stack((ahead, around), 2), torch.stack((torch.zeros_like(up), up), 2)
        return torch.cat((arm, torch.cat((linear, angular), 1)), 2)

    def bounds(self) -> tuple[Tensor, Tensor]:
        low, high = super().bounds()
        if self._wheels is not None:
            arm = len(self._arm)
            most = (0.5 * self.config.speed * self._dt * self._wheels.alone).expand(self.num_envs, 2)
            low, high = torch.cat((low[:, :arm], -most), 1), torch.cat((high[:, :arm], most), 1)
        return low, high

    def posture(self, jacobian: Tensor) -> Tensor | None:
        wanted = super().posture(jacobian)
        if wanted is None:
            return None
        arm = len(self._arm)
        # Only the arm has a home posture: the base may be anywhere.
        return torch.cat((wanted[:, :arm], torch.zeros_like(wanted[:, arm:])), 1)


def _base_indices(spec: RobotSpec) -> list[int]:
    joints = base_joints(spec)
    if not joints:
        raise ConfigurationError(f"robot '{spec.name}' has no base that moves: choose qp_ik, which moves the arm alone")
    return [spec.articulation.joint_names.index(joint) for joint in joints]
