"""A physics engine and a matter solver as one engine.

At each physics step the engine moves first, under the wrenches of the matter's step before; the matter then follows,
against links that go evenly from their old poses to the new. The forces that a link feels are thus those of one physics
step ago, and their impulses those that the matter received. Of free bodies it is given the velocities and the wrenches
that users set as well, with which it may move these itself; the engine then gets the wrench that makes its own follow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from orbit_core.backends import matter_config
from orbit_core.dynamics.indexing import write_columns, write_rows
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import (
    Approximation,
    BuiltModel,
    Capability,
    CaptureFacet,
    ConfigurationError,
    Engine,
    Level,
    RayHits,
    SceneLayout,
    SimulationError,
    UnsupportedCapabilityError,
)
from orbit_core.interfaces.errors import matter_divergence_error
from orbit_core.interfaces.matter import Matter, MatterSolver


def rigid_part(layout: SceneLayout, solver: MatterSolver | None) -> SceneLayout:
    """The layout that the physics engine sees: without deformables where a solver has them."""
    if solver is None or not layout.scene.deformables:
        return layout
    return SceneLayout.of(replace(layout.scene, deformables=()))


def coupled(
    engine: Engine, layout: SceneLayout, solver: MatterSolver | None, settings: Mapping[str, Any] | None
) -> Engine:
    """The engine itself, or with the solver's matter.

    Raises:
        ConfigurationError: a setting that the solver does not have, or a scene that it refuses; settings of a solver
            where the engine simulates, or where there is nothing to simulate.
        UnsupportedCapabilityError: the engine's device is a GPU, and the solver has none.
    """
    if not layout.scene.deformables:
        if settings:
            raise ConfigurationError(
                f"matter settings {', '.join(map(repr, settings))} are a matter solver's, and nothing in this scene "
                "bends or flows"
            )
        return engine
    if solver is None:
        if settings:
            raise ConfigurationError(
                f"matter settings {', '.join(map(repr, settings))} are a matter solver's: the engine's own deformables "
                "take none; give the backend's settings, or choose a solver"
            )
        return engine
    gpu = solver.capabilities()[Capability.GPU]
    if engine.device.type != "cpu" and gpu.level is Level.UNSUPPORTED:
        raise UnsupportedCapabilityError(
            f"matter solver '{solver.name}' does not compute on '{engine.device}' ({gpu.reason}): take device='cpu'"
        )
    matter = solver.create(layout, engine.num_envs, engine.device, matter_config(solver, settings))
    return CoupledEngine(layout, engine, matter)


_MASKED = {"write_particles", "anchor_particles", "release_particles", "set_particle_parameter"}


@dataclass(frozen=True)
class CoupledState:
    """A snapshot of both."""

    engine: Any
    matter: Any
    own: tuple[Tensor, ...]


class CoupledCapture(CaptureFacet):
    """The engine's, for it knows how to record; the matter's launches follow it."""

    def __init__(self, inner: CaptureFacet) -> None:
        self._inner = inner
        self.takes_masks = inner.takes_masks | _MASKED  # pyright: ignore[reportAttributeAccessIssue]
        self.record = inner.record
        self.expression = inner.expression
        self.settle = inner.settle


class CoupledEngine(Engine):
    """Passes on what is the engine's, and adds the matter's wrenches to those that are set."""

    def __init__(self, layout: SceneLayout, engine: Engine, matter: Matter) -> None:
        # Commands are the engine's own tensors, so Engine.__init__, which makes some, is left out.
        self.layout, self.num_envs, self.device = layout, engine.num_envs, engine.device
        self.position_targets, self.velocity_targets = engine.position_targets, engine.velocity_targets
        self.efforts = engine.efforts
        self.capture = CoupledCapture(engine.capture)
        self._inner, self._matter = engine, matter
        moved = [n for e in self.layout.entities for n in _moving(e.spec, e.links.start)]
        self._links = torch.tensor(moved, dtype=torch.int64, device=self.device)
        """(k,) of the links that wrenches can move."""
        centers = [link.center_of_mass for link in self.layout.links]
        self._centers = torch.tensor(centers, dtype=torch.float32, device=self.device).view(1, -1, 3)
        self._centers = self._centers.repeat(self.num_envs, 1, 1)
        """(N, L, 3) m in the links' frames."""
        self._has_free = any(e.spec.is_free_body for e in self.layout.entities)
        self._asked = torch.zeros(self.num_envs, len(self.layout.links), 6, device=self.device)
        """What callers of set_wrenches want."""
        queries = self.layout.contact_queries
        self._forces = torch.zeros(self.num_envs, len(queries), 3, device=self.device)
        chosen = [number for number, query in enumerate(queries) if query.others is None]
        self._total_queries = torch.tensor(chosen, dtype=torch.int64, device=self.device)
        of = [queries[number].link for number in chosen]
        self._total_links = torch.tensor(of, dtype=torch.int64, device=self.device)
        self._matter.reset(engine.link_poses)

    @property
    def raises_divergence(self) -> bool:
        """The engine's own; matter that diverges raises whatever it is."""
        return self._inner.raises_divergence

    @raises_divergence.setter
    def raises_divergence(self, value: bool) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        self._inner.raises_divergence = value

    # Time ------------------------------------------------------------------------------------------------------------

    def step(self, steps: int) -> None:
        forces, failure = torch.zeros_like(self._forces), None
        for _ in range(steps):
            before = self._inner.link_poses.clone()
            was = self._inner.link_velocities.clone() if self._has_free else None
            self._apply(before)
            try:
                self._inner.step(1)
            except SimulationError as error:  # of some environments: the others go on
                failure = error
            velocities = None if was is None else (was, self._inner.link_velocities)
            self._matter.step(before, self._inner.link_poses, velocities, self._asked)
            if len(self.layout.contact_queries):
                forces += self._inner.contact_forces
                forces[:, self._total_queries] += self._matter.contact_forces[:, :, self._total_links].sum(1)
        self._forces.copy_(forces / steps)
        if failure is not None:
            raise failure
        self._check()

    def _apply(self, poses: Tensor) -> None:
        """Hand the engine the sum of the wrenches that are set and the matter's, these about the centres of mass."""
        if not len(self._links):
            return
        own = self._matter.wrenches[:, self._links]
        arms = quat_rotate(poses[:, self._links, 3:], self._centers[:, self._links])
        torques = own[..., 3:] - torch.linalg.cross(arms, own[..., :3])
        self._inner.set_wrenches(self._links, self._asked[:, self._links] + torch.cat((own[..., :3], torques), -1))

    def _check(self) -> None:
        if self.device.type != "cpu":
            return  # to look would wait for the device; what is not finite shows in the next observation
        wrong = self._matter.diverged()
        if wrong.any():
            rows, which = wrong.nonzero(as_tuple=True)
            found = {self.layout.scene.deformables[index].name for index in which.tolist()}
            raise matter_divergence_error(sorted(set(rows.tolist())), found)

    # State -----------------------------------------------------------------------------------------------------------

    @property
    def joint_positions(self) -> Tensor:
        return self._inner.joint_positions

    @property
    def joint_velocities(self) -> Tensor:
        return self._inner.joint_velocities

    @property
    def joint_efforts(self) -> Tensor:
        return self._inner.joint_efforts

    @property
    def link_poses(self) -> Tensor:
        return self._inner.link_poses

    @property
    def link_velocities(self) -> Tensor:
        return self._inner.link_velocities

    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        self._inner.write_joint_state(joints, positions, velocities, env_ids)

    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        self._inner.write_root_state(entity, pose, velocity, env_ids)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._inner.reset(env_ids)
        self._matter.reset(self._inner.link_poses, env_ids)
        write_rows(self._asked, 0.0, env_ids)
        write_rows(self._forces, 0.0, env_ids)

    # Measurements ----------------------------------------------------------------------------------------------------

    @property
    def contact_forces(self) -> Tensor:
        return self._forces

    @property
    def joint_wrenches(self) -> Tensor:
        return self._inner.joint_wrenches

    def cast_rays(
        self, origins: Tensor, directions: Tensor, max_distance: float, env_ids: Tensor | None = None
    ) -> RayHits:
        return self._inner.cast_rays(origins, directions, max_distance, env_ids)

    def cast_rays_past(
        self, origins: Tensor, directions: Tensor, max_distance: float, links: range, env_ids: Tensor | None = None
    ) -> RayHits:
        return self._inner.cast_rays_past(origins, directions, max_distance, links, env_ids)

    # Parameters per environment --------------------------------------------------------------------------------------

    def set_wrenches(self, links: Tensor, wrenches: Tensor, env_ids: Tensor | None = None) -> None:
        write_columns(self._asked, links, wrenches, env_ids)
        self._inner.set_wrenches(links, wrenches, env_ids)

    def set_masses(self, links: Tensor, masses: Tensor, env_ids: Tensor | None = None) -> None:
        self._inner.set_masses(links, masses, env_ids)
        self._matter.set_masses(links, masses, env_ids)

    def set_centers_of_mass(self, links: Tensor, centers: Tensor, env_ids: Tensor | None = None) -> None:
        self._inner.set_centers_of_mass(links, centers, env_ids)
        self._matter.set_centers_of_mass(links, centers, env_ids)
        write_columns(self._centers, links, centers, env_ids)

    def set_friction(self, links: Tensor, coefficients: Tensor, env_ids: Tensor | None = None) -> None:
        self._inner.set_friction(links, coefficients, env_ids)
        self._matter.set_friction(links, coefficients, env_ids)

    def set_drive_gains(
        self, joints: Tensor, stiffness: Tensor, damping: Tensor, env_ids: Tensor | None = None
    ) -> None:
        self._inner.set_drive_gains(joints, stiffness, damping, env_ids)

    def set_joint_parameters(
        self,
        joints: Tensor,
        damping: Tensor | None,
        friction: Tensor | None,
        armature: Tensor | None,
        stiffness: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        self._inner.set_joint_parameters(joints, damping, friction, armature, stiffness, env_ids)

    def set_joint_limits(self, joints: Tensor, lower: Tensor, upper: Tensor, env_ids: Tensor | None = None) -> None:
        self._inner.set_joint_limits(joints, lower, upper, env_ids)

    def set_gravity(self, gravity: Tensor, env_ids: Tensor | None = None) -> None:
        self._inner.set_gravity(gravity, env_ids)
        self._matter.set_gravity(gravity, env_ids)

    # Deformables -----------------------------------------------------------------------------------------------------

    def particle_positions(self, deformable: int) -> Tensor:
        return self._matter.positions(deformable)

    def particle_velocities(self, deformable: int) -> Tensor:
        return self._matter.velocities(deformable)

    def write_particles(
        self, deformable: int, positions: Tensor, velocities: Tensor, env_ids: Tensor | None = None
    ) -> None:
        self._matter.write(deformable, positions, velocities, env_ids)

    def anchor_particles(
        self, deformable: int, particles: Tensor, link: int | None, env_ids: Tensor | None = None
    ) -> None:
        self._matter.anchor(deformable, particles, link, self._inner.link_poses, env_ids)

    def release_particles(self, deformable: int, particles: Tensor, env_ids: Tensor | None = None) -> None:
        self._matter.release(deformable, particles, env_ids)

    def set_particle_parameter(self, deformable: int, name: str, values: Tensor, env_ids: Tensor | None = None) -> None:
        self._matter.set_parameter(deformable, name, values, env_ids)

    def particle_forces(self, deformable: int) -> Tensor:
        return self._matter.contact_forces[:, deformable]

    # Snapshots and the rest ------------------------------------------------------------------------------------------

    def save_state(self) -> CoupledState:
        own = tuple(tensor.clone() for tensor in (self._asked, self._forces, self._centers))
        return CoupledState(self._inner.save_state(), self._matter.save_state(), own)

    def load_state(self, state: CoupledState) -> None:
        self._inner.load_state(state.engine)
        self._matter.load_state(state.matter)
        for own, saved in zip((self._asked, self._forces, self._centers), state.own, strict=True):
            own.copy_(saved)

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        return self._inner.build_report + self._matter.build_report

    def built_model(self) -> tuple[BuiltModel, ...]:
        return self._inner.built_model()

    @property
    def native(self) -> Any:
        return self._inner.native

    def close(self) -> None:
        self._inner.close()
        self._matter.close()


def _moving(spec: Any, first: int) -> list[int]:
    """Links of an entity that a wrench may move."""
    fixed = {0} if spec.fixed_base else set()
    return [first + n for n, link in enumerate(spec.articulation.links) if n not in fixed and link.mass > 0.0]
