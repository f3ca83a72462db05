"""Joint impedance control: springs and dampers draw the joints to commanded positions; gains may be commands too."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from orbit_core.actions.arm_dynamics import ArmState
from orbit_core.actions.base import CommandMode, LastTargets
from orbit_core.actions.ik import towards_pose
from orbit_core.actions.term import ActionTerm
from orbit_core.dynamics.rigid_body import workspace_mass_matrices
from orbit_core.interfaces import Robot
from orbit_core.interfaces.layout import joint_constants
from orbit_core.scene import RobotSpec
from orbit_motion.compliant import Servo, check_rate
from orbit_motion.gains import CommandedGains, GainCommand, GainRange


@dataclass(frozen=True, kw_only=True)
class JointImpedanceConfig(ActionTerm):
    """A command is the position of each joint, or its change, and, if asked for, its stiffness and damping ratio.

    With inertia compensation each joint moves as a unit mass on a spring, ``a = k (q* - q) - 2 zeta sqrt(k) v``, k in
    1/s^2. Without, ``effort = k (q* - q) - 2 zeta sqrt(k M_jj) v``, k in N m/rad or N/m, M_jj the inertia that the
    joint moves now. Gravity and velocity forces are cancelled, which ``gravity_compensation`` switches.
    """

    name: ClassVar[str] = "joint_impedance"
    above_zero: ClassVar[tuple[str, ...]] = ("scale",)
    none_below_zero: ClassVar[tuple[str, ...]] = ("stiffness", "damping_ratio")
    unwanted_gains: ClassVar[tuple[str, ...]] = ("stiffness", "damping")

    scale: float = 2.0
    """rad or m from home (absolute), or for one command (otherwise)."""
    mode: CommandMode = CommandMode.ABSOLUTE
    """Reference that a command counts from."""
    stiffness: float = 150.0
    """1/s^2 with inertia compensation, else N m/rad or N/m."""
    damping_ratio: float = 1.0
    """zeta; 1 is critical."""
    gains: GainCommand = GainCommand.FIXED
    """Gains that the command sets, besides the positions."""
    stiffness_factor: GainRange = GainRange(low=0.1, high=4.0)
    """Factor of ``stiffness``, from the command's -1 to its 1."""
    ratio_range: GainRange = GainRange(low=0.5, high=2.0)
    """Damping ratio, from the command's -1 to its 1."""
    inertia_compensation: bool = True
    """True to multiply accelerations by the whole mass matrix, so that joints do not disturb each other."""
    gravity_compensation: bool = True

    def components(self, spec: RobotSpec, name: str) -> tuple[str, ...]:
        joints = super().components(spec, name)
        return (*joints, *CommandedGains.components(self.gains, joints))

    def build(self, name: str, robot: Robot) -> JointImpedance:
        return JointImpedance(name, robot, self)


class JointImpedance(Servo):
    """One to three commands per joint, :class:`JointImpedanceConfig`."""

    def __init__(self, name: str, robot: Robot, config: JointImpedanceConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        count = len(joints)
        super().__init__(name, robot, joints, len(config.components(robot.spec, name)))
        self.config = config
        """Settings, as the action term gives them."""
        self.gains = CommandedGains(
            config.gains, [config.stiffness] * count, config.damping_ratio, config.stiffness_factor,
            config.ratio_range, self.num_envs, self.device,
        )  # fmt: skip
        """Stiffnesses and damping ratios, fixed or commanded."""
        self._home = robot.home_positions[joints]
        self._last = LastTargets(self.num_envs, (count,), self.device)

    def check_stable(self) -> None:
        stiffness, ratio, step = self.gains.stiffest[0], self.gains.most_damped, self.physics_dt
        what = f"a stiffness of {stiffness:g} with a damping ratio of {ratio:g}"
        if self.config.inertia_compensation:
            check_rate(self.name, step**2 * stiffness + 4.0 * step * ratio * stiffness**0.5, what)
            return
        # Without compensation the joints couple through the mass matrix: its eigenvalues decide, not its diagonal.
        spec = self.robot.spec
        armature = joint_constants(spec, "armature") + step * joint_constants(spec, "damping")
        masses = workspace_mass_matrices(spec.articulation, armature=armature.tolist())[:, self.joints][
            :, :, self.joints
        ]
        moved = np.diagonal(masses, axis1=1, axis2=2)
        roots = np.sqrt(step**2 * stiffness + 4.0 * step * ratio * np.sqrt(stiffness * moved))
        loads = roots[:, :, None] * np.linalg.inv(masses) * roots[:, None]
        check_rate(self.name, float(np.linalg.eigvalsh(loads).max()), what)

    def aim(self, command: Tensor) -> None:
        count = len(self.joints)
        targets = self._origin() + self.config.scale * command[:, :count]
        self._last.keep(torch.clamp(targets, self.lower_limits, self.upper_limits))
        self.gains.take(command[:, count:])

    def aims(self) -> dict[str, Tensor]:
        return {**self._last.parts(), **self.gains.varying()}

    def accelerations(self, state: ArmState, aims: Mapping[str, Tensor]) -> Tensor:
        stiffness, ratio = self.gains.of(aims)
        offset = LastTargets.read_of(aims, state.positions) - state.positions
        if self.config.inertia_compensation:
            # As a unit mass: the damping is 2 zeta sqrt(k).
            wanted = stiffness * offset - 2.0 * ratio * stiffness.sqrt() * state.velocities
            return (
                wanted if self.config.gravity_compensation else wanted + state.accelerations(torch.zeros_like(wanted))
            )
        moved = state.mass.diagonal(dim1=1, dim2=2)
        efforts = stiffness * offset - 2.0 * ratio * (stiffness * moved).sqrt() * state.velocities
        return state.accelerations(efforts + state.bias if self.config.gravity_compensation else efforts)

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self._encoded(self.positions + towards_pose(self.robot, self.joints, pose))

    def encode_posture(self, positions: Tensor, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self._encoded(positions[:, self._columns])

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._last.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return {**self._last.memory(), **self.gains.memory()}

    @property
    def position_range(self) -> Tensor:
        if self.config.mode is not CommandMode.ABSOLUTE:
            return super().position_range
        low, high = super().position_range.unbind(1)
        return torch.stack(
            (low.maximum(self._home - self.config.scale), high.minimum(self._home + self.config.scale)), 1
        )

    def _encoded(self, positions: Tensor) -> Tensor:
        command = ((positions - self._origin()) / self.config.scale).clamp(-1.0, 1.0)
        return torch.cat((command, self.gains.encode(self.num_envs)), 1)

    def _origin(self) -> Tensor:
        """Return the positions to which commands are added."""
        if self.config.mode is CommandMode.ABSOLUTE:
            return self._home
        return self.positions if self.config.mode is CommandMode.RELATIVE else self._last.read(self.positions)
