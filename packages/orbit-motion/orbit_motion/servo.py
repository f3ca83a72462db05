"""Motion generators whose law runs before every physics step, like the law of a torque-controlled robot.

A command sets the law's aims; in between the law follows the measured state. It requests accelerations, which are
clamped to what the joints' position and velocity limits allow, and become efforts by the equation of motion:

``efforts = M(q) a + bias(q, v)``, clipped to the effort limits (computed torque; Siciliano et al., Robotics: Modelling,
Planning and Control, 2009, section 8.5.2).

Dry friction of the description is compensated (:meth:`ArmDynamics.against_friction`).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from orbit_core.actions.arm_dynamics import ArmDynamics, ArmState
from orbit_core.actions.base import MotionGenerator
from orbit_core.dynamics.arguments import FINITE, check_numbers
from orbit_core.interfaces import ConfigurationError, JointTarget, Robot, World
from orbit_core.interfaces.layout import joint_limits
from orbit_motion.fusion import Fused

# 1/s: a joint near a position limit approaches it at most at this rate times the remaining distance.
_LIMIT_RATE = 10.0
# Physics steps within which a joint that is too fast brakes to its velocity limit.
_BRAKING_STEPS = 2.0


class Servo(MotionGenerator):
    """Motion generator that computes efforts for some joints of a robot before every physics step.

    The drives of the joints have no gains (:attr:`~orbit_core.actions.ActionTerm.unwanted_gains`).

    Raises:
        ConfigurationError: a joint has no effort limit above zero.
    """

    dynamics: ArmDynamics
    physics_dt: float
    law: Fused
    """Efforts from the robot's state and the aims."""

    def __init__(self, name: str, robot: Robot, joints: Sequence[int], command_size: int) -> None:
        super().__init__(name, robot, joints, command_size, ())
        efforts, speeds = (joint_limits(robot.spec, what)[self.joints] for what in ("effort_limit", "velocity_limit"))
        for joint, effort in zip(self.joints, efforts, strict=True):
            if not effort > 0.0:
                raise ConfigurationError(
                    f"joint '{robot.joint_names[joint]}' of '{robot.name}' has effort limit {effort:g}, so action term "
                    f"'{name}' cannot move it by efforts: choose a position space, or raise the limit"
                )
        self._strongest, self._fastest = (
            torch.as_tensor(limits, dtype=torch.float32, device=self.device) for limits in (efforts, speeds)
        )

    @abstractmethod
    def aim(self, command: Tensor) -> None:
        """Set the aims from a command (N, command_size)."""

    @abstractmethod
    def aims(self) -> dict[str, Tensor]:
        """Return the aims by name: all tensors (N, ...) that the law depends on, except the robot's state."""

    @abstractmethod
    def accelerations(self, state: ArmState, aims: Mapping[str, Tensor]) -> Tensor:
        """Compute the accelerations (N, k) in rad/s^2 or m/s^2 that the joints should have now.

        The result depends on the arguments and on constants only, so that it can become one kernel
        (:class:`orbit_motion.fusion.Fused`).
        """

    def check_stable(self) -> None:
        """Refuse gains with which steps of ``physics_dt`` diverge.

        Raises:
            ConfigurationError: a gain is too high; the message names a stable one.
        """

    def enter(self, world: World, step_dt: float) -> None:
        self.physics_dt = world.physics_dt
        self.dynamics = ArmDynamics(self.robot, self.joints, world.physics_dt, world.scene.gravity)
        self.check_stable()
        self.law = Fused(self._efforts)
        # The law clamps its efforts, and commands are checked as they come, so that no physics step checks them again.
        self._write = self.robot.target_writer(JointTarget.EFFORT, self.joints, checked=False)
        world.add_servo(self.turn)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        # A clamp passes NaN on: what is no number must not reach the law.
        check_numbers(inputs["command"], FINITE, f"command of '{self.name}' for robot '{self.robot.name}'")
        self.aim(inputs["command"])
        return {}

    def turn(self) -> None:
        """Set the efforts for the next physics step; the world calls it."""
        (efforts,) = self.law(**self.dynamics.measured(), **self.aims())
        self._write(efforts)

    def _efforts(self, poses: Tensor, positions: Tensor, velocities: Tensor, **aims: Tensor) -> tuple[Tensor]:
        """Compute the efforts (N, k) from the robot's state and the aims."""
        state = self.dynamics.state_of(poses, positions, velocities)
        wanted = self._within_limits(state, self.accelerations(state, aims))
        efforts = self.dynamics.against_friction(state, wanted, state.efforts(wanted))
        return (torch.clamp(efforts, -self._strongest, self._strongest),)

    def _within_limits(self, state: ArmState, accelerations: Tensor) -> Tensor:
        # Velocity limits shrink towards a position limit, so that the joint stops there instead of hitting it.
        highest = torch.minimum(self._fastest, _LIMIT_RATE * (self.upper_limits - state.positions))
        lowest = torch.maximum(-self._fastest, _LIMIT_RATE * (self.lower_limits - state.positions))
        time = _BRAKING_STEPS * self.physics_dt
        return torch.clamp(accelerations, (lowest - state.velocities) / time, (highest - state.velocities) / time)


def check_rate(name: str, load: float, what: str) -> None:
    """Refuse ``load``, the largest ``h^2 k + 2 h d`` over the inertia, where steps of h seconds diverge.

    See :mod:`orbit_core.actuators.stability`.

    Raises:
        ConfigurationError: ``load`` is four or more.
    """
    # A spring and damper whose force is explicit diverges under semi-implicit Euler from h^2 k / m + 2 h d / m = 4.
    if load >= 4.0:
        raise ConfigurationError(
            f"action term '{name}': {what} is unstable, because its efforts use the state at the beginning of "
            f"each physics step: take at most {4.0 / load:.2g} times it, or a shorter physics_dt"
        )
