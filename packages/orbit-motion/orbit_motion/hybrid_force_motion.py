"""Hybrid force and motion control: the hand pushes along some axes and moves along the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.dynamics.transforms import quat_to_matrix
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.scene import RobotSpec
from orbit_motion.admittance import ForceReading
from orbit_motion.compliant import HandState, check_rate, without_free
from orbit_motion.gains import CommandedGains
from orbit_motion.operational_space import OperationalSpace, OperationalSpaceConfig

_NAMES = ("x", "y", "z")


@dataclass(frozen=True, kw_only=True)
class HybridForceMotionConfig(OperationalSpaceConfig):
    """A command is, along each axis, a displacement of the hand or the force that it shall exert.

    With the selection ``S = R diag(s) R^T`` of the axes that move, R the axes' rotation,

    ``wrench = Lambda (S x''* - J' v - J a0) + (1 - S) (f* + k_p (f* - f) + k_i int(f* - f) dt - d x')``

    f measured, x''* as in operational-space control (Khatib, 1987, section IV; selection matrices: Raibert and Craig,
    Hybrid Position/Force Control of Manipulators, Journal of Dynamic Systems, Measurement, and Control 102, 1981). On a
    surface the two do not disturb each other. Without a sensor the force is that of the model, ``k_p = k_i = 0``. Where
    nothing is touched the hand approaches by ``f* / d``.
    """

    name: ClassVar[str] = "hybrid"
    above_zero: ClassVar[tuple[str, ...]] = (*OperationalSpaceConfig.above_zero, "force_scale", "torque_scale")
    none_below_zero: ClassVar[tuple[str, ...]] = (
        *OperationalSpaceConfig.none_below_zero, "force_gain", "force_integral", "force_damping", "torque_damping",
    )  # fmt: skip

    force: tuple[bool, ...] = (False, False, True, False, False, False)
    """True for axes that push: x, y, z, about x, about y, about z."""
    axes: str | None = None
    """Link or frame of the robot that defines the axes; None takes the world's."""
    sensor: str | None = None
    """A contact or force-torque sensor of the scene. Give it the physics rate: it is read at every physics step."""
    force_scale: float = 20.0
    """N of one unit of command."""
    torque_scale: float = 2.0
    """N m of one unit of command."""
    force_gain: float = 0.5
    """k_p, below 1, for what is measured is a step old."""
    force_integral: float = 10.0
    """k_i, 1/s. The integral holds at most the force of one unit of command."""
    force_damping: float = 100.0
    """d along axes, N s/m."""
    torque_damping: float = 5.0
    """d about axes, N m s/rad."""

    def components(self, spec: RobotSpec, name: str) -> tuple[str, ...]:
        if len(self.force) != 6:
            raise ConfigurationError(f"action term '{name}': force names {len(self.force)} of 6 axes")
        moves = (*_NAMES, *(f"about {axis}" for axis in _NAMES))
        pushes = (*(f"force {axis}" for axis in _NAMES), *(f"torque {axis}" for axis in _NAMES))
        axes = tuple(push if chosen else move for chosen, push, move in zip(self.force, pushes, moves, strict=True))
        return (*axes, *CommandedGains.components(self.gains, axes))

    def build(self, name: str, robot: Robot) -> HybridForceMotion:
        return HybridForceMotion(name, robot, self)


class HybridForceMotion(OperationalSpace):
    """Six commands, or more for gains, :class:`HybridForceMotionConfig`."""

    def __init__(self, name: str, robot: Robot, config: HybridForceMotionConfig) -> None:
        super().__init__(name, robot, config)
        self.config = config
        """Settings, as the action term gives them."""
        if config.force_gain >= 1.0:
            raise ConfigurationError(
                f"action term '{name}': a force_gain of {config.force_gain:g} is unstable: take less than 1"
            )
        if config.axes is not None:
            robot.frame_pose(config.axes)  # rejects an unknown frame
        self._moves = torch.tensor([float(not chosen) for chosen in config.force], device=self.device)
        self._scale = torch.tensor([config.force_scale] * 3 + [config.torque_scale] * 3, device=self.device)
        self._damping = torch.tensor([config.force_damping] * 3 + [config.torque_damping] * 3, device=self.device)
        self._wanted, self._integral = torch.zeros(2, self.num_envs, 6, device=self.device).unbind()
        self._reading: ForceReading | None = None

    def enter(self, world: World, step_dt: float) -> None:
        if self.config.sensor is not None:
            self._reading = ForceReading(world, self.config.sensor, self.robot, self.frame, self.name)
            if any(self.config.force[3:]) and not self._reading.has_torque:
                raise ConfigurationError(
                    f"action term '{self.name}' controls torques, which the contact sensor '{self.config.sensor}' does "
                    "not measure: name a force-torque sensor"
                )
        super().enter(world, step_dt)

    def check_stable(self) -> None:
        super().check_stable()
        pushed = self._damping * (1.0 - self._moves)
        # A damper along the pushing axes diverges if it stops the hand within less than a step.
        quickest = torch.linalg.eigvalsh(pushed.sqrt().unsqueeze(-1) * self.workspace_mobility() * pushed.sqrt()).max()
        told = f"a force_damping of {self.config.force_damping:g} or torque_damping of {self.config.torque_damping:g}"
        check_rate(self.name, 2.0 * self.physics_dt * float(quickest), told)

    def aim(self, command: Tensor) -> None:
        rotation = self._rotation(self.robot.link_poses)
        along = _turned(rotation, command[:, :6] * self._moves)
        self._goal.keep(self._pose.target(along, self._selection(rotation)))
        self._wanted.copy_(_turned(rotation, command[:, :6] * (1.0 - self._moves) * self._scale))
        self.gains.take(command[:, 6:])

    def aims(self) -> dict[str, Tensor]:
        return {**super().aims(), "pushing": self._pushing()}

    def hand_accelerations(self, hand: HandState, free: Tensor, aims: Mapping[str, Tensor]) -> Tensor:
        selection = self._selection(self._rotation(hand.links))
        moving = torch.bmm(selection, self.spring_accelerations(hand, aims).unsqueeze(-1)).squeeze(-1)
        pushing = aims["pushing"] - self._damping * hand.velocity
        pushing = pushing - torch.bmm(selection, pushing.unsqueeze(-1)).squeeze(-1)
        return hand.joint_accelerations(hand.wrench(moving - without_free(hand, free)) + pushing) + free

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        rotation = self._rotation(self.robot.link_poses)
        command = super().encode(pose, gripper_open)
        along = _turned(rotation.mT, command[:, :6]) * self._moves
        return torch.cat((along, command[:, 6:]), 1)

    def reset(self, env_ids: Tensor | None = None) -> None:
        super().reset(env_ids)
        write_rows(self._integral, 0.0, env_ids)
        write_rows(self._wanted, 0.0, env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return {**super().memory(), "wanted": self._wanted, "integral": self._integral}

    def _pushing(self) -> Tensor:
        """Return the force and torque (N, 6), world axes, that drive the measured ones to the wanted ones."""
        if self._reading is None:
            return self._wanted
        missing = self._wanted - self._reading.read()
        grown = self._integral + self.physics_dt * self.config.force_integral * missing
        self._integral.copy_(torch.clamp(grown, -self._scale, self._scale))
        return self._wanted + self.config.force_gain * missing + self._integral

    def _rotation(self, links: Tensor) -> Tensor:
        """Return the axes' rotation (N, 3, 3) in the world, for link poses (N, L, 7)."""
        if self.config.axes is None:
            return torch.eye(3, device=self.device).expand(links.shape[0], 3, 3)
        return quat_to_matrix(self.dynamics.model.kinematics.frame_pose(links, self.config.axes)[:, 3:])

    def _selection(self, rotation: Tensor) -> Tensor:
        """Return the projection (N, 6, 6) on the directions that move."""
        linear, angular = (rotation * part @ rotation.mT for part in self._moves.split(3))
        zero = torch.zeros_like(linear)
        return torch.cat((torch.cat((linear, zero), 2), torch.cat((zero, angular), 2)), 1)


def _turned(rotation: Tensor, command: Tensor) -> Tensor:
    """Rotate two vectors (N, 6) by (N, 3, 3)."""
    return torch.bmm(command.unflatten(1, (2, 3)), rotation.mT).flatten(1)
