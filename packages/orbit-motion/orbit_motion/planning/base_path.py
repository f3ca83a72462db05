"""Paths of a mobile base over the floor, around obstacles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError, PlanningError
from orbit_motion.compliant import PlacedWorld
from orbit_motion.obstacles import Obstacles

_Array = Any


@dataclass(frozen=True, kw_only=True)
class BasePlannerConfig:
    """Settings of base paths.

    The base is an upright cylinder; every shape below its top except the floor is an obstacle.
    """

    radius: float
    """Metres around the base's middle that are kept free."""
    height: float
    """Metres above the floor to the top of the base, or of the base with its arm."""
    low: tuple[float, float]
    """Corner of the map, in the environment's frame, m."""
    high: tuple[float, float]
    """The opposite corner."""
    floor: float = 0.0
    """Height of the floor in the environment's frame, m."""
    resolution: float = 0.05
    """Metres between cells."""
    obstacles: tuple[str, ...] | None = None
    """Obstacles, as :class:`~orbit_motion.obstacles.Obstacles` takes them."""

    def __post_init__(self) -> None:
        sizes = (self.radius, self.height, self.resolution, self.high[0] - self.low[0], self.high[1] - self.low[1])
        if not all(math.isfinite(size) and size > 0.0 for size in sizes):
            raise ConfigurationError(
                "a base's map needs a radius, height and resolution above zero, and 'high' beyond 'low', all finite; "
                f"not {self}"
            )


class BasePlanner:
    """Shortest paths over a grid of eight neighbours (scipy's Dijkstra), straightened where the way is free.

    The scene's shapes below the base's top are projected on the floor and grown by the base's radius.

    Raises:
        ConfigurationError: scipy is not installed.
        UnknownNameError: the world has no such obstacle.
    """

    def __init__(self, world: PlacedWorld, config: BasePlannerConfig) -> None:
        try:
            from scipy import ndimage, sparse
            from scipy.sparse import csgraph
        except ImportError:
            raise ConfigurationError(f"plans need the package scipy: {install_extra('planning')}") from None
        self._ndimage, self._sparse, self._csgraph = ndimage, sparse, csgraph
        self._world, self.config = world, config
        """Grid and clearance."""
        self._obstacles = Obstacles(world, config.obstacles)
        self._axes = [np.arange(a, b, config.resolution) for a, b in zip(config.low, config.high, strict=True)]

    def plan(self, start: Tensor, goal: Tensor, env: int = 0) -> Tensor:
        """Plan places (P, 2) in the environment's frame, between which straight lines keep the radius free, to a cell.

        Args:
            start: (2,) of the base's middle.
            goal: (2,)
            env: index of the environment.

        Raises:
            PlanningError: start or goal are off the map or too near to something, which it names; or nothing leads
                from one to the other, and then it names what stands nearest to the goal.
        """
        free, nearest = self._map(env)
        ends = [
            self._cell(what, place, free, nearest) for what, place in zip(("start", "goal"), (start, goal), strict=True)
        ]
        cells = self._search(free, ends[0], ends[1])
        if cells is None:
            raise PlanningError(
                f"no way of {2 * self.config.radius:g} m width leads the base to the goal {_told(goal)}: "
                f"'{nearest(ends[1])}' stands nearest to it"
            )
        corners = _straightened(free, cells)
        places = np.array([[axis[i] for axis, i in zip(self._axes, cell, strict=True)] for cell in corners])
        path = torch.as_tensor(places, dtype=torch.float32, device=goal.device).reshape(-1, 2)
        return torch.cat((start[None], path[1:-1], goal[None]))

    def _map(self, env: int) -> tuple[_Array, Any]:
        """Return the cells (X, Y) bool that the base's middle may be in, and a function that names the thing nearest to
        a cell.
        """
        config, step = self.config, self.config.resolution
        x, y = np.meshgrid(*self._axes, indexing="ij")
        gap, owners = torch.full((x.size,), torch.inf), torch.zeros(x.size, dtype=torch.int64)
        places = torch.as_tensor(np.stack((x.ravel(), y.ravel()), 1), dtype=torch.float32, device=self._world.device)
        # Slices of the cylinder: shapes have distances to points only.
        for height in np.arange(step, max(config.height, 1.5 * step), step):
            points = torch.cat((places, places.new_full((len(places), 1), config.floor + float(height))), 1)
            distances = self._obstacles.distances(points[None], env)[0][0]
            if distances.shape[1]:
                least = distances.min(1)
                nearer = least.values.cpu() < gap
                owners = torch.where(nearer, least.indices.cpu(), owners)
                gap = torch.where(nearer, least.values.cpu(), gap)
        # Cells that a shape may touch: it is nearer than half a cell's diagonal, and the floor is not.
        taken = (gap < 0.75 * step).numpy().reshape(x.shape)
        if not taken.any():
            return np.ones(x.shape, dtype=bool), lambda cell: "the map's edge"
        away, index = self._ndimage.distance_transform_edt(~taken, sampling=step, return_indices=True)
        owner = owners.numpy().reshape(x.shape)
        return away > config.radius, lambda cell: self._obstacles.names[owner[tuple(index[:, cell[0], cell[1]])]]

    def _cell(self, what: str, place: Tensor, free: _Array, nearest: Any) -> tuple[int, int]:
        given = place.double().cpu().numpy()
        low, step = np.array(self.config.low), self.config.resolution
        if not np.isfinite(given).all():
            raise PlanningError(f"the base's {what} {_told(place)} is not finite")
        i, j = (int(part) for part in np.rint((given - low) / step))
        if not (0 <= i < free.shape[0] and 0 <= j < free.shape[1]):
            raise PlanningError(
                f"the base's {what} {_told(place)} is off the map from {self.config.low} to {self.config.high}"
            )
        if not free[i, j]:
            raise PlanningError(
                f"the base's {what} {_told(place)} is within its radius of {self.config.radius:g} m of "
                f"'{nearest((i, j))}'"
            )
        return i, j

    def _search(self, free: _Array, start: tuple[int, int], goal: tuple[int, int]) -> list[tuple[int, int]] | None:
        number = np.arange(free.size).reshape(free.shape)
        rows, columns, costs = [], [], []
        # Each edge of the eight-neighbour grid once: the graph is undirected.
        for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
            a = (slice(0, free.shape[0] - dx), slice(max(0, -dy), free.shape[1] - max(0, dy)))
            b = (slice(dx, free.shape[0]), slice(max(0, dy), free.shape[1] + min(0, dy)))
            both = free[a] & free[b]
            rows.append(number[a][both])
            columns.append(number[b][both])
            costs.append(np.full(len(rows[-1]), math.hypot(dx, dy)))
        edges = (np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns)))
        graph = self._sparse.csr_matrix(edges, shape=(free.size, free.size))
        first, last = int(number[start]), int(number[goal])
        before = self._csgraph.dijkstra(graph, directed=False, indices=first, return_predecessors=True)[1]
        if first != last and before[last] < 0:
            return None
        path = [last]
        while path[-1] != first:
            path.append(int(before[path[-1]]))
        return [divmod(cell, free.shape[1]) for cell in reversed(path)]


def _straightened(free: _Array, cells: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the cells of the path's corners: each leads to the last cell that is visible from it."""
    corners, here = [cells[0]], 0
    while here < len(cells) - 1:
        here = next(there for there in range(len(cells) - 1, here, -1) if there == here + 1 or
                    _sees(free, cells[here], cells[there]))  # fmt: skip
        corners.append(cells[here])
    return corners


def _sees(free: _Array, first: tuple[int, int], second: tuple[int, int]) -> bool:
    a, b = np.array(first), np.array(second)
    # Two samples per cell: a line may cut a corner of less than half a cell.
    share = np.linspace(0.0, 1.0, 2 * int(np.abs(b - a).max()) + 1)[:, None]
    between = np.rint(a + share * (b - a)).astype(int)
    return bool(free[between[:, 0], between[:, 1]].all())


def _told(place: Tensor) -> str:
    return "({:.2f}, {:.2f})".format(*place.tolist())
