"""Deformables of a world: their state, and the coupling of an engine with the solver that simulates them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbit_core.backends import matter_config
from orbit_core.dynamics.arguments import FRICTIONS, POSITIONS, VELOCITIES, Bounds, columns_chosen
from orbit_core.dynamics.indexing import write_columns, write_rows
from orbit_core.dynamics.transforms import quat_rotate, quat_rotate_inverse
from orbit_core.interfaces import (
    Approximation,
    ArgumentError,
    BuiltModel,
    Capability,
    CaptureFacet,
    ConfigurationError,
    Deformable,
    Engine,
    Level,
    Object,
    RayHits,
    SceneLayout,
    SimulationError,
    UnsupportedCapabilityError,
    find_name,
)
from orbit_core.interfaces.errors import matter_divergence_error
from orbit_core.interfaces.matter import PARAMETERS, Matter, MatterSolver
from orbit_core.preparation.scene_data import check_data
from orbit_core.scene import Cloth, DeformableSpec, Fluid, Region, SoftBody
from orbit_core.world.state import WorldParts

# A physics engine and a matter solver as one engine -------------------------------------------------------------------
# At each physics step the engine moves first, under the wrenches of the matter's step before; the matter then follows,
# against links that go evenly from their old poses to the new. The forces that a link feels are thus those of one
# physics step ago, and their impulses those that the matter received. Of free bodies it is given the velocities and the
# wrenches that users set as well, with which it may move these itself; the engine then gets the wrench that makes its
# own follow.


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
    """Snapshot of the engine."""
    matter: Any
    """Snapshot of the matter solver."""
    own: tuple[Tensor, ...]
    """Copies of the tensors that couple both."""


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
        # (k,) of the links that wrenches can move
        self._links = torch.tensor(moved, dtype=torch.int64, device=self.device)
        centers = [link.center_of_mass for link in self.layout.links]
        self._centers = torch.tensor(centers, dtype=torch.float32, device=self.device).view(1, -1, 3)
        # (N, L, 3) m in the links' frames
        self._centers = self._centers.repeat(self.num_envs, 1, 1)
        self._has_free = any(e.spec.is_free_body for e in self.layout.entities)
        # What callers of set_wrenches want
        self._asked = torch.zeros(self.num_envs, len(self.layout.links), 6, device=self.device)
        queries = self.layout.contact_queries
        self._forces = torch.zeros(self.num_envs, len(queries), 3, device=self.device)
        chosen = [number for number, query in enumerate(queries) if query.others is None]
        self._total_queries = torch.tensor(chosen, dtype=torch.int64, device=self.device)
        of = [queries[number].link for number in chosen]
        self._total_links = torch.tensor(of, dtype=torch.int64, device=self.device)
        self._matter.reset(engine.link_poses)

    @property
    def raises_divergence(self) -> bool:
        """Pass the setting to the engine; matter that diverges always raises."""
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

    def particle_pressures(self, deformable: int) -> Tensor:
        return self._matter.contact_pressures(deformable)

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


# Deformables of a simulated world, and the areas that they cover ------------------------------------------------------

# Cells of the grid along a triangle's longest edge
_CELLS_PER_EDGE = 6
# By how much an edge may be longer than at rest and still be seen whole
_STRETCH = 1.25


class CoveredArea:
    """Counter of the cells of a grid around the cloth's middle whose centres some triangle covers.

    Without a loop over environments or triangles: each triangle looks at the cells of a window that it fits into.
    """

    def __init__(self, cloth: Cloth, device: torch.device) -> None:
        vertices, faces = cloth.rest_positions, np.ascontiguousarray(cloth.mesh.faces)
        corners = vertices[faces]
        longest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max())
        # Metres
        self._cell = longest / _CELLS_PER_EDGE
        span = float(np.linalg.norm(vertices.max(0) - vertices.min(0))) * _STRETCH
        # Cells along each side; the grid covers the cloth at any place of its middle
        self._count = math.ceil(2.0 * span / self._cell)
        window = math.ceil(_CELLS_PER_EDGE * _STRETCH) + 1
        steps = torch.arange(window, device=device)
        # (W, 2) cells from a triangle's lowest corner on
        self._window = torch.cartesian_prod(steps, steps)
        self._faces = torch.as_tensor(faces, dtype=torch.int64, device=device)

    def __call__(self, positions: Tensor) -> Tensor:
        """(N,) m^2 of particles (N, P, 3)."""
        flat = positions[..., :2]
        origin = flat.mean(1, keepdim=True) - 0.5 * self._count * self._cell
        corners = ((flat - origin) / self._cell)[:, self._faces]  # (N, T, 3, 2) in cells
        cells = corners.amin(2).floor().long()[:, :, None] + self._window  # (N, T, W, 2)
        inside = _covered(corners[:, :, None], cells + 0.5)
        on_grid = ((cells >= 0) & (cells < self._count)).all(-1)
        flat_cells = (cells[..., 0] * self._count + cells[..., 1]).clamp(0, self._count**2 - 1)
        seen = torch.zeros(len(positions), self._count**2, device=positions.device)
        seen.scatter_reduce_(1, flat_cells.flatten(1), (inside & on_grid).float().flatten(1), "amax")
        return seen.sum(1) * self._cell**2


def _covered(corners: Tensor, points: Tensor) -> Tensor:
    """Return True for points (N, T, W, 2) inside triangles (N, T, 1, 3, 2) of either winding."""
    edges = torch.roll(corners, -1, dims=3) - corners
    arms = points[..., None, :] - corners
    sides = edges[..., 0] * arms[..., 1] - edges[..., 1] * arms[..., 0]
    return (sides >= 0.0).all(-1) | (sides <= 0.0).all(-1)


_SCALES = Bounds(1e-6, 1e6)


class SimulatedDeformable(Deformable):
    """The particles of one deformable of an engine."""

    def __init__(
        self,
        index: int,
        spec: DeformableSpec,
        parts: WorldParts,
        entities: Mapping[str, Object],
    ) -> None:
        self.name, self.spec = spec.name, spec
        """Name and description in the scene."""
        self._entities = entities
        self._index = index
        engine = self._engine = parts.engine
        self._clock, self._selector = parts.clock, parts.selector
        self._shape = (len(spec.rest_positions), 3)
        self._boxes: dict[Region, tuple[Object | None, Tensor, Tensor, Tensor]] = {}
        most = max((len(point.particles) for point in spec.key_points), default=1)
        numbers, weights = (torch.zeros(len(spec.key_points), most) for _ in range(2))
        for row, point in enumerate(spec.key_points):
            count = len(point.particles)
            numbers[row, :count] = torch.tensor(point.particles)
            weights[row, :count] = torch.tensor(point.weights or (1.0 / count,) * count)
        # (K, m) particles of each key point, and (K, m, 1) their weights
        self._of_key_points, self._weights = numbers.long().to(engine.device), weights[..., None].to(engine.device)

    @property
    def positions(self) -> Tensor:
        return self._engine.particle_positions(self._index)

    @property
    def velocities(self) -> Tensor:
        return self._engine.particle_velocities(self._index)

    def set_state(self, positions: Tensor, velocities: Tensor | None = None, env_ids: Tensor | None = None) -> None:
        chosen, name = self._selector.select(env_ids), self.spec.name
        positions = chosen.values(positions, self._shape, f"particle positions of '{name}'", POSITIONS)
        if velocities is None:
            velocities = torch.zeros_like(positions)
        else:
            velocities = chosen.values(velocities, self._shape, f"particle velocities of '{name}'", VELOCITIES)
        self._engine.write_particles(self._index, positions, velocities, chosen.rows)
        self._clock.touch()

    def anchor(self, points: Sequence[int], to: tuple[str, str] | None = None, env_ids: Tensor | None = None) -> None:
        if to is not None and (isinstance(to, str) or len(to) != 2):
            raise ArgumentError(f"points of '{self.name}' are held to (entity, link), not to {to!r}")
        link = None if to is None else self._link(*to)
        self._engine.anchor_particles(self._index, self._particles(points), link, self._selector.resolve(env_ids))

    def release(self, points: Sequence[int] | None = None, env_ids: Tensor | None = None) -> None:
        chosen = range(self._shape[0]) if points is None else points
        self._engine.release_particles(self._index, self._particles(chosen), self._selector.resolve(env_ids))

    @property
    def key_points(self) -> Tensor:
        return (self.positions[:, self._of_key_points] * self._weights).sum(2)

    def key_point(self, name: str) -> Tensor:
        names = [point.name for point in self.spec.key_points]
        row = find_name(name, names, "key point", f"'{self.name}'")
        return (self.positions[:, self._of_key_points[row]] * self._weights[row]).sum(1)

    @property
    def covered_area(self) -> Tensor:
        return self._covered_area(self.positions)

    @cached_property
    def _covered_area(self) -> CoveredArea:
        if not isinstance(self.spec, Cloth):
            raise ConfigurationError(f"'{self.name}' is a {type(self.spec).__name__}: only a Cloth covers an area")
        return CoveredArea(self.spec, self._engine.device)

    def share_inside(self, region: Region) -> Tensor:
        try:
            box = self._boxes.get(region)
        except TypeError:
            raise ArgumentError(f"the region is {region}: give a Region of tuples") from None
        if box is None:
            if not isinstance(region, Region):
                raise ArgumentError(f"the region is {region!r}: give a Region")
            box = self._boxes[region] = self._box(region)
        thing, middle, turn, half = box
        points = self.positions
        if thing is not None and region.frame is not None:
            pose = thing.frame_pose(region.frame)[:, None]
            points = quat_rotate_inverse(pose[..., 3:], points - pose[..., :3])
        return (quat_rotate_inverse(turn, points - middle).abs() <= half).all(-1).float().mean(1)

    def _box(self, region: Region) -> tuple[Object | None, Tensor, Tensor, Tensor]:
        """Return a region's object, middle, orientation and half extents, copied once."""
        check_data(region, "region")
        if (region.entity is None) != (region.frame is None):
            raise ArgumentError(f"{region} is of an entity or a frame alone: give both, or neither")
        thing = None
        if region.entity is not None:
            row = find_name(region.entity, list(self._entities), "robot or object", "the scene")
            thing = list(self._entities.values())[row]
        numbers = (region.pose.position, region.pose.orientation, region.half_extents)
        middle, turn, half = (torch.tensor(v, dtype=torch.float32, device=self._engine.device) for v in numbers)
        return thing, middle, turn, half

    def contact_force(self, entity: str, link: str) -> Tensor:
        return self._engine.particle_forces(self._index)[:, self._link(entity, link)]

    def contact_pressure(self, entity: str, link: str) -> Tensor:
        if not isinstance(self.spec, SoftBody):
            kind = type(self.spec).__name__
            raise ConfigurationError(f"'{self.name}' is a {kind}: only the pressure of a SoftBody is measured")
        return self._engine.particle_pressures(self._index)[:, self._link(entity, link)]

    def set_parameter(self, name: str, values: Tensor, env_ids: Tensor | None = None) -> None:
        find_name(name, PARAMETERS, "parameter", f"'{self.name}'")
        if name == "bending" and isinstance(self.spec, SoftBody):
            raise ArgumentError(f"soft body '{self.name}' bends as its stiffness says: set its 'stiffness'")
        if name != "density" and isinstance(self.spec, Fluid):
            raise ArgumentError(f"'{self.name}' is a liquid, which has no {name}: only its 'density' can be set")
        chosen = self._selector.select(env_ids)
        bounds = FRICTIONS if name == "friction" else _SCALES
        values = chosen.values(values, (), f"{name} of '{self.name}'", bounds)
        self._engine.set_particle_parameter(self._index, name, values, chosen.rows)
        self._clock.touch()

    def _particles(self, points: Sequence[int]) -> Tensor:
        chosen = columns_chosen(points, self._shape[0], f"points of '{self.spec.name}'")
        return torch.tensor(chosen, dtype=torch.int64, device=self._engine.device)

    def _link(self, entity: str, link: str) -> int:
        entities = self._engine.layout.entities
        found = entities[find_name(entity, [e.name for e in entities], "robot or object", "the scene")]
        names = found.spec.articulation.link_names
        return found.root_link + find_name(link, names, "link", f"'{entity}'")
