"""Commands are joint efforts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.dynamics.rigid_body import RigidBodyModel
from orbit_core.interfaces import ConfigurationError, Robot
from orbit_core.interfaces.layout import joint_limits
from orbit_core.motion.base import JointTarget, MotionGenerator
from orbit_core.motion.ik import towards_pose
from orbit_core.motion.term import ActionTerm

_PURSUIT_FREQUENCY = 6.0
"""rad/s: of the critically damped motion that an expert asks for."""


@dataclass(frozen=True, kw_only=True)
class JointEffortConfig(ActionTerm):
    """A command is the effort of each joint.

    ``effort target = scale * command``. Position and velocity targets are put at the measured state at every turn, so
    that a drive with gains resists only what changes between two turns; a drive meant for efforts has none.
    """

    name: ClassVar[str] = "joint_effort"
    unwanted_gains: ClassVar[tuple[str, ...]] = (
        "stiffness",
        "damping",
    )

    scale: float | None = None
    """N m or N; None takes each joint's effort limit."""

    def build(self, name: str, robot: Robot) -> JointEffort:
        return JointEffort(name, robot, self)


class JointEffort(MotionGenerator):
    """One command a joint, :class:`JointEffortConfig`."""

    def __init__(self, name: str, robot: Robot, config: JointEffortConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, len(joints), tuple(JointTarget))
        self.config = config
        scales = _effort_limits(robot, joints) if config.scale is None else [config.scale] * len(joints)
        self._scale = torch.tensor(scales, device=self.device)
        self._model: RigidBodyModel | None = None

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        return {
            JointTarget.POSITION.value: self.positions,
            JointTarget.VELOCITY.value: self.velocities,
            JointTarget.EFFORT.value: self._scale * inputs["command"],
        }

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        """Computed torque: the efforts that accelerate the joints towards ``pose``, with the base and all others held.

        Drives and passive damping are not in the model.
        """
        robot, frequency = self.robot, _PURSUIT_FREQUENCY
        displacement = towards_pose(robot, self.joints, pose)
        acceleration = frequency**2 * displacement - 2.0 * frequency * self.velocities
        if self._model is None:
            gravity = (0.0, 0.0, 0.0) if robot.spec.gravity_compensation else (0.0, 0.0, -9.81)
            self._model = RigidBodyModel(robot.spec.articulation, True, self.device, gravity=gravity)
        mass = self._model.mass_matrix(robot.link_poses)[:, self.joints][:, :, self.joints]
        bias = self._model.bias_forces(robot.link_poses, robot.root_velocity, robot.joint_velocities)[:, self.joints]
        efforts = (mass @ acceleration.unsqueeze(-1)).squeeze(-1) + bias
        return (efforts / self._scale).clamp(-1.0, 1.0)


def _effort_limits(robot: Robot, joints: list[int]) -> list[float]:
    limits = joint_limits(robot.spec, "effort_limit")
    for joint in joints:
        if not 0.0 < limits[joint] < float("inf"):
            raise ConfigurationError(
                f"joint '{robot.joint_names[joint]}' of '{robot.name}' has effort limit {limits[joint]}, which scales "
                "no command: give JointEffortConfig a scale"
            )
    return limits[joints].tolist()
