"""Cloth, ropes, soft bodies and fluids of a simulated world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import torch
from torch import Tensor

from orbit_core.dynamics.arguments import FRICTIONS, POSITIONS, VELOCITIES, Bounds, columns_chosen
from orbit_core.dynamics.indexing import Masking
from orbit_core.dynamics.transforms import quat_rotate_inverse
from orbit_core.interfaces import ArgumentError, ConfigurationError, Deformable, Engine, Object, find_name
from orbit_core.interfaces.matter import PARAMETERS
from orbit_core.preparation.scene_data import check_data
from orbit_core.scene import Cloth, DeformableSpec, Region, SoftBody
from orbit_core.world.clock import Clock
from orbit_core.world.covered_area import CoveredArea

_SCALES = Bounds(1e-6, 1e6)


class SimulatedDeformable(Deformable):
    """The particles of one deformable of an engine."""

    def __init__(
        self,
        index: int,
        spec: DeformableSpec,
        engine: Engine,
        masking: Masking,
        clock: Clock,
        entities: Mapping[str, Object],
    ) -> None:
        self.name, self.spec = spec.name, spec
        self._entities = entities
        self._index = index
        self._engine = engine
        self._masking = masking
        self._clock = clock
        self._shape = (len(spec.rest_positions), 3)
        self._boxes: dict[Region, tuple[Object | None, Tensor, Tensor, Tensor]] = {}
        most = max((len(point.particles) for point in spec.key_points), default=1)
        numbers, weights = (torch.zeros(len(spec.key_points), most) for _ in range(2))
        for row, point in enumerate(spec.key_points):
            count = len(point.particles)
            numbers[row, :count] = torch.tensor(point.particles)
            weights[row, :count] = torch.tensor(point.weights or (1.0 / count,) * count)
        self._of_key_points, self._weights = numbers.long().to(engine.device), weights[..., None].to(engine.device)
        """(K, m) particles of each key point, and (K, m, 1) their weights."""

    @property
    def positions(self) -> Tensor:
        return self._engine.particle_positions(self._index)

    @property
    def velocities(self) -> Tensor:
        return self._engine.particle_velocities(self._index)

    def set_state(self, positions: Tensor, velocities: Tensor | None = None, env_ids: Tensor | None = None) -> None:
        chosen, name = self._masking.choose(env_ids), self.spec.name
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
        self._engine.anchor_particles(self._index, self._particles(points), link, self._masking.rows(env_ids))

    def release(self, points: Sequence[int] | None = None, env_ids: Tensor | None = None) -> None:
        chosen = range(self._shape[0]) if points is None else points
        self._engine.release_particles(self._index, self._particles(chosen), self._masking.rows(env_ids))

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
        """What a region stands on, its middle and orientation, and its half extents, looked at and copied once."""
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
        chosen = self._masking.choose(env_ids)
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
