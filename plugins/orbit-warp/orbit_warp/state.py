"""Positions and velocities, read and written.

Quantities that MuJoCo-Warp stores in the contract's form are handed out without a copy; poses and velocities of links
are derived by the step's own graph, or, after a write, when they are next read.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false

from __future__ import annotations

import mujoco_warp as mjw
import torch
import warp as wp
from torch import Tensor

from orbit_core.interfaces import SceneLayout
from orbit_mjmodel.addresses import Addresses, columns
from orbit_warp.forward import ForwardKinematics
from orbit_warp.kernels import write_root
from orbit_warp.native import Native
from orbit_warpkit.arrays import array_of
from orbit_warpkit.graphs import Graphs
from orbit_warpkit.kernels import read_joints


class State:
    """The state of all environments."""

    def __init__(self, layout: SceneLayout, addresses: Addresses, native: Native, graphs: Graphs) -> None:
        self._model, self._data, self._graphs = native.model, native.data, graphs
        self._addresses = addresses
        data, envs = native.data, native.data.nworld
        device = wp.device_to_torch(data.qpos.device)
        self._qpos, self._qvel = wp.to_torch(data.qpos), wp.to_torch(data.qvel)
        self._position_columns = torch.as_tensor(addresses.joint_positions, device=device)
        self._velocity_columns = torch.as_tensor(addresses.joint_velocities, device=device)
        places = columns(addresses.joint_positions), columns(addresses.joint_velocities)
        self._gathered = not all(isinstance(place, slice) for place in places)
        if self._gathered:
            self._joint_positions = torch.zeros(envs, len(layout.joints), device=device)
            self._joint_velocities = torch.zeros_like(self._joint_positions)
        else:
            self._joint_positions, self._joint_velocities = self._qpos[:, places[0]], self._qvel[:, places[1]]
        self._link_poses = torch.zeros(envs, len(layout.links), 7, device=device)
        self._link_velocities = torch.zeros(envs, len(layout.links), 6, device=device)
        self._kinematics = ForwardKinematics(addresses, native, self._link_poses, self._link_velocities)
        self._joint_addresses = [
            wp.array(a, dtype=int) for a in (addresses.joint_positions, addresses.joint_velocities)
        ]
        self._no_rows = wp.zeros((1, 7), dtype=float)
        self._current = self._bodies_current = self._bodies_derived = False

    def mark_written(self) -> None:
        """Invalidate derived quantities."""
        self._current = self._bodies_current = False

    def mark_stepped(self) -> None:
        """Record that a graph ran :meth:`derive` after the bodies moved."""
        self._current, self._bodies_current = True, False

    def refresh(self) -> None:
        """Derive what a write left behind."""
        if not self._current:
            self._graphs.run("derive", self.derive)
            self._current = True

    def refresh_bodies(self, moving: bool = True) -> None:
        """Derive what MuJoCo-Warp itself reads: its own poses and velocities of bodies, and geoms.

        For what never moves, once is enough.
        """
        if not (self._bodies_current if moving else self._bodies_derived):
            self._graphs.run("derive bodies", self.derive_bodies)
            self._bodies_current = self._bodies_derived = True

    def derive_bodies(self) -> None:
        """Launch what brings MuJoCo-Warp's own poses and velocities of bodies up to date."""
        mjw.kinematics(self._model, self._data)
        mjw.com_pos(self._model, self._data)
        mjw.com_vel(self._model, self._data)

    def derive(self) -> None:
        """Launch what brings poses and velocities up to date."""
        if self._link_poses.numel():
            self._kinematics.launch()
        if self._gathered:
            wp.launch(
                read_joints,
                dim=self._joint_positions.shape,
                inputs=[*self._joint_addresses, self._data.qpos, self._data.qvel],
                outputs=[wp.from_torch(self._joint_positions), wp.from_torch(self._joint_velocities)],
            )

    # Reading ---------------------------------------------------------------------------------------------------------

    @property
    def joint_positions(self) -> Tensor:
        if self._gathered:
            self.refresh()
        return self._joint_positions

    @property
    def joint_velocities(self) -> Tensor:
        if self._gathered:
            self.refresh()
        return self._joint_velocities

    @property
    def link_poses(self) -> Tensor:
        self.refresh()
        return self._link_poses

    @property
    def link_velocities(self) -> Tensor:
        self.refresh()
        return self._link_velocities

    # Writing ---------------------------------------------------------------------------------------------------------

    def write_joints(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None
    ) -> None:
        if positions is not None:
            _write(self._qpos, self._position_columns[joints], positions, env_ids)
        if velocities is not None:
            _write(self._qvel, self._velocity_columns[joints], velocities, env_ids)
        self.mark_written()

    def write_root(self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor) -> None:
        data, addresses = self._data, self._addresses
        places = (addresses.mocaps[entity], addresses.root_positions[entity], addresses.root_velocities[entity])
        with self._graphs.stream():
            wp.launch(
                write_root,
                dim=len(env_ids),
                inputs=[
                    wp.from_torch(env_ids.contiguous()), *map(int, places), pose is not None, velocity is not None,
                    array_of(pose, self._no_rows), array_of(velocity, self._no_rows),
                ],
                outputs=[data.qpos, data.qvel, data.mocap_pos, data.mocap_quat],
            )  # fmt: skip
        self.mark_written()


def _write(target: Tensor, columns: Tensor, values: Tensor, env_ids: Tensor | None) -> None:
    """Set columns of the environments given by index or by mask."""
    if env_ids is None:
        target[:, columns] = values
    elif env_ids.dtype == torch.bool:
        target[:, columns] = torch.where(env_ids[:, None], values, target[:, columns])
    else:
        target[env_ids[:, None], columns] = values
