"""Command that opens or closes a gripper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.base import JointTarget, MotionGenerator
from orbit_core.actions.embodiment import end_effector_of
from orbit_core.actions.term import ActionTerm
from orbit_core.dynamics.constants import constant
from orbit_core.interfaces import ConfigurationError, Robot, match_values
from orbit_core.scene import Gripper, RobotSpec


@dataclass(frozen=True, kw_only=True)
class BinaryGripperConfig(ActionTerm):
    """A negative command closes the gripper, any other opens it."""

    name: ClassVar[str] = "binary_gripper"

    frame: str | None = None
    """Frame of the end effector that carries the gripper; None takes the first one. ``joints`` are by default its
    gripper's, and so are the positions below."""
    open_position: float | tuple[float, ...] | None = None
    """rad or m, of every joint, or one for each entry of ``joints``."""
    closed_position: float | tuple[float, ...] | None = None
    """rad or m, of every joint, or one for each entry of ``joints``."""

    def default_joints(self, spec: RobotSpec) -> Sequence[str]:
        return self.gripper_of(spec).joints

    def components(self, spec: RobotSpec, name: str) -> tuple[str, ...]:
        return ("opening",)

    def gripper_of(self, spec: RobotSpec) -> Gripper:
        """The gripper on the end effector.

        Raises:
            ConfigurationError: there is none.
        """
        gripper = end_effector_of(spec, self.frame).gripper
        if gripper is None:
            raise ConfigurationError(
                f"the end effector of robot '{spec.name}' has no gripper: give joints, open_position and "
                "closed_position, or leave the term out"
            )
        return gripper

    def build(self, name: str, robot: Robot) -> BinaryGripper:
        return BinaryGripper(name, robot, self)


class BinaryGripper(MotionGenerator):
    """One command for all joints of a gripper, :class:`BinaryGripperConfig`."""

    bounded = True

    def __init__(self, name: str, robot: Robot, config: BinaryGripperConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, 1, (JointTarget.POSITION,))
        opened, closed = config.open_position, config.closed_position
        if opened is None or closed is None:
            gripper = config.gripper_of(robot.spec)
            opened = gripper.open_position if opened is None else opened
            closed = gripper.closed_position if closed is None else closed
        patterns = config.default_joints(robot.spec) if config.joints is None else config.joints
        ends = [gripper_positions(value, patterns, joints, robot.spec, name) for value in (opened, closed)]
        self._open, self._closed = torch.tensor(ends, device=self.device).unbind()

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        command = inputs["command"]
        # Zero opens: a policy that outputs nothing must not grip.
        targets = torch.where(command < constant(0.0, self.device), self._closed, self._open)
        # Where a command is not a number the targets are none either, and refused by the robot.
        return {JointTarget.POSITION: torch.where(command.isnan(), command, targets)}

    @property
    def ends(self) -> tuple[Tensor, Tensor]:
        """Open and closed positions (k,) of the joints, rad or m."""
        return self._open, self._closed

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        # The ends of the range: any positive number opens, but noise on a small one could close.
        return (2.0 * gripper_open.to(torch.float32) - 1.0).unsqueeze(-1)


def gripper_positions(
    value: float | tuple[float, ...], patterns: Sequence[str], joints: Sequence[int], spec: RobotSpec, term: str
) -> list[float]:
    """A position for each of the joints, given by index.

    Raises:
        ConfigurationError: there are other than one position, or one for each pattern.
    """
    if not isinstance(value, tuple):
        return [value] * len(joints)
    if len(value) != len(patterns):
        raise ConfigurationError(
            f"action term '{term}' has {len(value)} positions for {len(patterns)} entries of its joints: give one for "
            "each, or one number for all"
        )
    by_pattern = dict(zip(patterns, value, strict=True))
    # Positions are given per pattern, and joints may match in another order.
    by_joint = match_values(by_pattern, spec.articulation.joint_names, "joint", f"action term '{term}'")
    return [by_joint[joint] for joint in joints]
