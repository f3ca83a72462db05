"""Physical parameters that differ between environments: Newton's arrays have a value per environment from the start."""

# pyright: reportArgumentType=false

from __future__ import annotations

from collections.abc import Callable

import torch
import warp as wp
from torch import Tensor

from orbit_core.interfaces import TERRAIN
from orbit_core.plugin_kit.rows import Rows, block
from orbit_newton.plant import Plant


class Parameters:
    """Sets and remembers the per-environment parameters of the model."""

    def __init__(self, plant: Plant, masses_changed: Callable[[], None]) -> None:
        model, envs = plant.model, plant.num_envs
        self._plant, self._masses_changed = plant, masses_changed
        self._masses = wp.to_torch(model.body_mass).view(envs, -1)
        self._inverse_masses = wp.to_torch(model.body_inv_mass).view(envs, -1)
        self._inertias = wp.to_torch(model.body_inertia).view(envs, -1, 3, 3)
        self._inverse_inertias = wp.to_torch(model.body_inv_inertia).view(envs, -1, 3, 3)
        self._centers = wp.to_torch(model.body_com).view(envs, -1, 3)
        self._gravity = wp.to_torch(model.gravity)
        self._friction = wp.to_torch(model.shape_material_mu)[: model.shape_count].view(envs, -1)
        self._link_of_shape = torch.as_tensor(plant.built.link_of_shape, device=self._masses.device)
        # Masses are set relative to the description, and not to the last setting, so that errors do not add up.
        nominal = (self._masses, self._inverse_masses, self._inertias, self._inverse_inertias)
        self._nominal = tuple(values[0].clone() for values in nominal)
        self._due = False

    def settle(self) -> None:
        """Notify the solver of masses that were set."""
        if self._due:
            self._masses_changed()
            self._due = False

    def set_masses(self, links: Tensor, masses: Tensor, rows: Rows) -> None:
        mass, inverse_mass, inertia, inverse_inertia = (values[links] for values in self._nominal)
        index = block(rows, links)
        scale = masses / mass
        self._masses[index] = masses
        # Newton's solvers read inverses that its builder has computed once; nobody else updates them.
        self._inverse_masses[index] = inverse_mass / scale
        self._inertias[index] = inertia * scale[..., None, None]
        self._inverse_inertias[index] = inverse_inertia / scale[..., None, None]
        self._due = True

    def set_centers_of_mass(self, links: Tensor, centers: Tensor, rows: Rows) -> None:
        self._centers[block(rows, links)] = centers
        self._due = True

    def set_friction(self, links: Tensor, coefficients: Tensor, rows: Rows) -> None:
        for column, link in enumerate(links.tolist()):
            shapes = torch.nonzero(self._link_of_shape == (TERRAIN if link < 0 else link))[:, 0]
            self._friction[block(rows, shapes)] = coefficients[:, column, None]

    def set_drive_gains(self, joints: Tensor, stiffness: Tensor, damping: Tensor, rows: Rows) -> None:
        mimics = [joint.mimic is not None for joint in self._plant.layout.joints]
        # A joint that mimics another is moved by that one's drive, as in the model's own gains.
        driven = ~torch.tensor(mimics, device=joints.device)[joints]
        self._plant.stiffness[block(rows, joints)] = stiffness * driven
        self._plant.damping[block(rows, joints)] = damping * driven

    def set_gravity(self, gravity: Tensor, rows: Rows) -> None:
        self._gravity[: self._plant.num_envs][rows] = gravity

    @property
    def _all(self) -> tuple[Tensor, ...]:
        return (
            self._masses, self._inverse_masses, self._inertias, self._inverse_inertias, self._centers, self._gravity,
            self._friction, self._plant.stiffness, self._plant.damping,
        )  # fmt: skip

    def save(self) -> tuple[Tensor, ...]:
        """Copies of all parameters."""
        return tuple(values.clone() for values in self._all)

    def load(self, saved: tuple[Tensor, ...]) -> None:
        """Return to what :meth:`save` gave."""
        for own, values in zip(self._all, saved, strict=True):
            own.copy_(values)
        self._due = True
