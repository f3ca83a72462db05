"""N environments of one scene in PhysX worlds of a few each."""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.interfaces import (
    Approximation,
    BuiltModel,
    FailedEnvironmentsError,
    RayHits,
    SceneLayout,
    divergence_error,
)
from orbit_core.plugin_kit.engines import PartedEngine
from orbit_sapien.config import SapienConfig
from orbit_sapien.drives import Drives, JointState
from orbit_sapien.measurements import ContactMeter, WrenchMeter, held_links
from orbit_sapien.model import BuiltWorld, build_world, configure_physx
from orbit_sapien.native import physx, sapien
from orbit_sapien.parameters import Parameters
from orbit_sapien.rays import RayWorld
from orbit_sapien.readback import read_model
from orbit_sapien.state import State


@dataclass(frozen=True)
class Snapshot:
    """Everything that the continuation depends on."""

    packed: tuple[bytes, ...]
    """State of each PhysX world."""
    fixed_poses: Tensor
    """Poses of bodies that do not move, which ``packed`` leaves out."""
    before: Tensor
    """State ``packed`` before the last step, by which velocities are differences."""
    moved: Tensor
    """The buffer from which :class:`State` takes velocities, in addition to ``packed``."""
    parameters: dict[str, npt.NDArray]
    """Randomised parameters by name."""
    gains: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
    """Stiffness and damping of the drives."""
    joints: tuple[npt.NDArray[np.float64], ...]
    """Randomised parameters of joints."""
    tensors: tuple[Tensor, ...]
    """Commands, then what the last step measured."""


class SapienEngine(PartedEngine[State, Parameters]):
    """Steps the PhysX worlds one after another, and reads them in bulk."""

    # PhysX's threads gain a tenth at the most, in worlds of 64 environments, and cost time in smaller ones.
    threads: ClassVar[int] = 0
    """Threads of PhysX; 0 steps in the calling thread."""

    def __init__(self, layout: SceneLayout, num_envs: int, device: torch.device, config: SapienConfig) -> None:
        super().__init__(layout, num_envs, device)
        self.config = config
        """Settings of the backend."""
        configure_physx(layout, config, threads=self.threads, enable_enhanced_determinism=True)
        self._dt = layout.scene.physics_dt
        per_world = min(config.envs_per_world, num_envs)
        self._world: BuiltWorld = build_world(layout, num_envs, config, self._make_system, per_world)
        self._state = State(layout, self._world)
        self._drives = Drives(layout, self._world, config.position_iterations)
        self._parameters = Parameters(layout, self._world, self._state)
        self._contacts = ContactMeter(layout, self._world, held_links(layout))
        self._wrenches = WrenchMeter(layout, self._world, self._contacts, self._parameters)
        self._rays: RayWorld | None = None
        self._joints = np.arange(len(layout.joints))
        self._home = self.position_targets[:1].clone()
        self.reset()

    def _make_system(self) -> physx.PhysxCpuSystem:
        system = physx.PhysxCpuSystem()
        system.timestep = self._dt
        return system

    # Time ------------------------------------------------------------------------------------------------------------

    def step(self, steps: int) -> None:
        commands = self._drives.commands(*self._commands)
        # One sum instead of a look at each number; the environments are searched only where it fails.
        if not commands.sum().isfinite():
            self._refuse_commands((~commands.isfinite()).any(0).any(-1).nonzero().flatten().tolist())
        self._drives.send(commands)
        if self._contacts.active:
            self._contacts.clear()
        for step in range(steps):
            # Efforts are those of the last physics step alone, and need the state from which it began.
            if step == steps - 1:
                self._state.mark()
            self._step_once(commands)
        if self._contacts.active:
            self._contacts.average(steps)
        if self.raises_divergence and (failed := self._state.diverged()):
            raise divergence_error(failed)
        if self._world.shared_ground and (strayed := self._state.beyond(self._world.reach)):
            self._refuse_strayed(strayed)
        after = JointState(self._state.joint_positions, self._state.joint_velocities)
        self._drives.measure(self._commands, JointState(*self._state.joints_before), after)
        if self.layout.wrench_links:
            self._wrenches.read(self._state.link_poses)

    def _step_once(self, commands: Tensor) -> None:
        if self._drives.follows_state:
            self._drives.send_forces(commands, self._state.joint_positions, self._state.joint_velocities, self._dt)
        if self._parameters.pushed:
            self._parameters.push()
        for system in self._world.systems:
            system.step()
        self._state.invalidate()
        if self._contacts.active:
            self._contacts.add()

    def _refuse_commands(self, environments: list[int]) -> None:
        raise FailedEnvironmentsError(environments, "were given targets or efforts that are not finite: reset them")

    def _refuse_strayed(self, environments: list[int]) -> None:
        raise FailedEnvironmentsError(
            environments,
            f"have a body more than {self._world.reach:.1f} m from their origins, where it may meet those of other "
            "environments, which share their ground: raise env_spacing or shared_ground_above",
        )

    @property
    def _commands(self) -> tuple[Tensor, Tensor, Tensor]:
        return self.position_targets, self.velocity_targets, self.efforts

    @property
    def _measurements(self) -> tuple[Tensor, ...]:
        """Measurements of the last step, which PhysX's own state does not hold."""
        return self._drives.efforts, self._contacts.forces, self._wrenches.wrenches

    # State -----------------------------------------------------------------------------------------------------------

    @property
    def joint_efforts(self) -> Tensor:
        return self._drives.efforts

    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        self._state.write_joints(joints.numpy(), positions, velocities, self._rows(env_ids))

    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        self._state.write_root(entity, pose, velocity, self._rows(env_ids))

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = self._rows(env_ids)
        self.position_targets[rows] = self._home
        self.velocity_targets[rows] = 0.0
        self.efforts[rows] = 0.0
        for measured in self._measurements:
            measured[rows] = 0.0
        self._parameters.clear_wrenches(rows)
        self._drives.forget(rows)
        for entity in self.layout.entities:
            pose = torch.tensor([[*entity.spec.pose.position, *entity.spec.pose.orientation]]).expand(len(rows), 7)
            still = None if entity.spec.fixed_base else torch.zeros(len(rows), 6)
            self._state.write_root(entity.index, pose, still, rows)
        if len(self._joints):
            home = self._home.expand(len(rows), -1)
            self._state.write_joints(self._joints, home, torch.zeros_like(home), rows)

    # Measurements ----------------------------------------------------------------------------------------------------

    @property
    def contact_forces(self) -> Tensor:
        return self._contacts.forces

    @property
    def joint_wrenches(self) -> Tensor:
        return self._wrenches.wrenches

    def cast_rays(
        self, origins: Tensor, directions: Tensor, max_distance: float, env_ids: Tensor | None = None
    ) -> RayHits:
        return self.cast_rays_past(origins, directions, max_distance, range(0), env_ids)

    def cast_rays_past(
        self, origins: Tensor, directions: Tensor, max_distance: float, links: range, env_ids: Tensor | None = None
    ) -> RayHits:
        if self._rays is None:
            # Built at the first ray, since most tasks cast none.
            self._rays = RayWorld(self.layout)
        poses = self.link_poses[self._rows(env_ids)].numpy()
        hits = self._rays.cast(poses, origins.numpy(), directions.numpy(), max_distance, links)
        return RayHits(*map(torch.from_numpy, hits))

    # Parameters per environment --------------------------------------------------------------------------------------

    def set_wrenches(self, links: Tensor, wrenches: Tensor, env_ids: Tensor | None = None) -> None:
        self._parameters.set_wrenches(links.numpy(), wrenches.numpy(), self._rows(env_ids))

    def set_drive_gains(
        self, joints: Tensor, stiffness: Tensor, damping: Tensor, env_ids: Tensor | None = None
    ) -> None:
        self._drives.set_gains(joints.numpy(), stiffness, damping, self._rows(env_ids))

    def set_joint_parameters(
        self,
        joints: Tensor,
        damping: Tensor | None,
        friction: Tensor | None,
        armature: Tensor | None,
        stiffness: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        values = damping, friction, armature, stiffness
        self._drives.set_joints(joints.numpy(), *values, self._rows(env_ids))

    def set_joint_limits(self, joints: Tensor, lower: Tensor, upper: Tensor, env_ids: Tensor | None = None) -> None:
        limits = torch.stack((lower, upper), dim=-1).double().numpy()
        self._drives.set_limits(joints.numpy(), limits, self._rows(env_ids))

    # Snapshots and the rest ------------------------------------------------------------------------------------------

    def save_state(self) -> Snapshot:
        return Snapshot(
            tuple(system.pack() for system in self._world.systems),
            self._state.fixed_poses.clone(),
            self._state.before,
            self._state.moved.clone(),
            self._parameters.save(),
            (self._drives.stiffness.copy(), self._drives.damping.copy()),
            self._drives.save_joints(),
            tuple(tensor.clone() for tensor in (*self._commands, *self._measurements)),
        )

    def load_state(self, state: Snapshot) -> None:
        self._parameters.load(state.parameters)
        # Before the gains, which settle both and send them to PhysX.
        self._drives.load_joints(state.joints)
        self._drives.load_gains(*state.gains)
        for system, packed in zip(self._world.systems, state.packed, strict=True):
            system.unpack(packed)
        for entity in self.layout.entities:
            if entity.spec.fixed_base:
                self._state.write_root(entity.index, state.fixed_poses[:, entity.index], None, self._rows(None))
        self._state.before, self._state.moved[...] = state.before, state.moved
        for own, saved in zip((*self._commands, *self._measurements), state.tensors, strict=True):
            own.copy_(saved)
        self._state.invalidate()

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        return self._world.report

    def built_model(self) -> tuple[BuiltModel, ...]:
        return (read_model(self._world.environments[0]),)

    @property
    def native(self) -> tuple[tuple[physx.PhysxSystem, ...], tuple[sapien.Scene, ...]]:
        """The PhysX systems, and the scene of each environment."""
        return self._world.systems, tuple(environment.scene for environment in self._world.environments)

    @property
    def native_joints(self) -> list[list[physx.PhysxArticulationJoint]]:
        """PhysX's joints, per environment in the layout's order."""
        return self._drives.joints

    def close(self) -> None:
        vars(self).clear()  # scenes and bodies go with the last name for them

    def _rows(self, env_ids: Tensor | None) -> list[int]:
        return list(range(self.num_envs)) if env_ids is None else env_ids.tolist()

    def _own(self, tensor: Tensor) -> npt.NDArray:
        return tensor.numpy()
