"""State as operations of torch on MuJoCo's own memory, so that a compiled step reads no more of it than it uses."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import torch
from mujoco.batch import Batch
from torch import Tensor

from orbit_core.interfaces import CaptureFacet
from orbit_core.interfaces.capture import Lead
from orbit_mjmodel.addresses import Addresses, Indices, columns
from orbit_mujoco.parameters import Parameters
from orbit_mujoco.state import FloatArray, State


class MujocoCapture(CaptureFacet):
    """Offers the state that MuJoCo derives as expressions, and a step's controls as operations.

    Args:
        batch: environments of the engine.
        addresses: of the scene's things in the model.
        state: of the environments.
        parameters: of the environments.
        commands: position targets, velocity targets and efforts (N, J) of the engine.
        run: advances by physics steps, with the controls that are set.
    """

    def __init__(
        self,
        batch: Batch,
        addresses: Addresses,
        state: State,
        parameters: Parameters,
        commands: tuple[Tensor, ...],
        run: Callable[[int], None],
    ) -> None:
        self._parts = batch, addresses
        self._state = state
        self._expressions: _Expressions | None = None
        self._controls = parameters, commands
        self._run = run
        self._lead: _Controls | None = None

    def expression(self, name: str) -> Tensor | None:
        # Made when a step is first traced: who does not trace pays nothing for the views.
        self._expressions = self._expressions or _Expressions(*self._parts)
        method = getattr(self._expressions, name, None)
        return None if method is None else method()

    def lead(self, name: str) -> Lead | None:
        if name != "step":
            return None
        self._lead = self._lead or _Controls(self._parts[0], *self._controls)
        return Lead(self._lead.prepare, self._lead.write, self._run)

    def settle(self) -> None:
        self._state.derive()


class _Controls:
    """Controls of drives from targets and gains, as :class:`orbit_mujoco.engine.MujocoEngine` writes them."""

    def __init__(self, batch: Batch, parameters: Parameters, commands: tuple[Tensor, ...]) -> None:
        self._parameters, self._commands = parameters, commands
        self._control = torch.from_numpy(batch.bind("ctrl"))
        # The parameters make new arrays of the gains whenever these change, and a trace reads the same memory always.
        self._known: tuple[FloatArray, FloatArray] | None = None
        self._stiffness, self._damping = torch.zeros(2, *self._control.shape, dtype=torch.float64).unbind()

    def prepare(self) -> None:
        """Bring the gains up to date."""
        parameters = self._parameters
        parameters.settle()
        if self._known is None or self._known[0] is not parameters.stiffness:
            self._known = parameters.stiffness, parameters.damping
            self._stiffness.numpy()[...], self._damping.numpy()[...] = self._known

    def write(self) -> None:
        """Set the controls."""
        positions, velocities, efforts = self._commands
        self._control.copy_(positions * self._stiffness + velocities * self._damping + efforts)


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
