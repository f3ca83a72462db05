"""Reads and writes positions and velocities: MuJoCo's rows in double precision, the contract's tensors in single.

A tensor is filled when it is first read after a step or a write. Poses and velocities of links follow the joints only
when MuJoCo computes them, so environments that were written to are brought up to date first.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from mujoco.batch import Batch
from torch import Tensor

from orbit_core.interfaces import MAX_DISTANCE, MAX_SPEED
from orbit_core.plugin_kit.rotations import rotate, rotate_inverse
from orbit_core.plugin_kit.rows import HostRows, block
from orbit_mjmodel.addresses import Addresses, columns

FloatArray = npt.NDArray[np.floating]

DERIVED_STAGE = mujoco.mjtStage.mjSTAGE_VEL.value
# Sum of squares of numbers that are all within the bounds of divergence
_SURELY_BOUNDED = min(MAX_DISTANCE, MAX_SPEED) ** 2


class State:
    """The kinematic state of every environment."""

    def __init__(self, batch: Batch, addresses: Addresses) -> None:
        self._batch = batch
        self._addresses = addresses
        num_envs, joints, links = batch.nsim, len(addresses.joint_positions), len(addresses.bodies)
        self._qpos, self._qvel = batch.bind("qpos"), batch.bind("qvel")
        # A row begins with the time, then the positions and the velocities.
        self._coordinates = batch.state[:, 1 : 1 + self._qpos.shape[1] + self._qvel.shape[1]]
        self._mocap_pos, self._mocap_quat = batch.bind("mocap_pos"), batch.bind("mocap_quat")
        self._xpos, self._xquat = batch.bind("xpos"), batch.bind("xquat")
        self._cvel, self._subtree_com = batch.bind("cvel"), batch.bind("subtree_com")
        self._position_columns = columns(addresses.joint_positions)
        self._velocity_columns = columns(addresses.joint_velocities)
        self._bodies, self._roots = columns(addresses.bodies), columns(addresses.roots)
        self._joint_positions = np.zeros((num_envs, joints), dtype=np.float32)
        self._joint_velocities = np.zeros((num_envs, joints), dtype=np.float32)
        self._link_poses = np.zeros((num_envs, links, 7), dtype=np.float32)
        self._link_velocities = np.zeros((num_envs, links, 6), dtype=np.float32)
        arrays = (self._joint_positions, self._joint_velocities, self._link_poses, self._link_velocities)
        self._tensors = tuple(torch.from_numpy(array) for array in arrays)
        self._spins, self._offsets, self._swept = np.zeros((3, num_envs, links, 3))
        self._cross = tuple(torch.from_numpy(array) for array in (self._spins, self._offsets, self._swept))
        self._current: set[str] = set()
        self._written = np.zeros(num_envs, dtype=bool)
        # Whether any environment was, known without a look at the array: most steps begin with nothing written.
        self._any_written = False

    def invalidate(self) -> None:
        """After a step: every tensor is out of date, and MuJoCo's derived fields are current."""
        self._current.clear()
        if self._any_written:
            self._all_derived()

    def mark_written(self, rows: HostRows) -> None:
        """After a write: derived fields of ``rows`` are out of date too."""
        self._current.clear()
        self._written[rows] = self._any_written = True

    @property
    def bounded(self) -> bool:
        """Return True if every number is within the bounds of divergence; NaN is not."""
        # The usual case in one call, a quarter of the time of the reductions: no number exceeds the root of the sum.
        flat = self._coordinates.reshape(-1)
        if flat.dot(flat) <= _SURELY_BOUNDED:
            return True
        # The ufuncs' own reductions: the arrays' methods go through functions of Python.
        lowest, highest = np.minimum.reduce, np.maximum.reduce
        return bool(
            lowest(self._qpos, axis=None, initial=0.0) >= -MAX_DISTANCE
            and highest(self._qpos, axis=None, initial=0.0) <= MAX_DISTANCE
            and lowest(self._qvel, axis=None, initial=0.0) >= -MAX_SPEED
            and highest(self._qvel, axis=None, initial=0.0) <= MAX_SPEED
        )

    def diverged(self) -> list[int]:
        """Environments with a number beyond those bounds."""
        beyond = ~(np.abs(self._qpos) <= MAX_DISTANCE).all(1) | ~(np.abs(self._qvel) <= MAX_SPEED).all(1)
        return np.flatnonzero(beyond).tolist()

    # Reading ---------------------------------------------------------------------------------------------------------

    @property
    def joint_positions(self) -> Tensor:
        if "joint_positions" not in self._current:
            self._current.add("joint_positions")
            self._joint_positions[...] = self._qpos[:, self._position_columns]
        return self._tensors[0]

    @property
    def joint_velocities(self) -> Tensor:
        if "joint_velocities" not in self._current:
            self._current.add("joint_velocities")
            self._joint_velocities[...] = self._qvel[:, self._velocity_columns]
        return self._tensors[1]

    @property
    def link_poses(self) -> Tensor:
        if "link_poses" not in self._current:
            self._current.add("link_poses")
            self.derive()
            poses, quaternions = self._link_poses, self._xquat[:, self._bodies]
            poses[..., :3] = self._xpos[:, self._bodies]
            sign = np.copysign(1.0, quaternions[..., :1])
            np.multiply(quaternions, sign, out=poses[..., 3:], casting="same_kind")
        return self._tensors[2]

    @property
    def link_velocities(self) -> Tensor:
        """``cvel`` is angular, then linear velocity at the centre of mass of the tree: move it to the link's origin."""
        if "link_velocities" not in self._current:
            self._current.add("link_velocities")
            self.derive()
            velocities, spatial = self._link_velocities, self._cvel[:, self._bodies]
            np.subtract(self._xpos[:, self._bodies], self._subtree_com[:, self._roots], out=self._offsets)
            np.copyto(self._spins, spatial[..., :3])
            spins, offsets, swept = self._cross
            torch.linalg.cross(spins, offsets, out=swept)
            np.add(spatial[..., 3:], self._swept, out=velocities[..., :3], casting="same_kind")
            np.copyto(velocities[..., 3:], spatial[..., :3], casting="same_kind")
        return self._tensors[3]

    def derive(self) -> None:
        """Bring MuJoCo's derived fields up to date."""
        if self._any_written:
            self._batch.forward(self._written, stage=DERIVED_STAGE)
            self._all_derived()

    def _all_derived(self) -> None:
        self._written.fill(False)
        self._any_written = False

    # Writing ---------------------------------------------------------------------------------------------------------

    def write_joints(
        self, joints: npt.NDArray[np.int64], positions: FloatArray | None, velocities: FloatArray | None, rows: HostRows
    ) -> None:
        if positions is not None:
            self._qpos[block(rows, self._addresses.joint_positions[joints])] = positions
        if velocities is not None:
            self._qvel[block(rows, self._addresses.joint_velocities[joints])] = velocities
        self.mark_written(rows)

    def write_root(self, entity: int, pose: FloatArray | None, velocity: FloatArray | None, rows: HostRows) -> None:
        """A free root's angular velocity is in its own axes, so that a new pose alone must turn it."""
        mocap = self._addresses.mocaps[entity]
        if mocap >= 0:
            if pose is not None:
                self._mocap_pos[rows, mocap] = pose[:, :3]
                self._mocap_quat[rows, mocap] = _normalized(pose[:, 3:])
        else:
            start, speed = self._addresses.root_positions[entity], self._addresses.root_velocities[entity]
            linear, angular = slice(speed, speed + 3), slice(speed + 3, speed + 6)
            orientation = slice(start + 3, start + 7)
            turning = velocity is not None or self._qvel[rows, angular].any()
            spin = rotate(self._qpos[rows, orientation], self._qvel[rows, angular]) if turning else None
            if pose is not None:
                self._qpos[rows, start : start + 3] = pose[:, :3]
                self._qpos[rows, orientation] = _normalized(pose[:, 3:])
            if velocity is not None:
                self._qvel[rows, linear] = velocity[:, :3]
                spin = velocity[:, 3:].astype(np.float64)
            if spin is not None:
                self._qvel[rows, angular] = rotate_inverse(self._qpos[rows, orientation], spin)
        self.mark_written(rows)


def _normalized(quaternions: FloatArray) -> npt.NDArray[np.float64]:
    quaternions = quaternions.astype(np.float64)
    return quaternions / np.sqrt((quaternions * quaternions).sum(axis=-1, keepdims=True))
