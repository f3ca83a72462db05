"""The plant that engine and solver share: model and state of all environments, commands, gains and measurements."""

# pyright: reportMissingImports=false
# pyright: reportArgumentType=false

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import newton
import torch
import warp as wp
from torch import Tensor

from orbit_core.interfaces import SceneLayout
from orbit_newton.builder import BuiltModel
from orbit_newton.contacts import ContactFinder, ContactMeter
from orbit_newton.kernels import write_body_forces


@dataclass(eq=False)
class Plant:
    """Everything that a solver reads and writes. Tensors share their memory with the arrays that kernels take."""

    layout: SceneLayout
    """Numbers of the scene's links and joints."""
    built: BuiltModel
    """Newton's model and the numbers in it."""
    num_envs: int
    """Number N of environments."""
    config: Any
    """Settings of the backend."""
    finder: ContactFinder
    """Collision detection."""
    meter: ContactMeter
    """Sums of contact forces."""
    position_targets: Tensor
    """(N, J) rad or m."""
    velocity_targets: Tensor
    """(N, J) rad/s or m/s."""
    efforts: Tensor
    """(N, J) commanded, N m or N."""

    def __post_init__(self) -> None:
        device, parameters = self.position_targets.device, self.layout.joint_parameters
        self.model: newton.Model = self.built.model
        self.state: newton.State = self.model.state()
        self.control: newton.Control = self.model.control()
        joints, links = len(self.layout.joints), len(self.layout.links)

        def per_env(values: Any) -> Tensor:
            return torch.as_tensor(values, dtype=torch.float32, device=device).repeat(self.num_envs, 1)

        driven = torch.tensor([joint.mimic is None for joint in self.layout.joints], dtype=torch.float32)
        self.stiffness = per_env(parameters.drive_stiffness) * driven.to(device)
        """(N, J) of the drives; a mimic joint has none."""
        # Gains are tensors of the plant rather than Newton's, because they differ between environments and solvers
        # scale them.
        self.damping = per_env(parameters.drive_damping) * driven.to(device)
        self.joint_efforts = torch.zeros(self.num_envs, joints, device=device)
        self.applied = torch.zeros(self.num_envs, links, 6, device=device)
        """(N, L) wrenches at centres of mass."""
        compensated = [
            float(self.layout.entities[entity].spec.gravity_compensation) for entity in self.layout.entity_of_link
        ]
        with wp.ScopedDevice(self.model.device):
            self._compensated = wp.array(compensated, dtype=float)
            self.wrenches = wp.zeros((self.num_envs, len(self.layout.wrench_links)), dtype=wp.spatial_vector)
            """(N, W) that the layout's wrench links receive, as the contract has them."""
        self._applied = wp.from_torch(self.applied, dtype=wp.spatial_vector)

    def rows(self, array: wp.array) -> wp.array:
        """A flat array of all environments with a row per environment."""
        return array.reshape((self.num_envs, -1))

    def write_body_forces(self) -> None:
        """Begin a solver step: what acts on bodies from outside."""
        wp.launch(
            write_body_forces,
            dim=(self.num_envs, len(self.layout.links)),
            inputs=[self._applied, self._compensated, self.model.body_mass, self.model.gravity],
            outputs=[self.state.body_f],
        )


class Dynamics:
    """One of Newton's solvers over a plant."""

    maximal = False
    """Whether bodies, rather than joints, carry the state."""
    solver_steps: int
    """Number of the solver's steps in a physics step."""

    def __init__(self, plant: Plant) -> None: ...

    def take(self) -> None:
        """Launch one physics step."""
        raise NotImplementedError

    def masses_changed(self) -> None:
        """Take in masses, inertias and centres of mass of the model that were changed."""

    def reset(self, env_ids: Tensor) -> None:
        """Forget the past of some environments."""

    @property
    def memory(self) -> tuple[Tensor, ...]:
        """Tensors of the past that the next step depends on, in addition to the plant's state."""
        return ()
