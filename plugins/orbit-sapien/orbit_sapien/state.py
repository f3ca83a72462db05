"""Reads positions and velocities in bulk from what PhysX packs, and writes them body by body.

PhysX packs, body by body in order of creation, 13 numbers for each free body (quaternion, position, linear and angular
velocity), then for each articulation the same of its root, positions and velocities of its degrees of freedom, and a
target position and velocity each. Velocities are of centres of mass; the contract's are of link frames. Those of free
bodies are the motion's (:mod:`orbit_sapien.motion`).
"""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.interfaces import SceneLayout, diverged
from orbit_sapien.kinematics import Kinematics, rotate
from orbit_sapien.model import BuiltWorld, NativeEntity
from orbit_sapien.motion import moved_velocities
from orbit_sapien.native import NativePose

_ROOT = 13


class State:
    """The kinematic state of every environment, read when first asked for after a step or a write."""

    def __init__(self, layout: SceneLayout, world: BuiltWorld) -> None:
        self._layout, self._world = layout, world
        self._num_envs, self._dt = len(world.environments), layout.scene.physics_dt
        self._kinematics = Kinematics(layout)
        self._offsets = torch.from_numpy(np.stack([e.offset for e in world.environments]))
        self._locate(world.environments[0].entities)
        roots = [layout.links[entity.root_link] for entity in layout.entities]
        centers = np.array([root.center_of_mass for root in roots], np.float64).reshape(-1, 3)
        self.root_centers = torch.from_numpy(centers).repeat(self._num_envs, 1, 1)
        """(N, E, 3) centres of mass of the roots in their link frames."""
        initial = [[*entity.spec.pose.position, *entity.spec.pose.orientation] for entity in layout.entities]
        self.fixed_poses = torch.tensor(initial, dtype=torch.float64).reshape(-1, 7).repeat(self._num_envs, 1, 1)
        """(N, E, 7) of fixed bases; PhysX has free ones."""
        free = [entity.free for entity in world.environments[0].entities]
        self._free = torch.tensor(free, dtype=torch.bool)
        self.before = torch.zeros(0)
        """The values of :attr:`packed` before the last step."""
        self.moved = torch.zeros(self._num_envs, len(free), dtype=torch.bool)
        """(N, E) free bodies to which nothing was written since."""
        self._values: dict[str, Tensor] = {}

    def _locate(self, entities: list[NativeEntity]) -> None:
        """Columns of each environment's bodies, then of its articulations."""
        bodies = articulations = 0
        size = len(self._layout.joints)
        self._root_columns = np.zeros((len(entities), _ROOT), np.int64)
        position, velocity = np.zeros(size, np.int64), np.zeros(size, np.int64)
        free = sum(entity.free for entity in entities)
        for layout, entity in zip(self._layout.entities, entities, strict=True):
            if entity.free:
                self._root_columns[layout.index] = _ROOT * bodies + np.arange(_ROOT)
                bodies += 1
            elif entity.articulation is not None:
                start, dofs = _ROOT * free + articulations, len(entity.dof_order)
                self._root_columns[layout.index] = start + np.arange(_ROOT)
                order = layout.joints.start + np.array(entity.dof_order, np.int64)
                position[order] = start + _ROOT + np.arange(dofs)
                velocity[order] = start + _ROOT + dofs + np.arange(dofs)
                articulations += _ROOT + 4 * dofs
        self._sizes = _ROOT * bodies, articulations
        self._position_columns, self._velocity_columns = torch.as_tensor(position), torch.as_tensor(velocity)
        self._root_index = torch.as_tensor(self._root_columns)
        fixed = [entity.spec.fixed_base for entity in self._layout.entities]
        self._fixed = torch.tensor(fixed, dtype=torch.bool)[:, None]
        self._any_fixed = any(fixed)

    # Reading ---------------------------------------------------------------------------------------------------------

    def invalidate(self) -> None:
        """After a step or a write."""
        self._values.clear()

    def mark(self) -> None:
        """Ahead of a step after which velocities may be read."""
        self.before = self.packed
        self.moved[:] = self._free

    @property
    def packed(self) -> Tensor:
        """(N, columns) float32: each environment's bodies and articulations."""
        if "packed" not in self._values:
            worlds = [np.frombuffer(system.pack(), np.float32) for system in self._world.systems]
            full, rest = divmod(self._num_envs, self._world.per_system)
            # All worlds of the same size at once: 64 of one environment would take a millisecond one by one.
            parts = [self._unpacked_worlds(worlds[:full], self._world.per_system)] if full else []
            parts += [self._unpacked_worlds(worlds[full:], rest)] if rest else []
            self._values["packed"] = torch.from_numpy(np.concatenate(parts))
        return self._values["packed"]

    def _unpacked_worlds(self, worlds: list[npt.NDArray[np.float32]], count: int) -> npt.NDArray[np.float32]:
        """Rows of environments in worlds of ``count`` each, which have all free bodies ahead of all articulations."""
        flat = np.stack(worlds)
        bodies, articulations = (count * size for size in self._sizes)
        parts = flat[:, :bodies], flat[:, bodies : bodies + articulations]
        rows = len(worlds) * count
        return np.concatenate([part.reshape(rows, size) for part, size in zip(parts, self._sizes, strict=True)], -1)

    def diverged(self) -> list[int]:
        """Environments that are out of bounds."""
        if not self.packed.numel():
            return []
        roots = self.packed[:, self._root_index]
        positions = torch.cat((roots[..., :7].flatten(1), self.joint_positions), -1)
        velocities = torch.cat((roots[..., 7:].flatten(1), self.joint_velocities), -1)
        return diverged(positions, velocities).nonzero().flatten().tolist()

    def beyond(self, reach: float) -> list[int]:
        """Environments with a free root farther than ``reach`` metres from their origin along x or y."""
        if not self.packed.shape[1]:
            return []
        places = self.packed[:, self._root_index[:, 4:6]] - self._offsets[:, None, :2]
        strayed = (places.abs().amax(-1) > reach) & ~self._fixed[:, 0]
        return strayed.any(-1).nonzero().flatten().tolist()

    @property
    def joint_positions(self) -> Tensor:
        if "joint_positions" not in self._values:
            self._values["joint_positions"] = self.packed[:, self._position_columns]
        return self._values["joint_positions"]

    @property
    def joint_velocities(self) -> Tensor:
        if "joint_velocities" not in self._values:
            self._values["joint_velocities"] = self.packed[:, self._velocity_columns]
        return self._values["joint_velocities"]

    @property
    def joints_before(self) -> tuple[Tensor, Tensor]:
        """(N, J) positions and velocities before the last step."""
        return self.before[:, self._position_columns], self.before[:, self._velocity_columns]

    @property
    def _roots(self) -> Tensor:
        """(N, E, 13) in double precision, in each environment's own frame; of the centre of mass."""
        if "roots" not in self._values:
            roots = self._unpacked(self.packed)
            poses = torch.cat((roots[..., 4:7] - self._offsets[:, None], roots[..., :4]), -1)
            velocities = roots[..., 7:]
            if self.moved.any():
                moved = moved_velocities(self._unpacked(self.before), roots, self.root_centers, self._dt)
                velocities = torch.where(self.moved[..., None], moved, velocities)
            if self._any_fixed:
                poses = torch.where(self._fixed, self.fixed_poses, poses)
                velocities = torch.where(self._fixed, 0.0, velocities)
            self._values["roots"] = torch.cat((poses, velocities), -1)
        return self._values["roots"]

    def _unpacked(self, packed: Tensor) -> Tensor:
        """(N, E, 13) of roots, in double precision, with unit quaternions."""
        if not packed.shape[1]:
            nothing = torch.zeros(self._num_envs, len(self._layout.entities), _ROOT, dtype=torch.float64)
            nothing[..., 0] = 1.0
            return nothing
        roots = packed[:, self._root_index].double()
        return torch.cat((_unit(roots[..., :4]), roots[..., 4:]), -1)

    @property
    def _poses(self) -> Tensor:
        if "poses" not in self._values:
            self._values["poses"] = self._kinematics.poses(self._roots[..., :7], self.joint_positions.double())
        return self._values["poses"]

    @property
    def link_poses(self) -> Tensor:
        if "link_poses" not in self._values:
            poses = self._poses
            sign = torch.where(poses[..., 3:4] < 0, -1.0, 1.0)
            self._values["link_poses"] = torch.cat((poses[..., :3], poses[..., 3:] * sign), -1).float()
        return self._values["link_poses"]

    @property
    def root_velocities(self) -> Tensor:
        """(N, E, 6) of the roots' frames, in double precision."""
        roots = self._roots
        arms = rotate(roots[..., 3:7], self.root_centers)
        linear = roots[..., 7:10] - torch.linalg.cross(roots[..., 10:], arms)
        return torch.cat((linear, roots[..., 10:]), -1)

    @property
    def link_velocities(self) -> Tensor:
        if "link_velocities" not in self._values:
            velocities = self._kinematics.velocities(self._poses, self.root_velocities, self.joint_velocities.double())
            self._values["link_velocities"] = velocities.float()
        return self._values["link_velocities"]

    # Writing ---------------------------------------------------------------------------------------------------------

    def write_joints(
        self, joints: npt.NDArray[np.int64], positions: Tensor | None, velocities: Tensor | None, rows: list[int]
    ) -> None:
        """Set (n, k) positions and velocities of joints (k,)."""
        for values, current, name in (
            (positions, self.joint_positions, "set_qpos"),
            (velocities, self.joint_velocities, "set_qvel"),
        ):
            if values is None:
                continue
            whole = current[rows]
            whole[:, joints] = values.float()
            for entity in self._layout.entities:
                if any(entity.joints.start <= joint < entity.joints.stop for joint in joints):
                    self._set_joints(entity.index, whole[:, entity.joints].numpy(), name, rows)
        self.invalidate()

    def _set_joints(self, entity: int, values: npt.NDArray[np.float32], name: str, rows: list[int]) -> None:
        for row, value in zip(rows, values, strict=True):
            native = self._world.environments[row].entities[entity]
            getattr(native.articulation, name)(value[list(native.dof_order)])

    def write_root(self, entity: int, pose: Tensor | None, velocity: Tensor | None, rows: list[int]) -> None:
        """Set poses (n, 7) and velocities (n, 6) of the root's frame; a pose alone keeps that velocity."""
        spec = self._layout.entities[entity].spec
        old = self._roots[rows, entity, :7]
        target = old if pose is None else torch.cat((pose[:, :3].double(), _unit(pose[:, 3:].double())), -1)
        if spec.fixed_base:
            if pose is not None:
                self.fixed_poses[rows, entity] = target
                self._place(entity, target, rows)
        else:
            speeds = self.root_velocities[rows, entity] if velocity is None else velocity.double()
            if pose is not None:
                self._place(entity, target, rows)
            arms = rotate(target[:, 3:], self.root_centers[rows, entity])
            linear = speeds[:, :3] + torch.linalg.cross(speeds[:, 3:], arms)
            self._push(entity, linear.float().numpy(), speeds[:, 3:].float().numpy(), rows)
        self.moved[rows, entity] = False
        self.invalidate()

    def _place(self, entity: int, poses: Tensor, rows: list[int]) -> None:
        positions = (poses[:, :3] + self._offsets[rows]).float().numpy()
        for row, position, rotation in zip(rows, positions, poses[:, 3:].float().numpy(), strict=True):
            native = self._world.environments[row].entities[entity]
            pose = NativePose(position, rotation)
            if native.articulation is not None:
                native.articulation.set_root_pose(pose)
            else:
                native.bodies[0].entity.set_pose(pose)

    def _push(
        self, entity: int, linear: npt.NDArray[np.float32], angular: npt.NDArray[np.float32], rows: list[int]
    ) -> None:
        for row, v, w in zip(rows, linear, angular, strict=True):
            native = self._world.environments[row].entities[entity]
            if native.articulation is not None:
                native.articulation.set_root_linear_velocity(v)
                native.articulation.set_root_angular_velocity(w)
            else:
                native.bodies[0].set_linear_velocity(v)
                native.bodies[0].set_angular_velocity(w)


def _unit(q: Tensor) -> Tensor:
    return q / q.norm(dim=-1, keepdim=True)
