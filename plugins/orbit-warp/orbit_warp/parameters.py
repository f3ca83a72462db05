"""Physical parameters that differ between environments.

A field of the model is given a value per environment when it is first set, after which recordings that use it are made
again. Constants that follow from masses are computed once, before they are next needed.
"""

from __future__ import annotations

import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from torch import Tensor

from orbit_core.interfaces import TERRAIN, SceneLayout
from orbit_core.plugin_kit.rows import Rows, block
from orbit_mjmodel.addresses import Addresses
from orbit_mjmodel.drives import ASKED_DAMPING, DAMPING, STIFFNESS, VELOCITY_IMPLICIT, damping_bias, least_damping
from orbit_warp.model import LEAST_FRICTION
from orbit_warp.native import Native
from orbit_warpkit.graphs import Graphs

_OF_ARMATURE = ("dof_armature", "body_invweight0", "dof_invweight0")
_OF_MASS = ("body_mass", "body_inertia", "body_ipos", "body_subtreemass", "body_invweight0", "dof_invweight0")


class Parameters:
    """Sets and remembers the per-environment fields of the model."""

    def __init__(self, layout: SceneLayout, addresses: Addresses, native: Native, graphs: Graphs) -> None:
        self._model, self._data, self._graphs = native.model, native.data, graphs
        data = self._data
        device = wp.device_to_torch(data.qpos.device)
        self._joints = torch.as_tensor(addresses.joints, device=device)
        weights = native.host_model.dof_invweight0[addresses.joint_velocities]
        self._weights = torch.as_tensor(weights, dtype=torch.float32, device=device)
        self._environments = torch.arange(data.nworld, device=device)
        self._bodies = torch.as_tensor(addresses.bodies, device=device)
        links = addresses.link_of_geom[:-1]
        self._link_of_geom = torch.as_tensor(np.where(links == TERRAIN, len(layout.links), links), device=device)
        self._links = len(layout.links)
        pairs = np.stack((native.host_model.pair_geom1, native.host_model.pair_geom2), -1)
        self._pair_geoms = torch.as_tensor(pairs, dtype=torch.long, device=device)
        self._velocity_columns = torch.as_tensor(addresses.joint_velocities, device=device)
        self._time_step = layout.scene.physics_dt
        self._driven = torch.as_tensor([joint.mimic is None for joint in layout.joints], device=device)
        self._fields: dict[str, Tensor] = {}
        self._nominal: dict[str, Tensor] = {}
        self._constants_due = False

    def settle(self) -> None:
        """Compute what follows from the masses that were set."""
        if self._constants_due:
            with self._graphs.stream():
                mjw.set_const(self._model, self._data)
            self._constants_due = False
            if len(self._driven):
                self._hold_drives()

    def set_masses(self, links: Tensor, masses: Tensor, rows: Rows) -> None:
        self._expand_masses()
        bodies = self._bodies[links]
        index = block(rows, bodies)
        # Relative to the description, and not to the last setting, so that errors of rounding do not add up.
        scale = masses / self._nominal["body_mass"][index]
        self._fields["body_mass"][index] = masses
        self._fields["body_inertia"][index] = self._nominal["body_inertia"][index] * scale[..., None]
        self._constants_due = True

    def set_centers_of_mass(self, links: Tensor, centers: Tensor, rows: Rows) -> None:
        self._expand_masses()
        self._fields["body_ipos"][block(rows, self._bodies[links])] = centers
        self._constants_due = True

    def set_friction(self, links: Tensor, coefficients: Tensor, rows: Rows) -> None:
        friction = self._field("geom_friction")
        columns = torch.full((self._links + 1,), -1, device=friction.device)
        columns[torch.where(links < 0, self._links, links)] = torch.arange(len(links), device=friction.device)
        column = columns[self._link_of_geom]
        asked = coefficients.clamp_min(LEAST_FRICTION)[:, column.clamp_min(0)]
        friction[rows, :, 0] = torch.where(column >= 0, asked, friction[rows, :, 0])
        if self._pair_geoms.numel():
            larger = friction[rows, :, 0][:, self._pair_geoms].amax(-1)
            self._field("pair_friction")[rows, :, :2] = larger[..., None]

    def set_drive_gains(self, joints: Tensor, stiffness: Tensor, damping: Tensor, rows: Rows) -> None:
        bias = self._field("actuator_biasprm")
        index = block(rows, joints)
        driven = self._driven[joints]  # a mimic joint has no drive
        for number, gains in ((STIFFNESS, stiffness), (DAMPING, damping), (ASKED_DAMPING, damping)):
            bias[(*index, number)] = torch.where(driven, -gains, 0.0)
        self._hold_drives()

    def set_joints(
        self,
        joints: Tensor,
        damping: Tensor | None,
        friction: Tensor | None,
        armature: Tensor | None,
        stiffness: Tensor | None,
        rows: Rows,
    ) -> None:
        index, springs = block(rows, self._velocity_columns[joints]), block(rows, self._joints[joints])
        if stiffness is not None:
            self._field("jnt_stiffness")[springs] = stiffness
            # A stiffer spring may need more damping than the joint has, by the rule that is applied next.
            damping = self._field("dof_damping")[index] if damping is None else damping
        if damping is not None:
            own = self._field("jnt_stiffness")[springs]
            damping = torch.maximum(damping, least_damping(own, self._weights[joints], self._time_step))
        for name, values in (("dof_damping", damping), ("dof_frictionloss", friction), ("dof_armature", armature)):
            if values is not None:
                self._field(name)[index] = values
        if armature is not None:
            for name in _OF_ARMATURE:
                self._field(name)
            self._constants_due = True

    def set_joint_limits(self, joints: Tensor, limits: Tensor, rows: Rows) -> None:
        """(n, k, 2) lower and upper."""
        self._field("jnt_range")[block(rows, self._joints[joints])] = limits

    def set_gravity(self, gravity: Tensor, rows: Rows) -> None:
        self._field("opt.gravity")[rows] = gravity

    def save(self) -> dict[str, Tensor]:
        """Copies of the fields that differ between environments."""
        self.settle()
        return {name: values.clone() for name, values in self._fields.items()}

    def load(self, saved: dict[str, Tensor]) -> None:
        """Return to what :meth:`save` gave; fields that it lacks return to the scene's values."""
        for name in {*saved, *self._fields}:
            own = self._field(name)
            own.copy_(saved[name] if name in saved else self._nominal[name])
        self._constants_due = False

    def _hold_drives(self) -> None:
        """Give drives the damping that they need with the present gains and masses."""
        if self._model.opt.integrator in VELOCITY_IMPLICIT:
            bias, weights = self._field("actuator_biasprm"), wp.to_torch(self._model.dof_invweight0)
            inverse_inertia = weights[self._environments % len(weights)][:, self._velocity_columns]
            bias[..., DAMPING] = damping_bias(bias, inverse_inertia, self._time_step)

    def _expand_masses(self) -> None:
        for name in _OF_MASS:
            self._field(name)

    def _field(self, name: str) -> Tensor:
        """The field with a value per environment, as a tensor that shares its memory."""
        if name not in self._fields:
            owner, attribute = (self._model.opt, name[4:]) if name.startswith("opt.") else (self._model, name)
            shared: wp.array = getattr(owner, attribute)
            with self._graphs.stream():
                values = shared.numpy()[np.arange(self._data.nworld) % shared.shape[0]]
                expanded = wp.array(values, dtype=shared.dtype)
            setattr(owner, attribute, expanded)
            self._graphs.forget()
            self._fields[name] = wp.to_torch(expanded)
            self._nominal[name] = self._fields[name].clone()
        return self._fields[name]
