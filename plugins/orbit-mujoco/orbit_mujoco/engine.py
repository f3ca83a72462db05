"""N environments of one scene on MuJoCo's batched stepper."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import mujoco.batch
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.interfaces import (
    Approximation,
    BuiltModel,
    Engine,
    RayHits,
    SceneLayout,
    SimulationError,
    divergence_error,
    first_few,
    matter_divergence_error,
)
from orbit_core.plugin_kit.engines import PartedEngine
from orbit_core.plugin_kit.rows import HostRows, block, host_rows
from orbit_mjmodel.addresses import MATTER_BODY
from orbit_mjmodel.readback import read_back
from orbit_mujoco.capture import MujocoCapture
from orbit_mujoco.config import MujocoConfig
from orbit_mujoco.matter import NativeMatter
from orbit_mujoco.measurements import ContactMeter, EffortMeter, MatterMeter, WrenchMeter
from orbit_mujoco.model import build_models
from orbit_mujoco.parameters import Parameters
from orbit_mujoco.state import DERIVED_STAGE, State

_NEAR_SINGULAR = mujoco.mjtWarning.mjWARN_INERTIA.value
# The warning that MuJoCo also gives, for no harm, where its solver meets cloth's bending at a residual of 1e-8.
_DIVERGENCE = [
    warning.value
    for warning in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
        mujoco.mjtWarning.mjWARN_BADCTRL,
    )
]
_NO_STAGE = mujoco.mjtStage.mjSTAGE_NONE.value


@dataclass(frozen=True)
class Snapshot:
    """Everything that the continuation depends on."""

    rows: npt.NDArray[np.float64]
    """(N, size) state of each environment, in MuJoCo's order of its parts."""
    parameters: dict[str, npt.NDArray]
    """Randomised parameters by name."""
    tensors: tuple[Tensor, ...]
    """Commands, then what the last step measured."""


class MujocoEngine(PartedEngine[State, Parameters]):
    """Holds one MjData per environment, whose derived fields are current after each step.

    A step ends with MuJoCo's position and velocity stages, with which the next step begins, so they cost nothing.
    """

    def __init__(self, layout: SceneLayout, num_envs: int, device: torch.device, config: MujocoConfig) -> None:
        super().__init__(layout, num_envs, device)
        self._kinds = kinds = build_models(layout, config)
        built = kinds[0]
        # Warnings come as SimulationError; MuJoCo would write them to the terminal and to a file as well.
        mujoco.set_mju_user_warning(_ignore)
        self._model, self._addresses = built.model, built.addresses
        self._report = tuple(dict.fromkeys(line for kind in kinds for line in kind.report))
        self._batch = mujoco.batch.Batch(built.model, num_envs, config.threads, persistent=True)
        self._state = State(self._batch, built.addresses)
        self._parameters = Parameters(self._batch, built.addresses, [kind.model for kind in kinds], built.matter)
        self.capture = MujocoCapture(
            self._batch, built.addresses, self._state, self._parameters, self._commands, self._run
        )
        self._matter = NativeMatter(self._batch, built.addresses, built.matter, self._parameters, self._state)
        self._sensordata = self._batch.bind("sensordata")
        self._contacts = ContactMeter(layout, self._sensordata)
        self._wrenches = WrenchMeter(layout, self._batch, built.addresses, self._parameters)
        self._matter_forces = MatterMeter(layout, self._batch, built.addresses, built.matter)
        self._efforts = EffortMeter(self._batch, built.addresses, self._parameters)
        self._ctrl, self._xfrc_applied = self._batch.bind("ctrl"), self._batch.bind("xfrc_applied")
        # Contiguous scratch: MuJoCo's rows lie far apart, and NumPy pays for that in each operation.
        self._spring_part, self._damper_part = np.zeros(self._ctrl.shape), np.zeros(self._ctrl.shape)
        # NumPy's views of the tensors: on few numbers its operations cost a third of torch's.
        self._targets = tuple(tensor.numpy() for tensor in self._commands)
        self._cleared = [tensor.numpy() for tensor in (*self._commands[1:], *self._measurements) if tensor.numel()]
        self._home = self._targets[0][0].copy()
        # Environments with warnings or errors that MuJoCo's own reset alone clears.
        self._failed = np.zeros(num_envs, dtype=bool)
        self._batch.reset(keyframe=0, stage=_NO_STAGE)
        self._initial = self._batch.state[0].copy()
        self.reset()

    # Time ------------------------------------------------------------------------------------------------------------

    def step(self, steps: int) -> None:
        self._parameters.settle()
        self._write_commands()
        self._run(steps)

    def _run(self, steps: int) -> None:
        """Advance by physics steps, with the controls that are set."""
        try:
            self._advance(steps)
        except mujoco.batch.SimulationError as error:
            self._failed[error.ids] = True
            raise SimulationError(f"MuJoCo failed in environments {first_few(error.ids)}: {error}") from error
        self._efforts.mark_stepped()
        if self._wrenches.links:
            self._wrenches.read()
        self._state.invalidate()
        if self.layout.scene.deformables:
            self._matter.measure(self._matter_forces)
        if np.count_nonzero(self._batch.warning):
            self._raise_warnings()
        if not self._state.bounded and (self.raises_divergence or self._matter.diverged()[1]):
            environments, names = self._matter.diverged()
            raise matter_divergence_error(environments, names) if names else divergence_error(self._state.diverged())

    def _advance(self, steps: int) -> None:
        if self._wrenches.needs_rates:
            self._state.derive()  # for what `begin` keeps
        if not (self._contacts.queries or self._matter.damped):
            if self._wrenches.needs_rates:
                if steps > 1:
                    self._batch.step(nstep=steps - 1, stage=DERIVED_STAGE)
                self._wrenches.begin()
                steps = 1
            self._batch.step(nstep=steps, stage=DERIVED_STAGE)
            return
        damped, queries = self._matter.damped, self._contacts.queries
        for number in range(steps):
            if self._wrenches.needs_rates and number == steps - 1:
                self._wrenches.begin()
            if damped:
                self._matter.damp()
            self._batch.step(nstep=1, stage=DERIVED_STAGE)
            if damped:
                self._state.invalidate()  # the next drag is that of the new state
            if queries:
                self._contacts.take(first=number == 0)
        if queries:
            self._contacts.average(steps)

    @property
    def _commands(self) -> tuple[Tensor, ...]:
        return self.position_targets, self.velocity_targets, self.efforts

    @property
    def _measurements(self) -> tuple[Tensor, ...]:
        """Measurements of the last step, which MuJoCo's own rows do not hold."""
        self._efforts.settle()
        return self._efforts.efforts, self._contacts.forces, self._wrenches.wrenches, self._matter_forces.forces

    def _write_commands(self) -> None:
        positions, velocities, efforts = self._targets
        np.multiply(positions, self._parameters.stiffness, out=self._spring_part)
        np.multiply(velocities, self._parameters.damping, out=self._damper_part)
        np.add(self._spring_part, self._damper_part, out=self._spring_part)
        np.add(self._spring_part, efforts, out=self._ctrl)

    def _raise_warnings(self) -> None:
        counts = self._batch.warning[..., 1].copy()
        if self._matter.bends:
            counts[:, _NEAR_SINGULAR] = 0
        self._failed |= counts.any(axis=1)
        if not self.raises_divergence:
            counts[:, _DIVERGENCE] = 0
        if not counts.any():
            return
        warning = int(np.flatnonzero(counts.any(axis=0))[0])
        environments = np.flatnonzero(counts[:, warning])
        place = int(self._batch.warning[environments[0], warning, 0])
        text = mujoco.mju_warningText(warning, place).strip().rstrip(".")
        raise SimulationError(
            f"environments {first_few(environments)} diverged{self._named(warning, place)}: {text}; "
            "reset them, and use a smaller physics_dt, softer drives or larger masses"
        )

    def _named(self, warning: int, place: int) -> str:
        """Name the owner of coordinate ``place`` of a warning, for a message; empty where it has no owner."""
        model = self._model
        if warning == mujoco.mjtWarning.mjWARN_BADQPOS.value:
            body = model.jnt_bodyid[np.searchsorted(model.jnt_qposadr, place, side="right") - 1]
        elif warning in (mujoco.mjtWarning.mjWARN_BADQVEL.value, mujoco.mjtWarning.mjWARN_BADQACC.value):
            body = model.dof_bodyid[place]
        else:
            return ""
        link = self._addresses.link_of_body[body]
        if link >= 0:
            return f" in '{self.layout.links_by_name[link][0]}'"
        number = model.body(model.body_rootid[body]).name.removeprefix(MATTER_BODY)
        return f" in '{self.layout.scene.deformables[int(number)].name}'"

    # State -----------------------------------------------------------------------------------------------------------

    @property
    def joint_efforts(self) -> Tensor:
        self._efforts.settle()
        return self._efforts.efforts

    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        self._efforts.settle()
        self._state.write_joints(joints.numpy(), _array(positions), _array(velocities), self._rows(env_ids))

    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        self._state.write_root(entity, _array(pose), _array(velocity), self._rows(env_ids))

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = self._rows(env_ids)
        self._efforts.settle()
        held = self._matter.held(rows)
        if self._failed[rows].any():
            self._clear_failures(rows)
        self._batch.state[rows] = self._initial
        self._targets[0][rows] = self._home
        for cleared in self._cleared:
            cleared[rows] = 0.0
        self._state.mark_written(rows)
        self._matter.hold_again(held, rows)

    def _clear_failures(self, rows: HostRows) -> None:
        # Not for every reset: it clears all that MuJoCo derives as well, which costs a hundred times the state alone.
        chosen = np.zeros(self.num_envs, dtype=bool)
        chosen[rows] = True
        self._batch.reset(chosen, stage=_NO_STAGE)
        self._failed[rows] = False

    # Measurements ----------------------------------------------------------------------------------------------------

    @property
    def contact_forces(self) -> Tensor:
        return self._contacts.forces

    @property
    def joint_wrenches(self) -> Tensor:
        return self._wrenches.wrenches

    def cast_rays(
        self, origins: Tensor, directions: Tensor, max_distance: float, env_ids: Tensor | None = None
    ) -> RayHits:
        ids = np.arange(self.num_envs) if env_ids is None else env_ids.numpy()
        order = np.argsort(ids)  # the batch takes its environments in ascending order
        distances, geoms, normals = self._batch.ray(
            origins.numpy()[order], directions.numpy()[order], ids=ids[order], normal=True
        )
        missed = (geoms < 0) | (distances > max_distance)
        distances[missed], geoms[missed], normals[missed] = np.inf, -1, 0.0
        back = np.argsort(order)
        return RayHits(
            torch.from_numpy(distances[back].astype(np.float32)),
            torch.from_numpy(normals[back].astype(np.float32)),
            torch.from_numpy(self._addresses.link_of_geom[geoms[back]]),
        )

    # Parameters per environment --------------------------------------------------------------------------------------

    def set_drive_gains(
        self, joints: Tensor, stiffness: Tensor, damping: Tensor, env_ids: Tensor | None = None
    ) -> None:
        self._efforts.settle()
        self._parameters.set_drive_gains(joints.numpy(), stiffness.numpy(), damping.numpy(), self._rows(env_ids))

    def set_joint_parameters(
        self,
        joints: Tensor,
        damping: Tensor | None,
        friction: Tensor | None,
        armature: Tensor | None,
        stiffness: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        own = _array(damping), _array(friction), _array(armature), _array(stiffness)
        self._parameters.set_joints(joints.numpy(), *own, self._rows(env_ids))

    def set_joint_limits(self, joints: Tensor, lower: Tensor, upper: Tensor, env_ids: Tensor | None = None) -> None:
        limits = torch.stack((lower, upper), dim=-1).numpy()
        self._parameters.set_joint_limits(joints.numpy(), limits, self._rows(env_ids))

    def set_wrenches(self, links: Tensor, wrenches: Tensor, env_ids: Tensor | None = None) -> None:
        self._xfrc_applied[block(self._rows(env_ids), self._addresses.bodies[links.numpy()])] = wrenches.numpy()

    # Deformables -----------------------------------------------------------------------------------------------------

    def particle_positions(self, deformable: int) -> Tensor:
        return self._matter.positions(deformable)

    def particle_velocities(self, deformable: int) -> Tensor:
        return self._matter.velocities(deformable)

    def write_particles(
        self, deformable: int, positions: Tensor, velocities: Tensor, env_ids: Tensor | None = None
    ) -> None:
        places, speeds = positions.numpy().astype(np.float64), velocities.numpy().astype(np.float64)
        self._matter.write(deformable, places, speeds, self._rows(env_ids))

    def anchor_particles(
        self, deformable: int, particles: Tensor, link: int | None, env_ids: Tensor | None = None
    ) -> None:
        self._matter.anchor(deformable, particles.numpy(), link, self._rows(env_ids))

    def release_particles(self, deformable: int, particles: Tensor, env_ids: Tensor | None = None) -> None:
        self._matter.release(deformable, particles.numpy(), self._rows(env_ids))

    def set_particle_parameter(self, deformable: int, name: str, values: Tensor, env_ids: Tensor | None = None) -> None:
        self._matter.set_parameter(deformable, name, values.numpy(), self._rows(env_ids))

    def particle_forces(self, deformable: int) -> Tensor:
        return self._matter_forces.forces[:, deformable]

    # Snapshots and the rest ------------------------------------------------------------------------------------------

    def save_state(self) -> Snapshot:
        return Snapshot(
            self._batch.state.copy(),
            self._parameters.save(),
            tuple(tensor.clone() for tensor in (*self._commands, *self._measurements)),
        )

    def load_state(self, state: Snapshot) -> None:
        self._efforts.settle()
        self._clear_failures(slice(None))
        self._batch.state[...] = state.rows
        self._parameters.load(state.parameters)
        for own, saved in zip((*self._commands, *self._measurements), state.tensors, strict=True):
            own.copy_(saved)
        self._state.mark_written(slice(None))

    def copy_state(self, origin: Engine, source: int, env_ids: Tensor | None = None) -> None:
        super().copy_state(origin, source, env_ids)
        alike = isinstance(origin, MujocoEngine) and len(self._kinds) == len(origin._kinds) == 1
        if not alike or origin._batch.state.shape[1:] != self._batch.state.shape[1:]:
            return  # what the solver starts from is laid out otherwise there
        rows = self._rows(env_ids)
        self._batch.state[rows] = origin._batch.state[source].copy()
        for own, other in zip(self._measurements, origin._measurements, strict=True):
            own[rows] = other[source].clone()
        self._state.mark_written(rows)

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        return self._report

    def built_model(self) -> tuple[BuiltModel, ...]:
        return tuple(read_back(kind.model, kind.addresses) for kind in self._kinds)

    @property
    def native(self) -> tuple[mujoco.MjModel, mujoco.batch.Batch]:
        """The model and the batch."""
        return self._model, self._batch

    def _rows(self, env_ids: Tensor | None) -> HostRows:
        return host_rows(env_ids)

    def _own(self, tensor: Tensor) -> npt.NDArray:
        return tensor.numpy()

    def close(self) -> None:
        vars(self).clear()  # the batch, its threads and memory go with the last array that views them


def _ignore(message: str) -> None:
    """MuJoCo's warnings are read from its counters."""


def _array(values: Tensor | None) -> npt.NDArray[np.float32] | None:
    return None if values is None else values.numpy()
