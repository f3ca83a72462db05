"""Contact forces per query, summed from Bullet's contact points and averaged over a control step."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import ContactQuery

# A body's slot and a link's index in the layout, or TERRAIN.
_Place = tuple[int, int]


class ContactMeter:
    """Reads one client's contact points."""

    def __init__(
        self, client: Any, queries: tuple[ContactQuery, ...], places: dict[_Place, _Place], out: npt.NDArray[np.float32]
    ) -> None:
        """``places`` maps body and Bullet link to slot and layout link; ``out`` (K, Q, 3) takes the mean forces."""
        self.active = bool(queries)
        """False without queries: contact points are then not read."""
        self._client = client
        self._queries = queries
        self._places = places
        self._out = out
        self._sum = np.zeros(out.shape)
        self._wanted: dict[_Place, tuple[tuple[int, float], ...]] = {}

    def clear(self) -> None:
        """Begin a control step."""
        self._sum.fill(0.0)

    def add(self) -> None:
        """Take one physics step's forces in."""
        for point in self._client.getContactPoints():
            normal_force = point[9]
            first, second = self._places.get((point[1], point[3])), self._places.get((point[2], point[4]))
            if normal_force == 0.0 or first is None or second is None:
                continue
            wanted = self._queries_of(first[1], second[1])
            if wanted:
                # Bullet's tuple: the normal on the second body, then two directions of friction with the force along
                # each.
                n, a, b, f, g = point[7], point[11], point[13], point[10], point[12]
                force = np.array([normal_force * n[i] + f * a[i] + g * b[i] for i in range(3)])
                for query, sign in wanted:
                    self._sum[first[0], query] += sign * force

    def average(self, steps: int) -> None:
        """End a control step."""
        np.multiply(self._sum, 1.0 / steps, out=self._out, casting="same_kind")

    def _queries_of(self, first: int, second: int) -> tuple[tuple[int, float], ...]:
        """The queries that a contact between two links answers, and the sign of the force on the first."""
        key = (first, second)
        if key not in self._wanted:
            found = []
            for number, query in enumerate(self._queries):
                if query.link == first and (query.others is None or second in query.others):
                    found.append((number, 1.0))
                if query.link == second and (query.others is None or first in query.others):
                    found.append((number, -1.0))
            self._wanted[key] = tuple(found)
        return self._wanted[key]
