"""N environments of one scene on MuJoCo-Warp."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information, and Warp's arrays carry theirs at run time.

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import mujoco_warp as mjw
import torch
import warp as wp
from torch import Tensor

from orbit_core.interfaces import Approximation, BuiltModel, RayHits, SceneLayout
from orbit_core.plugin_kit.engines import PartedEngine
from orbit_core.plugin_kit.memory import check_memory
from orbit_core.plugin_kit.rows import Rows, rows_of
from orbit_mjmodel.drives import implicit_bounds, spring_lead
from orbit_warp.buffers import BufferSizes, buffer_sizes
from orbit_warp.capture import WarpCapture
from orbit_warp.config import WarpConfig
from orbit_warp.contacts import ContactMeter
from orbit_warp.faults import Faults
from orbit_warp.field_contacts import FieldContacts
from orbit_warp.fused_solver import FusedSolver, is_fit
from orbit_warp.kernels import read_efforts, reset_state, write_commands
from orbit_warp.memory import bytes_per_environment
from orbit_warp.model import build_models, on_device, read_back_kinds
from orbit_warp.native import Native
from orbit_warp.parameters import Parameters
from orbit_warp.rays import RayCaster
from orbit_warp.state import State
from orbit_warp.wrenches import WrenchMeter
from orbit_warpkit.graphs import Graphs
from orbit_warpkit.kernels import reset_tensors
from orbit_warpkit.start import start

# Physics steps that one recording takes on a GPU, where to launch a recording costs more than on a CPU.
_MOST_RECORDED = 16


@dataclass(frozen=True)
class Snapshot:
    """Everything that the continuation depends on."""

    tensors: tuple[Tensor, ...]
    """State and commands."""
    parameters: dict[str, Tensor]
    """Randomised parameters by name."""


class WarpEngine(PartedEngine[State, Parameters]):
    """Holds all environments in MuJoCo-Warp's arrays; a step is one recorded graph on a GPU, and a few on a CPU.

    The graph writes the commands, takes the physics steps, adds up contact forces, notes faults, and brings poses and
    velocities up to date. Nothing in it waits for the host.
    """

    def __init__(self, layout: SceneLayout, num_envs: int, device: torch.device, config: WarpConfig) -> None:
        super().__init__(layout, num_envs, device)
        start()
        kinds = build_models(layout, config)
        built, addresses = kinds[0], kinds[0].addresses
        self._addresses = addresses
        self._report = tuple(dict.fromkeys(line for kind in kinds for line in kind.report))
        self._looped = any(entity.spec.articulation.loops for entity in layout.entities)
        self._graphs = Graphs(device, config.capture)
        with self._graphs.stream():
            self._model = on_device(kinds, config)
            self.buffer_sizes = sizes = buffer_sizes(built.model, self._model, config)
            """Sizes of MuJoCo-Warp's buffers of contacts and constraints."""
            remedy = f", or for smaller buffers than nconmax={sizes.nconmax} and njmax={sizes.njmax}"
            check_memory(num_envs, bytes_per_environment(built.model, self._model, sizes), device, remedy)
            self._data = mjw.make_data(built.model, nworld=num_envs, nconmax=sizes.nconmax, njmax=sizes.njmax)
            # After the data, whose buffers its kernels fill in the place of MuJoCo-Warp's own.
            FieldContacts.replace(self._model, self._data)
            self._fused_solver = config.fused_solver and is_fit(self._model, self._data)
            self._solver: FusedSolver | None = None
            self._solving()  # outside of any recording, for it takes memory
            self._native = Native(built.model, self._model, self._data)
            self._state = State(layout, addresses, self._native, self._graphs)
            self.capture = WarpCapture(self._graphs, self._state, self.prepare, config.capture)
            self._contacts = ContactMeter(layout, addresses, self._model, self._data)
            self._wrench_meter = WrenchMeter(layout, addresses, self._native)
            self._faults = Faults(self._data, sizes, config)
            self._home_qpos = wp.array(built.model.key_qpos[0], dtype=float)
            self._home_mocap_pos = wp.array(built.model.key_mpos[0].reshape(-1, 3), dtype=wp.vec3)
            self._home_mocap_quat = wp.array(built.model.key_mquat[0].reshape(-1, 4), dtype=wp.quat)
            self._bounds = wp.array(implicit_bounds(built.model), dtype=float)
            columns = (addresses.joint_positions, addresses.joint_velocities)
            self._columns = [wp.array(each, dtype=int) for each in columns]
        self._parameters = Parameters(layout, addresses, self._native, self._graphs)
        self._rays = RayCaster(layout, addresses, self._native, self._graphs)
        self._bodies = torch.as_tensor(addresses.bodies, device=device)
        self._all = torch.arange(num_envs, device=device)
        self._commands = (self.position_targets, self.velocity_targets, self.efforts)
        self._warp_commands = tuple(wp.from_torch(command) for command in self._commands)
        # Cloned, because the first command overwrites the targets.
        self._home_targets = wp.from_torch(self.position_targets[0].clone())
        self._efforts = wp.zeros_like(self._data.actuator_force)
        self._joint_efforts = wp.to_torch(self._efforts)
        self._spring_lead = spring_lead(built.model)
        self._contact_forces = wp.to_torch(self._contacts.forces)
        self._wrenches = wp.to_torch(self._data.sensordata).unflatten(1, (-1, 6)) if layout.wrench_links else None
        self._applied = wp.to_torch(self._data.xfrc_applied)
        self.reset()

    # Time ------------------------------------------------------------------------------------------------------------

    def step(self, steps: int) -> None:
        if not self._graphs.recording:
            self.prepare()
        # A recording of each number of steps: on a GPU one launch then does all, on a CPU launches cost little.
        if self.device.type != "cpu" and steps <= _MOST_RECORDED:
            self._graphs.run(("step", steps), lambda: self._take(steps))
        else:
            self._repeat(steps)
        self._state.mark_stepped()
        if self.device.type == "cpu":
            self._faults.report()

    def prepare(self) -> None:
        """Do what a step needs the host for."""
        self._faults.report()  # on a GPU: of the step before
        self._parameters.settle()

    @property
    def raises_divergence(self) -> bool:
        return self._faults.raises_divergence

    @raises_divergence.setter
    def raises_divergence(self, value: bool) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        self._faults.raises_divergence = value

    def _take(self, steps: int) -> None:
        self._begin()
        for _ in range(steps):
            # The share makes the sum of contact forces a mean without a launch of its own; the repeated recording does
            # not know the number of steps and divides at the end.
            self._advance(1.0 / steps)
        self._finish()

    def _repeat(self, steps: int) -> None:
        """Recording a physics step takes long, so that one recording is repeated."""
        self._graphs.run("begin", self._begin)
        for _ in range(steps):
            self._graphs.run("advance", lambda: self._advance(1.0))
        self._contacts.average(steps)
        self._graphs.run("finish", self._finish)

    def _begin(self) -> None:
        self._faults.begin()
        self._contacts.clear()
        if self.layout.joints:
            inputs = [*self._warp_commands, self._model.actuator_biasprm]
            wp.launch(write_commands, dim=self._data.ctrl.shape, inputs=inputs, outputs=[self._data.ctrl])

    def _advance(self, share: float) -> None:
        self._wrench_meter.begin()
        if self._looped:  # their constraints take velocities as the step before left them
            self._state.derive_bodies()
        with self._solving():
            mjw.step(self._model, self._data)
        self._contacts.add(share)

    def _solving(self) -> contextlib.AbstractContextManager[None]:
        """Return the context of a physics step: on a GPU one in which all rounds of the solver are one launch."""
        if not self._fused_solver or not wp.get_device().is_cuda:
            return contextlib.nullcontext()
        self._solver = self._solver or FusedSolver(self._model, self._data)
        return self._solver.installed()

    def _finish(self) -> None:
        self._read_efforts()
        self._wrench_meter.settle()
        self._faults.note()
        self._state.derive()

    def _read_efforts(self) -> None:
        if not self.layout.joints:
            return
        data = self._data
        wp.launch(
            read_efforts,
            dim=self._efforts.shape,
            inputs=[
                data.ctrl, data.actuator_force, self._model.actuator_biasprm, self._bounds, self._spring_lead,
                *self._columns, data.qpos, data.qvel,
            ],
            outputs=[self._efforts],
        )  # fmt: skip

    def check(self) -> None:
        """Wait for the device, and raise what the last step noted rather than when the next begins.

        Raises:
            SimulationError: as :meth:`step`.
        """
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        self._faults.report()

    @property
    def overflows(self) -> int:
        """Steps so far in which a buffer of contacts or constraints was full."""
        return self._faults.overflows

    @property
    def buffer_peaks(self) -> BufferSizes:
        """The most contacts and constraint rows that any step so far needed; reading it waits for the device."""
        return self._faults.peaks

    # State -----------------------------------------------------------------------------------------------------------

    @property
    def joint_efforts(self) -> Tensor:
        return self._joint_efforts

    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        self._state.write_joints(joints, positions, velocities, env_ids)

    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        self._state.write_root(entity, pose, velocity, self._indices(env_ids))

    def reset(self, env_ids: Tensor | None = None) -> None:
        ids = wp.from_torch(self._indices(env_ids).contiguous())
        data = self._data
        with self._graphs.stream():
            wp.launch(
                reset_state,
                dim=len(ids),
                inputs=[ids, self._home_qpos, self._home_mocap_pos, self._home_mocap_quat],
                outputs=[
                    data.qpos, data.qvel, data.qacc_warmstart, data.mocap_pos, data.mocap_quat, data.xfrc_applied,
                    data.time, data.overflow,
                ],
            )  # fmt: skip
            wp.launch(
                reset_tensors,
                dim=len(ids),
                inputs=[ids, self._home_targets],
                outputs=[*self._warp_commands, self._efforts, self._contacts.forces, data.sensordata],
            )
        self._state.mark_written()

    def _rows(self, env_ids: Tensor | None) -> Rows:
        return rows_of(env_ids)

    def _indices(self, env_ids: Tensor | None) -> Tensor:
        """Return indices of environments given by index or by mask; -1 for those outside of the mask."""
        if env_ids is None:
            return self._all
        # Kernels skip negative indices, so that nobody has to count the mask's rows, which would wait for the device.
        return torch.where(env_ids, self._all, -1) if env_ids.dtype == torch.bool else env_ids

    # Measurements ----------------------------------------------------------------------------------------------------

    @property
    def contact_forces(self) -> Tensor:
        return self._contact_forces

    @property
    def joint_wrenches(self) -> Tensor:
        if self._wrenches is None:
            return torch.zeros(self.num_envs, 0, 6, device=self.device)
        return self._wrenches

    def cast_rays(
        self, origins: Tensor, directions: Tensor, max_distance: float, env_ids: Tensor | None = None
    ) -> RayHits:
        self._state.refresh_bodies()
        return self._rays.cast(origins, directions, max_distance, env_ids)

    def cast_rays_past(
        self, origins: Tensor, directions: Tensor, max_distance: float, links: range, env_ids: Tensor | None = None
    ) -> RayHits:
        self._state.refresh_bodies(moving=self._rays.moving(links))
        return self._rays.cast_past(origins, directions, max_distance, links, env_ids)

    # Parameters per environment --------------------------------------------------------------------------------------

    def set_wrenches(self, links: Tensor, wrenches: Tensor, env_ids: Tensor | None = None) -> None:
        rows = self._all if env_ids is None else env_ids
        self._applied[rows[:, None], self._bodies[links]] = wrenches

    def set_masses(self, links: Tensor, masses: Tensor, env_ids: Tensor | None = None) -> None:
        self._parameters.set_masses(links, masses, self._rows(env_ids))
        self._state.mark_written()

    def set_centers_of_mass(self, links: Tensor, centers: Tensor, env_ids: Tensor | None = None) -> None:
        self._parameters.set_centers_of_mass(links, centers, self._rows(env_ids))
        self._state.mark_written()

    def set_joint_parameters(
        self,
        joints: Tensor,
        damping: Tensor | None,
        friction: Tensor | None,
        armature: Tensor | None,
        stiffness: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        self._parameters.set_joints(joints, damping, friction, armature, stiffness, self._rows(env_ids))
        self._state.mark_written()

    def set_joint_limits(self, joints: Tensor, lower: Tensor, upper: Tensor, env_ids: Tensor | None = None) -> None:
        self._parameters.set_joint_limits(joints, torch.stack((lower, upper), dim=-1), self._rows(env_ids))

    def set_drive_gains(
        self, joints: Tensor, stiffness: Tensor, damping: Tensor, env_ids: Tensor | None = None
    ) -> None:
        self._parameters.set_drive_gains(joints, stiffness, damping, self._rows(env_ids))

    # Snapshots and the rest ------------------------------------------------------------------------------------------

    @property
    def _saved(self) -> tuple[Tensor, ...]:
        data = self._data
        arrays = (
            data.qpos,
            data.qvel,
            data.qacc_warmstart,
            data.mocap_pos,
            data.mocap_quat,
            data.time,
            data.sensordata,
        )
        tensors = tuple(wp.to_torch(array) for array in arrays if array.size)
        return (*tensors, *self._commands, self._applied, self._joint_efforts, self._contact_forces)

    def save_state(self) -> Snapshot:
        return Snapshot(tuple(tensor.clone() for tensor in self._saved), self._parameters.save())

    def load_state(self, state: Snapshot) -> None:
        self._parameters.load(state.parameters)
        for own, saved in zip(self._saved, state.tensors, strict=True):
            own.copy_(saved)
        self._state.mark_written()

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        return self._report

    def built_model(self) -> tuple[BuiltModel, ...]:
        return read_back_kinds(self._model, self._addresses, len(self.layout.variants))

    @property
    def native(self) -> Native:
        return self._native

    def close(self) -> None:
        vars(self).clear()  # the arrays go with the last tensor that views them
