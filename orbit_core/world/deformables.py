"""Deformables of a simulated world, and the areas that they cover."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from orbit_core.dynamics.arguments import FRICTIONS, POSITIONS, VELOCITIES, Bounds, columns_chosen
from orbit_core.dynamics.transforms import quat_rotate_inverse
from orbit_core.interfaces import ArgumentError, ConfigurationError, Deformable, Object, find_name
from orbit_core.interfaces.matter import PARAMETERS
from orbit_core.preparation.scene_data import check_data
from orbit_core.scene import Cloth, DeformableSpec, Region, SoftBody
from orbit_core.world.state import WorldParts

# Cells of the grid along a triangle's longest edge
_CELLS_PER_EDGE = 6
# By how much an edge may be longer than at rest and still be seen whole
_STRETCH = 1.25


class CoveredArea:
    """Counter of the cells of a grid around the cloth's middle whose centres some triangle covers.

    Without a loop over environments or triangles: each triangle looks at the cells of a window that it fits into.
    """

    def __init__(self, cloth: Cloth, device: torch.device) -> None:
        vertices, faces = cloth.rest_positions, np.asarray(cloth.mesh.faces)
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

    def set_parameter(self, name: str, values: Tensor, env_ids: Tensor | None = None) -> None:
        find_name(name, PARAMETERS, "parameter", f"'{self.name}'")
        if name == "bending" and isinstance(self.spec, SoftBody):
            raise ArgumentError(f"soft body '{self.name}' bends as its stiffness says: set its 'stiffness'")
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
