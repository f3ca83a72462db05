"""Commands are joint efforts, or changes of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.arm_dynamics import ArmDynamics
from orbit_core.actions.base import JointTarget, MotionGenerator
from orbit_core.actions.ik import towards_pose
from orbit_core.actions.modes import CommandMode, LastTargets
from orbit_core.actions.term import ActionTerm
from orbit_core.interfaces import ConfigurationError, Robot
from orbit_core.interfaces.layout import joint_limits

_PURSUIT_FREQUENCY = 6.0
"""rad/s: of the critically damped motion that an expert asks for."""


@dataclass(frozen=True, kw_only=True)
class JointEffortConfig(ActionTerm):
    """A command is the effort of each joint, or its change.

    Absolute: ``effort target = scale * command``. Relative: the effort applied in the last physics step is added.
    Integrated: the last target is added, from the applied efforts after a reset. Targets are clipped to the joints'
    effort limits. Position and velocity targets are put at the measured state at every turn, so that a drive with gains
    resists only what changes between two turns; a drive meant for efforts has none.
    """

    name: ClassVar[str] = "joint_effort"
    above_zero: ClassVar[tuple[str, ...]] = ("scale",)
    unwanted_gains: ClassVar[tuple[str, ...]] = (
        "stiffness",
        "damping",
    )

    scale: float | None = None
    """N m or N; None takes each joint's effort limit."""
    mode: CommandMode = CommandMode.ABSOLUTE

    def build(self, name: str, robot: Robot) -> JointEffort:
        return JointEffort(name, robot, self)


class JointEffort(MotionGenerator):
    """One command a joint, :class:`JointEffortConfig`."""

    bounded = True

    def __init__(self, name: str, robot: Robot, config: JointEffortConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, len(joints), tuple(JointTarget))
        self.config = config
        scales = _effort_limits(robot, joints) if config.scale is None else [config.scale] * len(joints)
        self._scale = torch.tensor(scales, device=self.device)
        limits = joint_limits(robot.spec, "effort_limit")[joints]
        self._strongest = torch.as_tensor(limits, dtype=torch.float32, device=self.device)
        self._last = LastTargets(self.num_envs, (len(joints),), self.device)
        self._dynamics: ArmDynamics | None = None

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        efforts = self._origin() + self._scale * inputs["command"]
        efforts = torch.clamp(efforts, -self._strongest, self._strongest)
        if self.config.mode is CommandMode.INTEGRATED:
            self._last.keep(efforts)
        return {
            JointTarget.POSITION: self.positions,
            JointTarget.VELOCITY: self.velocities,
            JointTarget.EFFORT: efforts,
        }

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        """Computed torque: the efforts that accelerate the joints towards ``pose``, with the base and all others held.

        Drives are not in the model.
        """
        return self._pursuing(towards_pose(self.robot, self.joints, pose))

    def encode_positions(self, positions: Tensor) -> Tensor:
        """The command (N, k) that accelerates the joints towards ``positions`` (N, k), likewise."""
        return self._pursuing(positions - self.positions)

    def encode_efforts(self, efforts: Tensor) -> Tensor:
        """The command that asks for efforts (N, joints) in N m or N, as far as it can."""
        return ((efforts - self._origin()) / self._scale).clamp(-1.0, 1.0)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._last.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return self._last.memory() if self.config.mode is CommandMode.INTEGRATED else {}

    def _pursuing(self, displacement: Tensor) -> Tensor:
        frequency = _PURSUIT_FREQUENCY
        acceleration = frequency**2 * displacement - 2.0 * frequency * self.velocities
        if self._dynamics is None:
            self._dynamics = ArmDynamics(self.robot, self.joints)
        state = self._dynamics.state()
        return self.encode_efforts(self._dynamics.against_friction(state, acceleration, state.efforts(acceleration)))

    def _origin(self) -> Tensor | float:
        """What commands are added to."""
        if self.config.mode is CommandMode.ABSOLUTE:
            return 0.0
        applied = self.robot.joint_efforts[:, self._columns]
        return applied if self.config.mode is CommandMode.RELATIVE else self._last.read(applied)


def _effort_limits(robot: Robot, joints: list[int]) -> list[float]:
    limits = joint_limits(robot.spec, "effort_limit")
    for joint in joints:
        if not 0.0 < limits[joint] < float("inf"):
            raise ConfigurationError(
                f"joint '{robot.joint_names[joint]}' of '{robot.name}' has effort limit {limits[joint]}, which scales "
                "no command: give JointEffortConfig a scale"
            )
    return limits[joints].tolist()
