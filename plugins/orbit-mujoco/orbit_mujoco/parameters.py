"""Physical parameters that differ between environments.

A field of the model is given a value per environment when it is first set. Constants that follow from masses are
computed again, once, before they are next needed.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt
from mujoco.batch import MODEL_FIELDS, Batch

from orbit_core.plugin_kit.rows import HostRows, block
from orbit_mjmodel.addresses import Addresses
from orbit_mjmodel.drives import ASKED_DAMPING, DAMPING, STIFFNESS, VELOCITY_IMPLICIT, damping_bias, least_damping
from orbit_mjmodel.matter import MatterAddresses, firm_contacts
from orbit_mujoco.state import FloatArray

Indices = npt.NDArray[np.int64]


class Parameters:
    """Sets and remembers the per-environment fields of the model."""

    def __init__(
        self,
        batch: Batch,
        addresses: Addresses,
        kinds: Sequence[mujoco.MjModel],
        matter: Sequence[MatterAddresses] = (),
    ) -> None:
        """Give environment i the values of the kind of index i modulo their number."""
        self._batch, self._matter = batch, matter
        self._model: mujoco.MjModel = batch.model
        self._addresses = addresses
        self._fields: dict[str, npt.NDArray] = {}
        self._nominal: dict[str, npt.NDArray] = {}
        self._constants_due = np.zeros(batch.nsim, dtype=bool)
        # Whether any environment's are, known without a look at the array.
        self._any_due = False
        for name in MODEL_FIELDS if len(kinds) > 1 else ():
            self._vary(name, kinds)
        self.stiffness: FloatArray
        """(J,) or (N, J) of the drives."""
        self.damping: FloatArray
        """(J,) or (N, J)"""
        self._read_gains()

    def settle(self) -> None:
        """Compute what follows from the masses that were set."""
        if self._any_due:
            self._batch.set_const(self._constants_due)
            if self._matter:
                self._firm_contacts()
            self._constants_due.fill(False)
            self._any_due = False
            if self._model.nu:
                self._hold_drives()

    def _firm_contacts(self) -> None:
        """Make contacts firm again after MuJoCo has recomputed its constants."""
        weights = [self._batch.expand(name) for name in ("body_invweight0", "dof_invweight0")]
        own = [weight[self._constants_due] for weight in weights]
        firm_contacts(own[0], own[1], self._matter)
        for weight, changed in zip(weights, own, strict=True):
            weight[self._constants_due] = changed

    def set_masses(self, links: Indices, masses: FloatArray, rows: HostRows) -> None:
        bodies = self._addresses.bodies[links]
        index = block(rows, bodies)
        mass, inertia = self.field("body_mass"), self.field("body_inertia")
        scale = masses / self._nominal["body_mass"][index]
        mass[index] = masses
        inertia[index] = self._nominal["body_inertia"][index] * scale[..., None]
        self._constants_due[rows] = self._any_due = True

    def set_centers_of_mass(self, links: Indices, centers: FloatArray, rows: HostRows) -> None:
        self.field("body_ipos")[block(rows, self._addresses.bodies[links])] = centers
        self._constants_due[rows] = self._any_due = True

    def set_friction(self, links: Indices, coefficients: FloatArray, rows: HostRows) -> None:
        friction = self.field("geom_friction")
        for column, link in enumerate(links):
            index = (*block(rows, self._addresses.geoms(int(link))), 0)
            friction[index] = coefficients[:, column, None]
        if self._model.npair:
            own = friction[rows, :, 0]
            larger = np.maximum(own[:, self._model.pair_geom1], own[:, self._model.pair_geom2])
            self.field("pair_friction")[rows, :, :2] = larger[..., None]

    def set_drive_gains(self, joints: Indices, stiffness: FloatArray, damping: FloatArray, rows: HostRows) -> None:
        driven = self._model.actuator_gainprm[joints, 0] > 0  # a mimic joint has no drive
        index = block(rows, joints[driven])
        bias = self.field("actuator_biasprm")
        bias[(*index, STIFFNESS)] = -stiffness[:, driven]
        bias[(*index, DAMPING)] = bias[(*index, ASKED_DAMPING)] = -damping[:, driven]
        self._hold_drives()

    def set_joints(
        self,
        joints: Indices,
        damping: FloatArray | None,
        friction: FloatArray | None,
        armature: FloatArray | None,
        stiffness: FloatArray | None,
        rows: HostRows,
    ) -> None:
        columns = self._addresses.joint_velocities[joints]
        index = block(rows, columns)
        if stiffness is not None:
            self.field("jnt_stiffness")[block(rows, self._addresses.joints[joints])] = stiffness
            damping = self.field("dof_damping")[index] if damping is None else damping
        if damping is not None:
            varied = self._fields.get("jnt_stiffness")
            springs = self._model.jnt_stiffness[None] if varied is None else varied[rows]
            springs = springs[:, self._addresses.joints[joints]]
            weights, step = self._model.dof_invweight0[columns], self._model.opt.timestep
            damping = np.maximum(damping, least_damping(springs, weights, step))
        for name, values in (("dof_damping", damping), ("dof_frictionloss", friction), ("dof_armature", armature)):
            if values is not None:
                self.field(name)[index] = values
        if armature is not None:
            self._constants_due[rows] = self._any_due = True

    def set_joint_limits(self, joints: Indices, limits: FloatArray, rows: HostRows) -> None:
        """(n, k, 2) lower and upper."""
        self.field("jnt_range")[block(rows, self._addresses.joints[joints])] = limits

    def set_gravity(self, gravity: FloatArray, rows: HostRows) -> None:
        self.field("opt.gravity")[rows] = gravity

    @property
    def masses(self) -> FloatArray:
        """(bodies,) or (N, bodies) kg."""
        varied = self._fields.get("body_mass")
        return self._model.body_mass if varied is None else varied

    @property
    def gravity(self) -> FloatArray:
        """(3,) or (N, 3) m/s^2."""
        varied = self._fields.get("opt.gravity")
        return self._model.opt.gravity if varied is None else varied

    def scale_masses(self, bodies: slice, scales: FloatArray, rows: HostRows) -> None:
        """Give bodies the scene's masses and inertias times (n,)."""
        for name in ("body_mass", "body_inertia"):
            self.scale(name, np.arange(bodies.start, bodies.stop), scales, rows)
        self._constants_due[rows] = self._any_due = True

    def scale(self, name: str, columns: Indices, scales: FloatArray, rows: HostRows) -> None:
        """Give columns of a field the scene's values times (n,)."""
        field = self.field(name)
        index = block(rows, columns)
        nominal = self._nominal[name][index]
        field[index] = nominal * scales.reshape(-1, *(1 for _ in nominal.shape[1:]))

    def save(self) -> dict[str, npt.NDArray]:
        """Copies of the fields that differ between environments."""
        return {name: values.copy() for name, values in self._fields.items()}

    def load(self, saved: dict[str, npt.NDArray]) -> None:
        """Return to what :meth:`save` gave; fields that it lacks return to the scene's values."""
        for name in {*saved, *self._fields}:
            self.field(name)[...] = saved.get(name, self._nominal.get(name))
        if {"body_mass", "body_ipos", "dof_armature"} & self._fields.keys():
            self._constants_due.fill(True)
            self._any_due = True
        self._read_gains()

    def field(self, name: str) -> npt.NDArray:
        """(N, ...) of the model, with a row for each environment from now on."""
        if name not in self._fields:
            self._fields[name] = self._batch.expand(name)
            self._nominal[name] = self._fields[name].copy()
        return self._fields[name]

    def _vary(self, name: str, kinds: Sequence[mujoco.MjModel]) -> None:
        """Set a field in which kinds differ; in the options, whose names have a dot, they do not."""
        values = [np.asarray(getattr(kind, name, 0.0)) for kind in kinds]
        if any(not np.array_equal(value, values[0]) for value in values):
            field = self._batch.expand(name)
            chosen = np.stack(values)[np.arange(len(field)) % len(kinds)]
            field[...] = chosen[:, : field.shape[1]].reshape(field.shape)
            self._fields[name], self._nominal[name] = field, field.copy()

    def _hold_drives(self) -> None:
        """Give drives the damping that they need with the present gains and masses."""
        if self._model.opt.integrator in VELOCITY_IMPLICIT:
            bias = self.field("actuator_biasprm")
            inverse_inertia = self._batch.expand("dof_invweight0")[:, self._addresses.joint_velocities]
            bias[..., DAMPING] = damping_bias(bias, inverse_inertia, self._model.opt.timestep)
        self._read_gains()

    def _read_gains(self) -> None:
        varied = "actuator_biasprm" in self._fields
        bias = self._fields["actuator_biasprm"] if varied else self._model.actuator_biasprm
        self.stiffness, self.damping = -bias[..., STIFFNESS], -bias[..., DAMPING]
