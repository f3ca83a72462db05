"""N environments of one scene in one PhysX world on a GPU. NOT TESTED ON ONE: PhysX's GPU library was never at hand.

Its book-keeping is tested against a stand-in for SAPIEN's GPU system. It follows SAPIEN 3.0.3's stubs, and ManiSkill
3.0.1 in the order of calls. State lives in PhysX's own buffers, seen as torch tensors without a copy: bodies (B, 13) as
position, quaternion, linear and angular velocity of the centre of mass; articulations (A, D) with D the most degrees of
freedom of any. Reads gather from them in the layout's order.
"""

# SAPIEN's stubs ask for shapes of arrays that NumPy's types cannot express.
# pyright: reportArgumentType=false

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
import torch
from torch import Tensor

from orbit_core.interfaces import (
    TERRAIN,
    Approximation,
    BuiltModel,
    Engine,
    SceneLayout,
    UnsupportedCapabilityError,
    diverged,
    divergence_error,
)
from orbit_sapien import physx_gpu
from orbit_sapien.config import SapienConfig
from orbit_sapien.drives import Drives, JointState
from orbit_sapien.kinematics import rotate
from orbit_sapien.model import BuiltWorld, build_world, configure_physx
from orbit_sapien.native import physx, sapien
from orbit_sapien.readback import read_model

_MOVING = physx.PhysxRigidDynamicComponent, physx.PhysxArticulationLinkComponent
_UNTESTED = Approximation(
    "the engine", "physics on a GPU", "code that no GPU has run", "PhysX's GPU library was not at hand to test against"
)


@dataclass(frozen=True)
class GpuSnapshot:
    """PhysX's buffers, and the commands with what the last step measured."""

    buffers: tuple[Tensor, ...]
    """Copies of PhysX's buffers."""
    commands: tuple[Tensor, ...]
    """Commands, then what the last step measured."""


@dataclass(frozen=True)
class _Buffers:
    """Views of PhysX's memory."""

    bodies: Tensor
    positions: Tensor
    velocities: Tensor
    forces: Tensor
    position_targets: Tensor
    velocity_targets: Tensor

    @classmethod
    def of(cls, system: physx.PhysxGpuSystem) -> _Buffers:
        return cls(
            system.cuda_rigid_body_data.torch(),
            system.cuda_articulation_qpos.torch(),
            system.cuda_articulation_qvel.torch(),
            system.cuda_articulation_qf.torch(),
            system.cuda_articulation_target_qpos.torch(),
            system.cuda_articulation_target_qvel.torch(),
        )

    @property
    def all(self) -> tuple[Tensor, ...]:
        return tuple(vars(self).values())


class SapienGpuEngine(Engine):
    """Steps one PhysX world on a GPU. What it does not do raises :class:`UnsupportedCapabilityError`."""

    def __init__(self, layout: SceneLayout, num_envs: int, device: torch.device, config: SapienConfig) -> None:
        """Build the world.

        Raises:
            ConfigurationError: PhysX's GPU library is not on this machine.
            UnsupportedCapabilityError: the scene has joint wrenches.
        """
        physx_gpu.enable()
        if layout.wrench_links:
            raise UnsupportedCapabilityError("SAPIEN on a GPU measures no joint wrenches here: use device 'cpu'")
        super().__init__(layout, num_envs, device)
        configure_physx(layout, config, threads=2, enable_enhanced_determinism=False)
        self._system = physx.PhysxGpuSystem(f"cuda:{device.index or 0}")
        self._system.timestep = self._dt = layout.scene.physics_dt
        self._world: BuiltWorld = build_world(layout, num_envs, config, lambda: self._system, num_envs)
        # The drives' properties are those of the bodies on the host, which PhysX takes over when it starts.
        self._drives = Drives(layout, self._world, config.position_iterations).to(device)
        # After everything is built: PhysX takes no new bodies or properties on a GPU from here on.
        self._system.gpu_init()
        self._system.gpu_set_cuda_stream(torch.cuda.current_stream(device).cuda_stream)
        self._buffers = _Buffers.of(self._system)
        self._index()
        self._contacts = _Contacts(layout, self._world, self._system, device)
        self._home = self.position_targets[:1].clone()
        self.reset()

    def _index(self) -> None:
        """The indices of the layout's links and joints in PhysX's buffers."""
        layout, environments = self.layout, self._world.environments
        offsets = np.stack([environment.offset for environment in environments])
        self._offsets = torch.as_tensor(offsets, dtype=torch.float32, device=self.device)
        static = [self._is_static(entity) for entity in layout.entity_of_link]
        self._static = torch.tensor(static, dtype=torch.bool, device=self.device)
        self._rows = torch.tensor(
            [
                [
                    # Immovable bodies have no row on the GPU; row 0 keeps the gather in range, and its result is
                    # replaced.
                    body.gpu_pose_index if isinstance(body, _MOVING) else 0
                    for entity in environment.entities for body in entity.bodies
                ]
                for environment in environments
            ],
            dtype=torch.int64, device=self.device,
        )  # fmt: skip
        width = self._buffers.positions.shape[-1]
        self._columns = torch.zeros(self.num_envs, len(layout.joints), dtype=torch.int64, device=self.device)
        for entity in layout.entities:
            for row, environment in enumerate(environments):
                native = environment.entities[entity.index]
                if native.articulation is not None:
                    columns = native.articulation.gpu_index * width + torch.arange(len(native.dof_order))
                    order = torch.tensor(native.dof_order, dtype=torch.int64) + entity.joints.start
                    self._columns[row, order.to(self.device)] = columns.to(self.device)
        poses = torch.tensor([[*e.spec.pose.position, *e.spec.pose.orientation] for e in layout.entities])
        self._first_poses = poses.reshape(-1, 7).to(self.device)
        self._entity_of_link = torch.as_tensor(layout.entity_of_link, dtype=torch.int64, device=self.device)
        centers = np.array([link.center_of_mass for link in layout.links]).reshape(-1, 3)
        self._centers = torch.as_tensor(centers, dtype=torch.float32, device=self.device)

    # Time ------------------------------------------------------------------------------------------------------------

    def step(self, steps: int) -> None:
        commands = self._drives.commands(self.position_targets, self.velocity_targets, self.efforts)
        self._scatter(self._buffers.position_targets, commands[0])
        self._scatter(self._buffers.velocity_targets, commands[1])
        self._scatter(self._buffers.forces, commands[2])
        self._system.gpu_apply_articulation_target_position()
        self._system.gpu_apply_articulation_target_velocity()
        self._system.gpu_apply_articulation_qf()
        self._contacts.clear()
        before = self._joint_state
        for step in range(steps):
            # With a single physics step the state before it was read above already.
            last = step == steps - 1 > 0
            if self._drives.follows_state or last:
                self._system.gpu_fetch_articulation_qpos()
                self._system.gpu_fetch_articulation_qvel()
            if last:
                before = self._joint_state
            if self._drives.follows_state:
                forces = self._drives.forces(commands, self.joint_positions, self.joint_velocities, self._dt)
                self._scatter(self._buffers.forces, forces)
                self._system.gpu_apply_articulation_qf()
            self._system.step()
            self._contacts.add()
        self._contacts.average(steps * self._dt)
        self._fetch()
        # PhysX's own step waits for the GPU, so that reading the result costs no further wait.
        failed = diverged(self.link_poses, self.link_velocities).nonzero().flatten().tolist()
        if failed and self.raises_divergence:
            raise divergence_error(failed)
        commanded = self.position_targets, self.velocity_targets, self.efforts
        self._drives.measure(commanded, before, self._joint_state)

    @property
    def _joint_state(self) -> JointState:
        return JointState(self.joint_positions, self.joint_velocities)

    def _fetch(self) -> None:
        self._system.gpu_fetch_rigid_dynamic_data()
        self._system.gpu_fetch_articulation_link_pose()
        self._system.gpu_fetch_articulation_link_velocity()
        self._system.gpu_fetch_articulation_qpos()
        self._system.gpu_fetch_articulation_qvel()

    def _scatter(self, buffer: Tensor, values: Tensor, rows: Tensor | None = None) -> None:
        """Put (n, J) of the layout's joints where PhysX has them."""
        columns = self._columns if rows is None else self._columns[rows]
        buffer.view(-1)[columns] = values

    # State -----------------------------------------------------------------------------------------------------------

    @property
    def joint_positions(self) -> Tensor:
        return self._buffers.positions.view(-1)[self._columns]

    @property
    def joint_velocities(self) -> Tensor:
        return self._buffers.velocities.view(-1)[self._columns]

    @property
    def joint_efforts(self) -> Tensor:
        return self._drives.efforts

    @property
    def link_poses(self) -> Tensor:
        poses = self._buffers.bodies[self._rows][..., :7]
        position = poses[..., :3] - self._offsets[:, None]
        sign = torch.where(poses[..., 3:4] < 0, -1.0, 1.0)
        moving = torch.cat((position, poses[..., 3:] * sign), -1)
        return torch.where(self._static[:, None], self._first_poses[self._entity_of_link], moving)

    @property
    def link_velocities(self) -> Tensor:
        data = self._buffers.bodies[self._rows]
        linear, angular = data[..., 7:10], data[..., 10:]
        arms = rotate(data[..., 3:7], self._centers.expand(*data.shape[:2], 3))
        velocities = torch.cat((linear - torch.linalg.cross(angular, arms), angular), -1)
        return torch.where(self._static[:, None], 0.0, velocities)

    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        rows = self._all_rows if env_ids is None else env_ids
        columns = self._columns[rows[:, None], joints]
        if positions is not None:
            self._buffers.positions.view(-1)[columns] = positions
            self._system.gpu_apply_articulation_qpos()
        if velocities is not None:
            self._buffers.velocities.view(-1)[columns] = velocities
            self._system.gpu_apply_articulation_qvel()
        self._settle()

    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        layout = self.layout.entities[entity]
        link = layout.root_link
        if self._is_static(entity):
            raise UnsupportedCapabilityError(
                f"SAPIEN on a GPU does not move the immovable '{layout.name}': use the CPU"
            )
        rows = self._all_rows if env_ids is None else env_ids
        old = self.link_velocities[rows, link]
        data = self._buffers.bodies[self._rows[rows, link]]
        if pose is not None:
            data[:, :7] = torch.cat((pose[:, :3] + self._offsets[rows], pose[:, 3:]), -1)
        if not layout.spec.fixed_base:
            speed = old if velocity is None else velocity
            arms = rotate(data[:, 3:7], self._centers[link].expand(len(rows), 3))
            data[:, 7:] = torch.cat((speed[:, :3] + torch.linalg.cross(speed[:, 3:], arms), speed[:, 3:]), -1)
        self._buffers.bodies[self._rows[rows, link]] = data
        if layout.spec.articulation.joints:
            self._system.gpu_apply_articulation_root_pose()
            self._system.gpu_apply_articulation_root_velocity()
        else:
            self._system.gpu_apply_rigid_dynamic_data()
        self._settle()

    def _is_static(self, entity: int) -> bool:
        spec = self.layout.entities[entity].spec
        return spec.fixed_base and not spec.articulation.joints

    def _settle(self) -> None:
        """Make links follow what was written."""
        self._system.gpu_update_articulation_kinematics()
        self._fetch()

    @cached_property
    def _all_rows(self) -> Tensor:
        return torch.arange(self.num_envs, device=self.device)

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = self._all_rows if env_ids is None else env_ids
        self.position_targets[rows] = self._home
        for tensor in (self.velocity_targets, self.efforts, self._drives.efforts, self._contacts.forces):
            tensor[rows] = 0.0
        for entity in self.layout.entities:
            if not self._is_static(entity.index):
                pose = self._first_poses[entity.index].expand(len(rows), 7)
                still = None if entity.spec.fixed_base else torch.zeros(len(rows), 6, device=self.device)
                self.write_root_state(entity.index, pose, still, rows)
        joints = torch.arange(len(self.layout.joints), device=self.device)
        if len(joints):
            home = self._home.expand(len(rows), -1)
            self.write_joint_state(joints, home, torch.zeros_like(home), rows)

    # Measurements ----------------------------------------------------------------------------------------------------

    @property
    def contact_forces(self) -> Tensor:
        return self._contacts.forces

    # Snapshots and the rest ------------------------------------------------------------------------------------------

    @property
    def _commands(self) -> tuple[Tensor, ...]:
        commands = self.position_targets, self.velocity_targets, self.efforts
        return *commands, self._drives.efforts, self._contacts.forces

    def save_state(self) -> GpuSnapshot:
        buffers = tuple(buffer.clone() for buffer in self._buffers.all)
        return GpuSnapshot(buffers, tuple(tensor.clone() for tensor in self._commands))

    def load_state(self, state: GpuSnapshot) -> None:
        for own, saved in chain(
            zip(self._buffers.all, state.buffers, strict=True), zip(self._commands, state.commands, strict=True)
        ):
            own.copy_(saved)
        system = self._system
        writes: tuple[Callable[[], None], ...] = (
            system.gpu_apply_rigid_dynamic_data, system.gpu_apply_articulation_root_pose,
            system.gpu_apply_articulation_root_velocity, system.gpu_apply_articulation_qpos,
            system.gpu_apply_articulation_qvel, system.gpu_apply_articulation_qf,
            system.gpu_apply_articulation_target_position, system.gpu_apply_articulation_target_velocity,
        )  # fmt: skip
        for write in writes:
            write()
        self._settle()

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        return (_UNTESTED, *self._world.report)

    def built_model(self) -> tuple[BuiltModel, ...]:
        return (read_model(self._world.environments[0]),)

    @property
    def native(self) -> tuple[physx.PhysxGpuSystem, tuple[sapien.Scene, ...]]:
        """The PhysX system, and the scene of each environment."""
        return self._system, tuple(environment.scene for environment in self._world.environments)


class _Contacts:
    """Impulses of the queries, summed over the physics steps of a control step."""

    def __init__(
        self, layout: SceneLayout, world: BuiltWorld, system: physx.PhysxGpuSystem, device: torch.device
    ) -> None:
        self._system, self._queries = system, layout.contact_queries
        self.forces = torch.zeros(len(world.environments), len(self._queries), 3, device=device)
        """(N, K, 3) newtons."""
        self._sum = torch.zeros_like(self.forces).view(-1, 3)
        bodies: list[physx.PhysxRigidBaseComponent] = []
        pairs: list[tuple[physx.PhysxRigidBaseComponent, physx.PhysxRigidBaseComponent]] = []
        body_rows: list[int] = []
        pair_rows: list[int] = []
        for row, environment in enumerate(world.environments):
            links = [body for entity in environment.entities for body in entity.bodies]
            grounds = environment.terrain + (world.environments[0].terrain if world.shared_ground and row else [])
            for column, query in enumerate(self._queries):
                place = row * len(self._queries) + column
                if query.others is None:
                    bodies.append(links[query.link])
                    body_rows.append(place)
                for other in query.others or ():
                    met = [(links[query.link], b) for b in (grounds if other == TERRAIN else [links[other]])]
                    pairs += met
                    pair_rows += [place] * len(met)
        self._body_rows = torch.tensor(body_rows, dtype=torch.int64, device=device)
        self._pair_rows = torch.tensor(pair_rows, dtype=torch.int64, device=device)
        self._of_bodies = system.gpu_create_contact_body_impulse_query(bodies) if bodies else None
        self._of_pairs = system.gpu_create_contact_pair_impulse_query(pairs) if pairs else None

    def clear(self) -> None:
        """Begin a control step."""
        self._sum.zero_()

    def add(self) -> None:
        """Take one physics step's impulses in."""
        if self._of_bodies is not None:
            self._system.gpu_query_contact_body_impulses(self._of_bodies)
            self._sum.index_add_(0, self._body_rows, self._of_bodies.cuda_impulses.torch())
        if self._of_pairs is not None:
            self._system.gpu_query_contact_pair_impulses(self._of_pairs)
            self._sum.index_add_(0, self._pair_rows, self._of_pairs.cuda_impulses.torch())

    def average(self, seconds: float) -> None:
        """End a control step of that length."""
        torch.div(self._sum.view_as(self.forces), seconds, out=self.forces)
