"""The environments of one process: a few Bullet worlds, identified by rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_bullet.buffers import Buffers
from orbit_bullet.config import BulletConfig
from orbit_bullet.readings import Readings
from orbit_bullet.simulation import SavedSimulation, Simulation
from orbit_bullet.stage import SceneFiles, client_ranges, envs_per_client
from orbit_core.interfaces import BuiltModel, SceneLayout

Rows = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Written:
    """A call for some environments: ``rowwise`` arguments have a row for each, None stays None."""

    method: str
    """Name of the simulation's method."""
    rows: Rows
    """Environments that the call is for."""
    fixed: tuple[Any, ...] = ()
    """Arguments that are the same for all of them."""
    rowwise: tuple[npt.NDArray[Any] | None, ...] = ()

    def parts(self, ranges: Iterable[tuple[int, int]]) -> Iterator[tuple[int, Written]]:
        """The part of each range of environments that the call concerns, with rows counted from the range's start."""
        for number, (start, stop) in enumerate(ranges):
            here = (self.rows >= start) & (self.rows < stop)
            if here.any():
                rowwise = tuple(None if values is None else values[here] for values in self.rowwise)
                yield number, Written(self.method, self.rows[here] - start, self.fixed, rowwise)


class Shard:
    """Environments whose rows are ``buffers``."""

    def __init__(
        self,
        layout: SceneLayout,
        files: SceneFiles,
        buffers: Buffers,
        config: BulletConfig,
        built: Callable[[int], None],
    ) -> None:
        """Build them; ``built`` is called after each world with its number of environments."""
        count = len(buffers.link_poses)
        self._buffers = buffers
        self._readings = Readings.of(layout, count)
        self._ranges = client_ranges(count, envs_per_client(layout, config))
        self.simulations: list[Simulation] = []
        """Simulations, each with a client of Bullet's."""
        for start, stop in self._ranges:
            rows = buffers.rows(start, stop), self._readings.rows(start, stop)
            self.simulations.append(Simulation(layout, files, *rows, config))
            built(stop - start)
        self._offsets = self.simulations[0].stage.offsets
        self._origins = np.concatenate([simulation.stage.origins for simulation in self.simulations])

    def step(self, steps: int) -> list[int]:
        """Advance; the environments whose deformables flew apart come back."""
        diverged: list[int] = []
        for (first, _), simulation in zip(self._ranges, self.simulations, strict=True):
            diverged += [first + slot for slot in simulation.step(steps)]
        self._readings.convert(self._buffers, slice(None), self._offsets, self._origins)
        return diverged

    def write(self, call: Written) -> None:
        """Do a call for the environments that it names."""
        for number, part in call.parts(self._ranges):
            getattr(self.simulations[number], part.method)(part.rows, *part.fixed, *part.rowwise)

    def cast_rays(self, call: Written) -> tuple[npt.NDArray[Any], ...]:
        """Rays of some environments, which stand in ascending order."""
        found = [
            self.simulations[number].cast_rays(part.rows, part.rowwise[0], part.rowwise[1], *part.fixed)  # type: ignore[arg-type]
            for number, part in call.parts(self._ranges)
        ]
        return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))

    def built_model(self) -> BuiltModel:
        """The model that Bullet holds of the first environment."""
        return self.simulations[0].built_model()

    def save(self) -> list[SavedSimulation]:
        return [simulation.save() for simulation in self.simulations]

    def load(self, saved: list[SavedSimulation]) -> None:
        for simulation, state in zip(self.simulations, saved, strict=True):
            simulation.load(state)

    def forget(self, saved: list[SavedSimulation]) -> None:
        for simulation, state in zip(self.simulations, saved, strict=True):
            simulation.forget(state)

    def close(self) -> None:
        for simulation in self.simulations:
            simulation.close()
