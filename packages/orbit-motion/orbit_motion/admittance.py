"""Admittance control: an arm that is driven by positions yields to forces as a mass on springs would."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.base import CommandMode, JointTarget
from orbit_core.actions.differential_ik import PoseTermConfig, bounded_targets
from orbit_core.actions.ik import PoseFollower, damped_least_squares, displaced
from orbit_core.dynamics.indexing import write_rows
from orbit_core.dynamics.transforms import pose_error
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.interfaces.layout import joint_limits
from orbit_motion.force_reading import ForceReading

# Rate (1/s) at which targets go beyond the wanted positions, until the drives hold the joints there.
_SAG_RATE = 4.0


@dataclass(frozen=True, kw_only=True)
class AdmittanceConfig(PoseTermConfig):
    """A command is a pose of the hand, or its change, from which measured forces displace the hand.

    The displacement u is that of a mass on springs, ``m u'' + 2 zeta sqrt(k m) u' + k u = f``, f the wrench that the
    hand feels, in world axes, integrated once a command with velocities at the end of the step. Joints follow by
    inverse kinematics and their drives, whose own yielding an integral takes out (Hogan, 1985; Siciliano et al.,
    Robotics, 2009, section 9.2.2). With k = 0 and ``damping`` given the hand can be led by hand.
    """

    name: ClassVar[str] = "admittance"
    above_zero: ClassVar[tuple[str, ...]] = (
        *PoseTermConfig.above_zero, "mass", "inertia", "damping", "max_joint_step",
    )  # fmt: skip
    none_below_zero: ClassVar[tuple[str, ...]] = ("stiffness", "rotational_stiffness", "inverse_damping")
    unbounded: ClassVar[tuple[str, ...]] = (*PoseTermConfig.unbounded, "max_joint_step")

    sensor: str | None = None
    """A contact or force-torque sensor of the scene; it must be named."""
    mode: CommandMode = CommandMode.INTEGRATED
    mass: float = 4.0
    """kg"""
    inertia: float = 0.4
    """kg m^2"""
    stiffness: float = 400.0
    """N/m"""
    rotational_stiffness: float = 30.0
    """N m/rad"""
    damping: tuple[float, float] | None = None
    """N s/m and N m s/rad; None damps critically."""
    inverse_damping: float = 0.05
    """See :func:`orbit_core.actions.ik.joint_delta`."""
    max_joint_step: float = 0.3
    """rad or m by which targets may run ahead of measured positions."""

    def build(self, name: str, robot: Robot) -> Admittance:
        return Admittance(name, robot, self)


class Admittance(PoseFollower):
    """Six commands, :class:`AdmittanceConfig`. Targets are clipped to the joints' limits."""

    def __init__(self, name: str, robot: Robot, config: AdmittanceConfig) -> None:
        super().__init__(
            name, robot, config.joint_indices(robot.spec, name), 6, (JointTarget.POSITION, JointTarget.VELOCITY)
        )
        self.config = config
        self.frame = config.frame_of(robot)
        self._pose = config.pose_command(robot)
        if config.mode is CommandMode.RELATIVE:
            raise ConfigurationError(
                f"action term '{name}': forces displace the measured pose, from which relative commands count: take "
                "integrated or absolute ones"
            )
        self._mass = self._six(config.mass, config.inertia)
        self._stiffness = self._six(config.stiffness, config.rotational_stiffness)
        # Critical damping of a mass m on a spring k is 2 sqrt(k m).
        critical = 2.0 * (self._stiffness * self._mass).sqrt()
        self._damping = critical if config.damping is None else self._six(*config.damping)
        if not bool((self._damping > 0.0).all()):
            raise ConfigurationError(
                f"action term '{name}': nothing damps a motion without stiffness: give damping, or stiffness above zero"
            )
        speeds = joint_limits(robot.spec, "velocity_limit")[self.joints]
        self._fastest = torch.as_tensor(speeds, dtype=torch.float32, device=self.device)
        self._offset, self._rate = torch.zeros(2, self.num_envs, 6, device=self.device).unbind()
        self._sag = torch.zeros(self.num_envs, len(self.joints), device=self.device)

    def enter(self, world: World, step_dt: float) -> None:
        if self.config.sensor is None:
            raise ConfigurationError(
                f"action term '{self.name}' needs forces: name a contact or force-torque sensor of the scene"
            )
        self._reading = ForceReading(world, self.config.sensor, self.robot, self.frame, self.name)
        self._dt = step_dt
        # Stability of the semi-implicit step in ``compute``: it diverges beyond this stiffness.
        if bool((step_dt**2 * self._stiffness >= 4.0 * self._mass + 2.0 * step_dt * self._damping).any()):
            raise ConfigurationError(
                f"action term '{self.name}': such a stiffness on such a mass is unstable in steps of {step_dt:g} s: "
                "take more mass, less stiffness or more commands a second"
            )

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        reference = self._pose.target(inputs["command"])
        # The sensor measures the force on the hand; the law needs the one that the hand exerts.
        felt = -self._reading.read()
        # The damper acts with the velocity at the end of the step, which bounds every damping.
        rate = self._rate + self._dt / self._mass * (felt - self._stiffness * self._offset)
        self._rate.copy_(rate / (1.0 + self._dt * self._damping / self._mass))
        self._offset.add_(self._dt * self._rate)
        error = pose_error(self.robot.frame_pose(self.frame), displaced(reference, self._offset))
        jacobian = self.robot.jacobian(self.frame, self.joints)
        delta = damped_least_squares(jacobian, error, self.config.inverse_damping)
        # Without velocity targets the drives' dampers would hold the joints back.
        velocities = damped_least_squares(jacobian, self._rate, self.config.inverse_damping)
        most = self.config.max_joint_step
        self._sag.copy_(torch.clamp(self._sag + _SAG_RATE * self._dt * delta, -most, most))
        targets = bounded_targets(self, delta + self._sag, most)
        return {
            JointTarget.POSITION: targets,
            JointTarget.VELOCITY: torch.clamp(velocities, -self._fastest, self._fastest),
        }

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self._pose.encode(pose)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._pose.reset(env_ids)
        write_rows(self._offset, 0.0, env_ids)
        write_rows(self._rate, 0.0, env_ids)
        write_rows(self._sag, 0.0, env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return {**self._pose.memory(), "offset": self._offset, "rate": self._rate, "sag": self._sag}

    def _six(self, linear: float, angular: float) -> Tensor:
        return torch.tensor([linear] * 3 + [angular] * 3, device=self.device)
