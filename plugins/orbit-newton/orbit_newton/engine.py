"""N environments of one scene on one of Newton's solvers."""

# pyright: reportMissingImports=false
# pyright: reportArgumentType=false

from __future__ import annotations

from dataclasses import dataclass

import newton
import torch
import warp as wp
from torch import Tensor

from orbit_core.interfaces import (
    Approximation,
    BuiltModel,
    Capabilities,
    SceneLayout,
    SimulationError,
    divergence_error,
)
from orbit_core.plugin_kit.engines import PartedEngine
from orbit_core.plugin_kit.rows import Rows, rows_of
from orbit_newton.builder import build_model
from orbit_newton.config import NewtonConfig
from orbit_newton.contacts import ContactFinder, ContactMeter
from orbit_newton.kernels import note_divergence, note_overflow
from orbit_newton.parameters import Parameters
from orbit_newton.plant import Dynamics, Plant
from orbit_newton.readback import read_back
from orbit_newton.report import approximations
from orbit_newton.state import State
from orbit_warpkit.graphs import Graphs
from orbit_warpkit.kernels import reset_tensors
from orbit_warpkit.start import start

_DIVERGED, _OVERFLOWN = 1, 2


@dataclass(frozen=True)
class Native:
    """Newton's own objects."""

    model: newton.Model
    """Model of all environments."""
    state: newton.State
    """Positions and velocities."""
    control: newton.Control
    """Targets and efforts."""
    contacts: newton.Contacts
    """Contacts of the last step."""


@dataclass(frozen=True)
class Snapshot:
    """Everything that the continuation depends on."""

    tensors: tuple[Tensor, ...]
    """State and commands."""
    parameters: tuple[Tensor, ...]
    """Randomised parameters."""


class NewtonEngine(PartedEngine[State, Parameters]):
    """Holds all environments in Newton's arrays; a physics step is a recorded graph."""

    def __init__(
        self,
        layout: SceneLayout,
        num_envs: int,
        device: torch.device,
        config: NewtonConfig,
        dynamics: type[Dynamics],
        capabilities: Capabilities,
    ) -> None:
        super().__init__(layout, num_envs, device)
        start()
        self._graphs = Graphs(device, config.capture)
        with self._graphs.stream():
            built = build_model(layout, num_envs, self._graphs.device, config.contact_gap, dynamics.maximal)
            finder = ContactFinder(built, num_envs, config, layout.scene.physics_dt)
            meter = ContactMeter(layout, built, num_envs, finder)
            commands = (self.position_targets, self.velocity_targets, self.efforts)
            self._plant = plant = Plant(layout, built, num_envs, config, finder, meter, *commands)
            self._dynamics = dynamics(plant)
            self._state = State(plant, self._graphs, self._dynamics.maximal)
            self._diverged = wp.zeros(num_envs, dtype=int)
            # One word for all environments: after a step the host reads this alone, not a flag for each of them.
            self._summary = wp.zeros(1, dtype=int)
        self._parameters = Parameters(plant, self._dynamics.masses_changed)
        self._report = approximations(layout, capabilities)
        self._all = torch.arange(num_envs, device=device)
        self._commands = commands
        # Cloned, because the targets themselves are overwritten by the first command.
        self._home_targets = wp.from_torch(self.position_targets[0].clone())
        self._contact_forces = wp.to_torch(meter.forces)
        self._wrenches = wp.to_torch(plant.wrenches)
        self.reset()

    # Time ------------------------------------------------------------------------------------------------------------

    def step(self, steps: int) -> None:
        self._parameters.settle()
        self._state.settle()
        with self._graphs.stream():
            self._plant.meter.clear()
        for _ in range(steps):  # one recording for any number of steps: recording takes long
            self._graphs.run("step", self._take)
        # Solvers take substeps, and each adds its forces to the sum.
        self._plant.meter.average(steps * self._dynamics.solver_steps)
        # Recorded apart from the physics step, because it runs once for any number of them.
        self._graphs.run("finish", self._finish)
        self.check()

    def _take(self) -> None:
        self._dynamics.take()
        self._state.take()

    def _finish(self) -> None:
        plant = self._plant
        self._summary.zero_()
        if plant.finder.any:
            count = plant.finder.contacts.rigid_contact_count
            wp.launch(note_overflow, dim=1, inputs=[count, plant.finder.capacity], outputs=[self._summary])
        rows = (plant.rows(plant.state.body_q), plant.rows(plant.state.body_qd), plant.rows(plant.state.joint_q))
        wp.launch(note_divergence, dim=self.num_envs, inputs=rows, outputs=[self._diverged, self._summary])
        self._state.read()

    def check(self) -> None:
        """Raise what went wrong in the last step.

        Raises:
            SimulationError: environments diverged, or the contact buffer was full.
        """
        fault = int(self._summary.numpy()[0])
        if fault & _DIVERGED and self.raises_divergence:
            raise divergence_error(torch.nonzero(wp.to_torch(self._diverged))[:, 0].tolist())
        if fault & _OVERFLOWN:
            size = -(-self._plant.finder.capacity // self.num_envs)
            raise SimulationError(
                f"{size} contacts per environment are too few: some were lost; use settings contacts_per_env={2 * size}"
            )

    # State -----------------------------------------------------------------------------------------------------------

    @property
    def joint_efforts(self) -> Tensor:
        return self._plant.joint_efforts

    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        self._state.write_joints(joints, positions, velocities, self._rows(env_ids))

    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        self._state.write_root(entity, pose, velocity, self._all if env_ids is None else env_ids)

    def reset(self, env_ids: Tensor | None = None) -> None:
        ids = self._all if env_ids is None else env_ids
        with self._graphs.stream():
            wp.launch(
                reset_tensors,
                dim=len(ids),
                inputs=[wp.from_torch(ids.contiguous()), self._home_targets],
                outputs=[
                    *(wp.from_torch(command) for command in self._commands), wp.from_torch(self._plant.joint_efforts),
                    self._plant.meter.forces, wp.from_torch(self._wrenches.flatten(1)),
                ],
            )  # fmt: skip
        self._state.reset(ids)
        self._dynamics.reset(ids)

    # Measurements ----------------------------------------------------------------------------------------------------

    @property
    def contact_forces(self) -> Tensor:
        return self._contact_forces

    @property
    def joint_wrenches(self) -> Tensor:
        return self._wrenches

    # Parameters per environment --------------------------------------------------------------------------------------

    def set_wrenches(self, links: Tensor, wrenches: Tensor, env_ids: Tensor | None = None) -> None:
        rows = self._all if env_ids is None else env_ids
        self._plant.applied[rows[:, None], links] = wrenches

    def set_centers_of_mass(self, links: Tensor, centers: Tensor, env_ids: Tensor | None = None) -> None:
        velocities = self.link_velocities.clone()
        # Velocities are read before, because Newton keeps those of centres of mass, and must give the origins' as they
        # were.
        self._parameters.set_centers_of_mass(links, centers, self._rows(env_ids))
        for entity in self.layout.entities:  # a free root's coordinates are of its centre of mass
            if not entity.spec.fixed_base:
                rows = self._all if env_ids is None else env_ids
                self.write_root_state(entity.index, None, velocities[rows, entity.root_link], rows)
        # Poses of links follow from the coordinates and the centres, so that both must be derived again.
        self._state.mark_written(self._rows(env_ids))

    def set_drive_gains(
        self, joints: Tensor, stiffness: Tensor, damping: Tensor, env_ids: Tensor | None = None
    ) -> None:
        self._parameters.set_drive_gains(joints, stiffness, damping, self._rows(env_ids))

    # Snapshots and the rest ------------------------------------------------------------------------------------------

    @property
    def _saved(self) -> tuple[Tensor, ...]:
        return (
            *self._commands, *self._state.saved, *self._dynamics.memory, self._plant.joint_efforts,
            self._contact_forces, self._wrenches,
        )  # fmt: skip

    def save_state(self) -> Snapshot:
        self._state.settle()
        return Snapshot(tuple(tensor.clone() for tensor in self._saved), self._parameters.save())

    def load_state(self, state: Snapshot) -> None:
        self._parameters.load(state.parameters)
        self._state.settle()
        for own, saved in zip(self._saved, state.tensors, strict=True):
            own.copy_(saved)
        self._state.reread()

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        return self._report

    def built_model(self) -> tuple[BuiltModel, ...]:
        return (read_back(self._plant.built, self.num_envs, self._dynamics.maximal),)

    @property
    def native(self) -> Native:
        plant = self._plant
        return Native(plant.model, plant.state, plant.control, plant.finder.contacts)

    def _rows(self, env_ids: Tensor | None) -> Rows:
        return rows_of(env_ids)

    def close(self) -> None:
        vars(self).clear()  # the arrays go with the last tensor that views them
