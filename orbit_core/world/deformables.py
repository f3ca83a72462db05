"""Cloth and soft bodies of a simulated world."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from orbit_core.dynamics.arguments import POSITIONS, VELOCITIES, columns_chosen
from orbit_core.dynamics.indexing import Masking
from orbit_core.interfaces import Deformable, Engine, find_name
from orbit_core.scene import Cloth, SoftBody
from orbit_core.world.clock import Clock


class SimulatedDeformable(Deformable):
    """The particles of one deformable of an engine."""

    def __init__(self, index: int, spec: Cloth | SoftBody, engine: Engine, masking: Masking, clock: Clock) -> None:
        self.spec = spec
        self._index = index
        self._engine = engine
        self._masking = masking
        self._clock = clock
        self._shape = (len(spec.mesh.vertices), 3)

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
        link = None if to is None else self._link(*to)
        self._engine.anchor_particles(self._index, self._particles(points), link, self._masking.rows(env_ids))

    def release(self, points: Sequence[int] | None = None, env_ids: Tensor | None = None) -> None:
        chosen = range(self._shape[0]) if points is None else points
        self._engine.release_particles(self._index, self._particles(chosen), self._masking.rows(env_ids))

    def _particles(self, points: Sequence[int]) -> Tensor:
        chosen = columns_chosen(points, self._shape[0], f"points of '{self.spec.name}'")
        return torch.tensor(chosen, dtype=torch.int64, device=self._engine.device)

    def _link(self, entity: str, link: str) -> int:
        entities = self._engine.layout.entities
        found = entities[find_name(entity, [e.name for e in entities], "robot or object", "the scene")]
        names = found.spec.articulation.link_names
        return found.root_link + find_name(link, names, "link", f"'{entity}'")
