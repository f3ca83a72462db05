"""N environments of one scene on Bullet."""

from __future__ import annotations

import os
import weakref
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_bullet.config import BulletConfig
from orbit_bullet.deformables import check_stability, deformable_report
from orbit_bullet.library import bullet
from orbit_bullet.materials import PairProducts, material_report, nominal, rolling_friction
from orbit_bullet.pool import Pool, make_pool
from orbit_bullet.shard import Written
from orbit_bullet.stage import write_scene
from orbit_core.interfaces import (
    Approximation,
    BuiltModel,
    ConfigurationError,
    Engine,
    EntityLayout,
    RayHits,
    SceneLayout,
    SimulationError,
    diverged,
    divergence_error,
    first_few,
)
from orbit_core.plugin_kit.bodies import inertia_approximations, stand_in_approximations
from orbit_core.plugin_kit.scratch import ScratchFolder


def build_report(layout: SceneLayout, config: BulletConfig) -> tuple[Approximation, ...]:
    """The build report, with one line per difference."""
    found = material_report(layout)
    products = PairProducts(layout)
    friction = nominal(layout, "dynamic_friction")
    factors = products.factors(friction)
    found += products.report("friction", friction)
    found += products.report_lengths("torsional friction", nominal(layout, "torsional_friction"), factors)
    found += products.report_lengths("rolling friction", rolling_friction(layout), factors)
    found += products.report("restitution", nominal(layout, "restitution"))
    for entity in layout.entities:
        found += _joint_report(layout, entity)
        found += stand_in_approximations(entity, "Bullet")
        found += inertia_approximations(entity, "Bullet")
    return tuple(found + deformable_report(layout))


def _joint_report(layout: SceneLayout, entity: EntityLayout) -> list[Approximation]:
    parameters, joints = layout.joint_parameters, layout.joints
    numbers = range(entity.joints.start, entity.joints.stop)
    found: list[Approximation] = []
    fast = [joints[number].name for number in numbers if np.isfinite(parameters.velocity_limit[number])]
    if fast:
        asked = f"velocity limits of joints {', '.join(fast)}"
        why = "Bullet does not limit the velocity of single joints"
        found.append(Approximation(f"'{entity.name}'", asked, "no limits", why))
    driven = parameters.drive_stiffness + parameters.drive_damping > 0
    for number in numbers:
        if driven[number] and joints[number].mimic:
            subject = f"joint '{joints[number].name}' of '{entity.name}'"
            why = "it mimics another joint, whose drive moves both"
            found.append(Approximation(subject, "a drive of its own", "no drive", why))
    return found


_COMMANDS = ("position_targets", "velocity_targets", "efforts")


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The worlds' own snapshots, which live where the worlds do, and the commands."""

    worlds: tuple[Any, ...]
    """Snapshots of the shards, as each returns them."""
    commands: tuple[npt.NDArray[np.float32], ...]
    """Targets and efforts."""


class BulletEngine(Engine):
    """Keeps the state of every environment in arrays that the simulations fill after each step and write."""

    def __init__(self, layout: SceneLayout, num_envs: int, device: torch.device, config: BulletConfig) -> None:
        super().__init__(layout, num_envs, device)
        bullet()
        check_stability(layout)
        self._report = build_report(layout, config)
        self._home = self.position_targets[:1].clone()
        scratch = ScratchFolder("orbit-bullet-")
        try:
            files = write_scene(layout, scratch.path)
            self._pool: Pool = make_pool(layout, files, num_envs, config)
        except BaseException:
            scratch.remove()
            raise
        self._finalizer = weakref.finalize(self, _release, self._pool, scratch, os.getpid())
        self._tensors = {name: torch.from_numpy(array) for name, array in vars(self._pool.buffers).items()}
        for name in _COMMANDS:
            self._tensors[name].copy_(getattr(self, name))
            setattr(self, name, self._tensors[name])

    # Time ------------------------------------------------------------------------------------------------------------

    def step(self, steps: int) -> None:
        self._refuse_broken_commands()
        found = self._pool.call("step", steps)
        apart = [start + i for (start, _), own in zip(self._pool.ranges, found, strict=True) for i in own]
        if apart:
            raise SimulationError(
                f"environments {first_few(apart)} diverged, their deformables flew apart: reset them, and use a "
                "smaller physics_dt"
            )
        state = self._tensors
        lost = diverged(state["link_poses"], state["link_velocities"])
        lost |= diverged(state["joint_positions"], state["joint_velocities"])
        if self.raises_divergence and lost.any():
            raise divergence_error(lost.nonzero()[:, 0].tolist())

    def _refuse_broken_commands(self) -> None:
        """A NaN would spread through Bullet to environments that share its world."""
        total = sum(float(self._tensors[name].sum()) for name in _COMMANDS)
        if np.isfinite(total):
            return
        broken = torch.zeros(self.num_envs, dtype=torch.bool)
        for name in _COMMANDS:
            broken |= ~self._tensors[name].isfinite().all(dim=-1)
        if broken.any():
            numbers = broken.nonzero()[:, 0].tolist()
            raise SimulationError(f"commands of environments {first_few(numbers)} are not finite: reset them")

    # State -----------------------------------------------------------------------------------------------------------

    @property
    def joint_positions(self) -> Tensor:
        return self._read("joint_positions")

    @property
    def joint_velocities(self) -> Tensor:
        return self._read("joint_velocities")

    @property
    def joint_efforts(self) -> Tensor:
        return self._read("joint_efforts")

    @property
    def link_poses(self) -> Tensor:
        return self._read("link_poses")

    @property
    def link_velocities(self) -> Tensor:
        return self._read("link_velocities")

    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        self._write("write_joints", env_ids, (joints.numpy(),), positions, velocities)

    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        self._write("write_root", env_ids, (entity,), pose, velocity)

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        self.position_targets[rows] = self._home
        self.velocity_targets[rows] = 0.0
        self.efforts[rows] = 0.0
        self._write("reset", env_ids, ())

    # Measurements ----------------------------------------------------------------------------------------------------

    @property
    def contact_forces(self) -> Tensor:
        return self._read("contact_forces")

    @property
    def joint_wrenches(self) -> Tensor:
        return self._read("joint_wrenches")

    def cast_rays(
        self, origins: Tensor, directions: Tensor, max_distance: float, env_ids: Tensor | None = None
    ) -> RayHits:
        return self.cast_rays_past(origins, directions, max_distance, range(0), env_ids)

    def cast_rays_past(
        self, origins: Tensor, directions: Tensor, max_distance: float, links: range, env_ids: Tensor | None = None
    ) -> RayHits:
        ids = self._rows(env_ids)
        order = np.argsort(ids)
        fixed = (max_distance, links)
        call = Written("cast_rays", ids[order], fixed, (origins.numpy()[order], directions.numpy()[order]))
        parts = {number: (part,) for number, part in call.parts(self._pool.ranges)}
        found = self._pool.call_each("cast_rays", parts)
        back = np.argsort(order)
        return RayHits(*(torch.from_numpy(np.concatenate(p)[back]) for p in zip(*found, strict=True)))

    # Parameters per environment --------------------------------------------------------------------------------------

    def set_wrenches(self, links: Tensor, wrenches: Tensor, env_ids: Tensor | None = None) -> None:
        self._write("set_wrenches", env_ids, (links.numpy(),), wrenches)

    def set_masses(self, links: Tensor, masses: Tensor, env_ids: Tensor | None = None) -> None:
        self._write("set_masses", env_ids, (links.numpy(),), masses)

    def set_friction(self, links: Tensor, coefficients: Tensor, env_ids: Tensor | None = None) -> None:
        self._write("set_friction", env_ids, (links.numpy(),), coefficients)

    def set_drive_gains(
        self, joints: Tensor, stiffness: Tensor, damping: Tensor, env_ids: Tensor | None = None
    ) -> None:
        self._write("set_gains", env_ids, (joints.numpy(),), stiffness, damping)

    def set_gravity(self, gravity: Tensor, env_ids: Tensor | None = None) -> None:
        self._write("set_gravity", env_ids, (), gravity)

    # Deformables -----------------------------------------------------------------------------------------------------

    def particle_positions(self, deformable: int) -> Tensor:
        return self._read("particle_positions")[:, self._particles(deformable)]

    def particle_velocities(self, deformable: int) -> Tensor:
        return self._read("particle_velocities")[:, self._particles(deformable)]

    def write_particles(
        self, deformable: int, positions: Tensor, velocities: Tensor, env_ids: Tensor | None = None
    ) -> None:
        self._particles(deformable)
        self._write("write_particles", env_ids, (deformable,), positions, velocities)

    def anchor_particles(
        self, deformable: int, particles: Tensor, link: int | None = None, env_ids: Tensor | None = None
    ) -> None:
        self._particles(deformable)
        self._write("anchor_particles", env_ids, (deformable, particles.numpy(), link))

    def release_particles(self, deformable: int, particles: Tensor, env_ids: Tensor | None = None) -> None:
        self._particles(deformable)
        self._write("release_particles", env_ids, (deformable, particles.numpy()))

    def _particles(self, deformable: int) -> slice:
        """Columns of a deformable's particles."""
        counts = [len(spec.rest_positions) for spec in self.layout.scene.deformables]
        if not 0 <= deformable < len(counts):
            raise ConfigurationError(f"there is no deformable {deformable}: the scene has {len(counts)}")
        start = sum(counts[:deformable])
        return slice(start, start + counts[deformable])

    # Snapshots and the rest ------------------------------------------------------------------------------------------

    def save_state(self) -> Snapshot:
        worlds = tuple(self._pool.call("save"))
        snapshot = Snapshot(worlds, tuple(self._tensors[name].numpy().copy() for name in _COMMANDS))
        weakref.finalize(snapshot, _forget, weakref.ref(self), worlds).atexit = False
        return snapshot

    def load_state(self, state: Snapshot) -> None:
        self._pool.call_each("load", {number: (world,) for number, world in enumerate(state.worlds)})
        for name, values in zip(_COMMANDS, state.commands, strict=True):
            np.copyto(self._tensors[name].numpy(), values)

    def built_model(self) -> tuple[BuiltModel, ...]:
        return tuple(self._pool.call("built_model", numbers=[0]))

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        return self._report

    @property
    def native(self) -> Pool:
        """The shards: in this process, or in workers."""
        return self._pool

    def close(self) -> None:
        self._finalizer()

    def _read(self, name: str) -> Tensor:
        self._pool.settle()
        return self._tensors[name]

    def _write(self, method: str, env_ids: Tensor | None, fixed: tuple[Any, ...], *rowwise: Tensor | None) -> None:
        """Have a method done in the environments named; their workers need not be awaited."""
        call = Written(method, self._rows(env_ids), fixed, tuple(None if t is None else t.numpy() for t in rowwise))
        for number, part in call.parts(self._pool.ranges):
            self._pool.post(number, "write", part)

    def _rows(self, env_ids: Tensor | None) -> npt.NDArray[np.int64]:
        return np.arange(self.num_envs) if env_ids is None else env_ids.numpy()


def _release(pool: Pool, scratch: ScratchFolder, owner: int) -> None:
    if os.getpid() == owner:  # a process that was forked from it ends too, and these are not its own
        pool.close()
        scratch.remove()


def _forget(engine: weakref.ref[BulletEngine], worlds: tuple[Any, ...]) -> None:
    """Free the worlds' part of a snapshot that nobody holds any more."""
    alive = engine()
    if alive is not None and alive._finalizer.alive:
        for number, world in enumerate(worlds):
            alive.native.post(number, "forget", world)
