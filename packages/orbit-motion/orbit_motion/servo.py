"""Motion generators whose law runs before every physics step, as that of a torque-controlled robot does.

A command sets what the law aims at; in between the law follows the measured state. It asks for accelerations, which are
held to what the joints' position and velocity limits leave, and become efforts by the equation of motion:

``efforts = M(q) a + bias(q, v)``, clipped to the effort limits (computed torque; Siciliano et al., Robotics: Modelling,
Planning and Control, 2009, section 8.5.2).

Dry friction that the description tells of is compensated (:meth:`ArmDynamics.against_friction`).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from orbit_core.actions.arm_dynamics import ArmDynamics, ArmState
from orbit_core.actions.base import MotionGenerator
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.interfaces.layout import joint_limits
from orbit_motion.fusion import Fused

# 1/s: joints near a limit of position approach it no faster than this times the distance that is left.
_LIMIT_RATE = 10.0
# Physics steps in which what exceeds the velocity that a joint may have is taken off.
_BRAKING_STEPS = 2.0


class Servo(MotionGenerator):
    """Efforts for some joints of a robot, anew before every physics step.

    The drives of the joints have no gains (:attr:`~orbit_core.actions.ActionTerm.unwanted_gains`).

    Raises:
        ConfigurationError: a joint can exert no effort.
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
                    f"joint '{robot.joint_names[joint]}' of '{robot.name}' has effort limit {effort:g}, so that action "
                    f"term '{name}' cannot move it by efforts: choose a position space, or raise the limit"
                )
        self._strongest, self._fastest = (
            torch.as_tensor(limits, dtype=torch.float32, device=self.device) for limits in (efforts, speeds)
        )

    @abstractmethod
    def aim(self, command: Tensor) -> None:
        """Take a command (N, command_size) in."""

    @abstractmethod
    def aims(self) -> dict[str, Tensor]:
        """What the law aims at: all tensors (N, ...) besides the robot's state that it depends on, by name."""

    @abstractmethod
    def accelerations(self, state: ArmState, aims: Mapping[str, Tensor]) -> Tensor:
        """(N, k) rad/s^2 or m/s^2 that the joints shall have now.

        A function of its arguments and of constants alone, so that it can be one kernel
        (:class:`orbit_motion.fusion.Fused`).
        """

    def check_stable(self) -> None:
        """Refuse gains with which steps of ``physics_dt`` diverge.

        Raises:
            ConfigurationError: says which gain is stable.
        """

    def enter(self, world: World, step_dt: float) -> None:
        self.physics_dt = world.physics_dt
        self.dynamics = ArmDynamics(self.robot, self.joints, world.physics_dt, world.scene.gravity)
        self.check_stable()
        self.law = Fused(self._efforts)
        world.add_servo(self.turn)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        self.aim(inputs["command"])
        return {}

    def turn(self) -> None:
        """Set the efforts for the next physics step; the world calls it."""
        (efforts,) = self.law(**self.dynamics.measured(), **self.aims())
        self.robot.set_effort_targets(efforts, self.joints)

    def _efforts(self, poses: Tensor, positions: Tensor, velocities: Tensor, **aims: Tensor) -> tuple[Tensor]:
        """(N, k)"""
        state = self.dynamics.state_of(poses, positions, velocities)
        wanted = self._within_limits(state, self.accelerations(state, aims))
        efforts = self.dynamics.against_friction(state, wanted, state.efforts(wanted))
        return (torch.clamp(efforts, -self._strongest, self._strongest),)

    def _within_limits(self, state: ArmState, accelerations: Tensor) -> Tensor:
        highest = torch.minimum(self._fastest, _LIMIT_RATE * (self.upper_limits - state.positions))
        lowest = torch.maximum(-self._fastest, _LIMIT_RATE * (self.lower_limits - state.positions))
        time = _BRAKING_STEPS * self.physics_dt
        return torch.clamp(accelerations, (lowest - state.velocities) / time, (highest - state.velocities) / time)


def check_rate(name: str, load: float, what: str) -> None:
    """Refuse ``load``, the largest ``h^2 k + 2 h d`` over the inertia, where steps of h seconds diverge.

    See :mod:`orbit_core.actuators.stability`.

    Raises:
        ConfigurationError: it is four or more.
    """
    if load >= 4.0:
        raise ConfigurationError(
            f"action term '{name}': {what} is unstable, for its efforts are those of the state at the beginning of "
            f"each physics step: take at most {4.0 / load:.2g} times it, or a shorter physics_dt"
        )
