"""State as operations of torch on MuJoCo's own memory, so that a compiled step reads no more of it than it uses."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import warnings

import numpy as np
import torch
from mujoco.batch import Batch
from torch import Tensor

from orbit_core.interfaces import CaptureFacet
from orbit_mjmodel.addresses import Addresses, Indices, columns
from orbit_mujoco.state import State


class MujocoCapture(CaptureFacet):
    """Offers the state that MuJoCo derives as expressions."""

    def __init__(self, batch: Batch, addresses: Addresses, state: State) -> None:
        self._parts = batch, addresses
        self._state = state
        self._expressions: _Expressions | None = None

    def expression(self, name: str) -> Tensor | None:
        # Made when a step is first traced: who does not trace pays nothing for the views.
        self._expressions = self._expressions or _Expressions(*self._parts)
        method = getattr(self._expressions, name, None)
        return None if method is None else method()

    def settle(self) -> None:
        self._state.derive()


class _Expressions:
    """Each method computes what :class:`orbit_mujoco.state.State` fills a tensor with, from fields that are current."""

    def __init__(self, batch: Batch, addresses: Addresses) -> None:
        names = ("qpos", "qvel", "xpos", "xquat", "cvel", "subtree_com")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # some fields are read-only, and here they are only read
            self._fields = {name: torch.from_numpy(batch.bind(name)) for name in names}
        self._bodies, self._roots = _columns(addresses.bodies), _columns(addresses.roots)
        self._positions, self._velocities = _columns(addresses.joint_positions), _columns(addresses.joint_velocities)

    def joint_positions(self) -> Tensor:
        """(N, J)"""
        return self._fields["qpos"][:, self._positions].float()

    def joint_velocities(self) -> Tensor:
        """(N, J)"""
        return self._fields["qvel"][:, self._velocities].float()

    def link_poses(self) -> Tensor:
        """(N, L, 7)"""
        quaternions = self._fields["xquat"][:, self._bodies]
        # By the sign bit, as NumPy's copysign does in the state: a zero may be negative.
        signs = torch.where(torch.signbit(quaternions[..., :1]), -1.0, 1.0)
        return torch.cat((self._fields["xpos"][:, self._bodies], signs * quaternions), -1).float()

    def link_velocities(self) -> Tensor:
        """(N, L, 6)"""
        spatial, positions = self._fields["cvel"][:, self._bodies], self._fields["xpos"][:, self._bodies]
        spins = spatial[..., :3]
        swept = torch.linalg.cross(spins, positions - self._fields["subtree_com"][:, self._roots])
        return torch.cat((spatial[..., 3:] + swept, spins), -1).float()


def _columns(indices: Indices) -> slice | Tensor:
    chosen = columns(indices)
    return chosen if isinstance(chosen, slice) else torch.from_numpy(np.asarray(chosen, dtype=np.int64))
