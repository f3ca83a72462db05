"""Commands as PhysX's drives and generalised forces.

A joint has one drive in PhysX: an implicit spring-damper whose effort is limited. A driven joint's takes the gains and
the effort, as a shift of its target, so that one limit bounds their sum. On a joint without gains it plays the part of
Coulomb friction (a damper that saturates) or of the joint's damping, and efforts are generalised forces. So are the
forces of the joint's own spring; of one that is too stiff for that the drive takes the place, where it is free.
"""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.interfaces import ConfigurationError, SceneLayout
from orbit_core.plugin_kit.bodies import least_inertias, softest
from orbit_sapien.model import BuiltWorld

# Damping (N m s/rad or N s/m) of a drive that acts as friction.
_RIGID = 1e5
_UNLIMITED = 3.4e38
# Rounding of a difference of two positions, relative to these, or to one where they are less.
_ROUNDING = 5e-7
FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class JointState:
    """Positions and velocities (N, J) of all joints at one instant."""

    positions: Tensor
    """rad or m."""
    velocities: Tensor
    """rad/s or m/s."""


class Drives:
    """Sends to PhysX what has changed, and says what the drives did."""

    def __init__(self, layout: SceneLayout, world: BuiltWorld, small_steps: int) -> None:
        """``small_steps`` are those that PhysX's solver divides a physics step into."""
        self._layout, self._world, self._small_steps = layout, world, small_steps
        parameters, num_envs = layout.joint_parameters, len(world.environments)
        follower = np.array([joint.mimic is not None for joint in layout.joints], dtype=bool)
        self._leads = ~follower
        self._limit = torch.as_tensor(parameters.effort_limit, dtype=torch.float32)
        self._rest = torch.as_tensor(parameters.spring_rest, dtype=torch.float32)
        self._softest = softest(layout, layout.scene.physics_dt)
        shape = (num_envs, len(layout.joints))
        self.stiffness = np.where(follower, 0.0, parameters.drive_stiffness) * np.ones(shape)
        """(N, J)"""
        self.damping = np.where(follower, 0.0, parameters.drive_damping) * np.ones(shape)
        """(N, J)"""
        self.passive, self.friction = parameters.damping * np.ones(shape), parameters.friction * np.ones(shape)
        """(N, J) damping and Coulomb friction of the joints themselves."""
        self.armature = parameters.armature * np.ones(shape)
        """(N, J)"""
        self.springs = parameters.spring_stiffness * np.ones(shape)
        """(N, J) stiffness of the joints' own springs."""
        self.limits = np.stack((parameters.lower_limit, parameters.upper_limit), axis=-1) * np.ones((*shape, 1))
        """(N, J, 2) lower and upper positions."""
        self.efforts = torch.zeros(shape)
        """(N, J) of drives and commands in the last step."""
        # Without the armature, which may differ between environments and is added where it is known.
        self._least = least_inertias(layout) - parameters.armature
        self.joints = [
            [joint for entity in environment.entities for joint in entity.joints] for environment in world.environments
        ]
        """PhysX's joints of each environment, in the layout's order."""
        self.sent = np.full((3, *shape), np.nan, np.float32)
        """(3, N, J) drive targets, velocity targets and forces that PhysX was last told; NaN for unknown."""
        # NaN differs from every number, so that the first settling sends everything.
        self._properties = np.full((3, *shape), np.nan)
        self._armature, self._limits = self.armature.copy(), self.limits.copy()
        self._settle()

    def to(self, device: torch.device) -> Drives:
        """Return a copy with the tensors of its law on another device; values already sent to PhysX stay valid."""
        for name, value in vars(self).items():
            if isinstance(value, Tensor):
                setattr(self, name, value.to(device))
        stiffness, damping = self._gains
        self._gains = stiffness.to(device), damping.to(device)
        return self

    # Gains -----------------------------------------------------------------------------------------------------------

    def set_gains(self, joints: npt.NDArray[np.int64], stiffness: Tensor, damping: Tensor, rows: list[int]) -> None:
        """(n, k) of the joints (k,) that carry a drive of their own."""
        own = self._leads[joints]
        index = np.ix_(np.asarray(rows, np.int64), joints[own])
        self.stiffness[index], self.damping[index] = stiffness.numpy()[:, own], damping.numpy()[:, own]
        self._settle()

    def load_gains(self, stiffness: FloatArray, damping: FloatArray) -> None:
        """Return to saved gains, and forget what was sent."""
        self.stiffness[:], self.damping[:] = stiffness, damping
        self._settle()
        self.sent.fill(np.nan)

    def set_joints(
        self,
        joints: npt.NDArray[np.int64],
        damping: Tensor | None,
        friction: Tensor | None,
        armature: Tensor | None,
        stiffness: Tensor | None,
        rows: list[int],
    ) -> None:
        """(n, k) of the joints (k,) themselves."""
        index, before = np.ix_(np.asarray(rows, np.int64), joints), self.save_joints()
        for own, values in zip(self._own, (damping, friction, armature, stiffness, None), strict=True):
            if values is not None:
                own[index] = values.numpy()
        try:
            self._settle()
        except ConfigurationError:
            # What was refused must leave no trace, as everywhere in the contract.
            self.load_joints(before)
            raise
        self.sent[:, rows] = np.nan

    def set_limits(self, joints: npt.NDArray[np.int64], limits: FloatArray, rows: list[int]) -> None:
        """(n, k, 2) lower and upper positions of the joints (k,)."""
        self.limits[np.ix_(np.asarray(rows, np.int64), joints)] = limits
        self._settle()

    def save_joints(self) -> tuple[FloatArray, ...]:
        """Copies of what :meth:`set_joints` and :meth:`set_limits` set, of all joints."""
        return tuple(own.copy() for own in self._own)

    def load_joints(self, saved: tuple[FloatArray, ...]) -> None:
        """Return to what :meth:`save_joints` gave; gains are to be loaded after it."""
        for own, values in zip(self._own, saved, strict=True):
            own[:] = values

    @property
    def _own(self) -> tuple[FloatArray, ...]:
        return self.passive, self.friction, self.armature, self.springs, self.limits

    def forget(self, rows: list[int]) -> None:
        """Send all values again to these environments at the next :meth:`send`."""
        self.sent[:, rows] = np.nan

    def _settle(self) -> None:
        """Give PhysX the drives that follow from the gains."""
        driven = (self.stiffness > 0) | (self.damping > 0)
        rubbing = ~driven & (self.friction > 0)
        stiff = self.springs > self._softest
        self._refuse_springs(stiff & (driven | rubbing))
        damping = np.where(rubbing, _RIGID, self.damping + self.passive)
        stiffness = np.where(stiff, self.springs, self.stiffness)
        limit = np.where(driven, self._limit.numpy(), np.where(rubbing, self.friction, np.inf))
        wanted = np.stack((stiffness, damping, np.minimum(limit, _UNLIMITED)))
        # SAPIEN takes properties joint by joint, at some microseconds a call: only what differs is sent.
        for row, column in zip(*np.nonzero((wanted != self._properties).any(0)), strict=True):
            self.joints[row][column].set_drive_properties(*map(float, wanted[:, row, column]), "force")
        self._properties = wanted
        for row, column in zip(*np.nonzero(self.armature != self._armature), strict=True):
            self.joints[row][column].set_armature(self.armature[row, column, None].astype(np.float32))
        self._armature = self.armature.copy()
        for row, column in zip(*np.nonzero((self.limits != self._limits).any(-1)), strict=True):
            self.joints[row][column].set_limits(self.limits[row, column, None].astype(np.float32))
        self._limits = self.limits.copy()
        self._inertia = torch.from_numpy(self._least + self.armature).float()
        # (N, J) stiffness of springs that are generalised forces.
        self._pulling = torch.from_numpy(np.where(stiff, 0.0, self.springs)).float()
        # (N, J) whether the joint's drive is its spring.
        self._sprung = torch.from_numpy(stiff)
        self._driven = torch.from_numpy(driven)
        # (N, J) damping of joints themselves that shares a drive with an actuator.
        self._drag = torch.from_numpy(np.where(driven, self.passive, 0.0)).float()
        stiffness, gain = torch.from_numpy(self.stiffness).float(), torch.from_numpy(self.damping).float()
        self._gains = stiffness, gain
        sprung = stiffness > 0
        self._effort_as_shift = torch.where(sprung, 1.0 / stiffness.clamp_min(1e-30), 0.0)
        total = torch.from_numpy(damping).float().clamp_min(1e-30)
        # The drive's damping includes the joint's own, which pulls towards rest: the target is scaled down so that only
        # the drive's part follows it.
        self._velocity_share = torch.where(self._driven, gain / total, 0.0)
        # Without stiffness there is no position to shift: the effort becomes a speed that the damping turns into it.
        self._effort_as_speed = torch.where(self._driven & ~sprung, 1.0 / total, 0.0)
        self._direct = (~self._driven).float() * torch.as_tensor(self._leads).float()
        # What the drive's slot has no room for is a generalised force that follows the state, step by step.
        self._dragging = torch.from_numpy(np.where(rubbing, self.passive, 0.0)).float()
        self._rubbing = torch.from_numpy(np.where(driven, self.friction, 0.0)).float()
        self.follows_state = bool(self._dragging.any() or self._rubbing.any() or self._pulling.any())
        """Whether :meth:`send_forces` must be called at each physics step."""

    def _refuse_springs(self, wrong: npt.NDArray[np.bool_]) -> None:
        for row, number in np.argwhere(wrong)[:1]:
            step = self._layout.scene.physics_dt
            raise ConfigurationError(
                f"joint '{self._layout.joints[number].name}' has a spring of stiffness "
                f"{self.springs[row, number]:.4g} beside a drive or friction, too stiff for PhysX in steps "
                f"of {step:g} s: use a smaller physics_dt, or an explicit drive (IdealPd)"
            )

    # Commands --------------------------------------------------------------------------------------------------------

    def commands(self, positions: Tensor, velocities: Tensor, efforts: Tensor) -> Tensor:
        """(3, N, J) drive targets and generalised forces for the contract's commands."""
        shifted = positions + efforts * self._effort_as_shift
        speeds = velocities * self._velocity_share + efforts * self._effort_as_speed
        # A drive without gains must not carry NaN or leftovers of targets that nothing follows.
        shifted = torch.where(self._driven, shifted, torch.where(self._sprung, self._rest, 0.0))
        forces = torch.clamp(efforts, -self._limit, self._limit) * self._direct
        return torch.stack((shifted, speeds, forces))

    def send(self, commands: Tensor) -> None:
        """Write the values that differ from those last sent to PhysX."""
        wanted = commands.numpy()
        changed = wanted != self.sent
        for row, column in zip(*(indices.tolist() for indices in np.nonzero(changed[0])), strict=True):
            self.joints[row][column].set_drive_target(float(wanted[0, row, column]))
        for row, column in zip(*(indices.tolist() for indices in np.nonzero(changed[1])), strict=True):
            self.joints[row][column].set_drive_velocity_target(float(wanted[1, row, column]))
        # Forces that follow the state are sent at each physics step instead.
        if not self.follows_state:
            self._send_forces(wanted[2], changed[2])
        self.sent = wanted.copy()

    def forces(self, commands: Tensor, positions: Tensor, velocities: Tensor, dt: float) -> Tensor:
        """(N, J) generalised forces of efforts, and of springs, friction and damping at the present state."""
        # No more than stops the joint within the step: an explicit force beyond that would turn its motion round.
        friction = torch.minimum(self._rubbing, self._inertia * velocities.abs() / dt)
        pull = self._pulling * (self._rest - positions)
        return commands[2] + pull - friction * velocities.sign() - self._dragging * velocities

    def send_forces(self, commands: Tensor, positions: Tensor, velocities: Tensor, dt: float) -> None:
        """Write :meth:`forces`."""
        forces = self.forces(commands, positions, velocities, dt).numpy()
        self._send_forces(forces, np.ones(forces.shape, dtype=bool))

    def _send_forces(self, forces: npt.NDArray[np.float32], changed: npt.NDArray[np.bool_]) -> None:
        for entity in self._layout.entities:
            values, due = forces[:, entity.joints], changed[:, entity.joints].any(-1)
            for row in np.flatnonzero(due).tolist():
                native = self._world.environments[row].entities[entity.index]
                if native.articulation is not None:
                    native.articulation.set_qf(values[row, list(native.dof_order)])

    def measure(self, commands: tuple[Tensor, Tensor, Tensor], before: JointState, after: JointState) -> None:
        """Compute the efforts of the last physics step from the states around it.

        PhysX applies a drive's law at the end of each of as many small steps as it has position iterations. The mean of
        their velocities is the way over the step, and the mean of their positions that of a cubic through the step.
        """
        targets, speeds, efforts = commands
        dt, middle = self._layout.scene.physics_dt, 0.5 * (before.velocities + after.velocities)
        way = after.positions - before.positions
        rounding = _ROUNDING * after.positions.abs().clamp_min(1.0)
        # The way over the step is a difference of nearly equal numbers; where rounding hides it the mean speed is
        # better.
        v = torch.where((way - dt * middle).abs() <= rounding, middle, way / dt)
        q = 0.5 * (before.positions + after.positions) + 0.5 / self._small_steps * way
        q = q + dt / 12.0 * (before.velocities - after.velocities)
        stiffness, damping = self._gains
        total = stiffness * (targets - q) + damping * (speeds - v) + efforts
        drag = self._drag * v  # shares the drive's slot, and so its limit
        total = torch.where(self._driven, total - drag, efforts * self._direct)
        torch.clamp(total, -self._limit, self._limit, out=self.efforts)
        self.efforts += drag
