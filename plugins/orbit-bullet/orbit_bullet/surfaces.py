"""Coefficients of friction and restitution of all links and terrain shapes of a world, as Bullet takes them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_bullet.library import Client
from orbit_bullet.materials import PairProducts, nominal, rolling_friction
from orbit_bullet.stage import Stage
from orbit_core.interfaces import TERRAIN, SceneLayout

FloatArray = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]


class Surfaces:
    """The surfaces of K environments of one Bullet world.

    Bullet multiplies the coefficients of the two that meet, so that each is given the factor that makes the product the
    contract's coefficient of the pair.
    """

    def __init__(self, client: Client, stage: Stage, layout: SceneLayout, count: int) -> None:
        """Give all surfaces the coefficients of the scene, in ``count`` environments."""
        self._client, self._stage, self._layout, self._count = client, stage, layout, count
        self._products = PairProducts(layout)
        self._torsional, self._rolling = nominal(layout, "torsional_friction"), rolling_friction(layout)
        self.friction = np.tile(nominal(layout, "dynamic_friction"), (count, 1))
        """(K, L + terrain shapes) coefficients of sliding friction."""
        self._set_restitution()
        self.apply_friction(np.arange(count))

    def set_friction(self, rows: Rows, links: Rows, coefficients: FloatArray) -> None:
        """Set the coefficients (n, k) of links (k,) in environments (n,); ``TERRAIN`` selects all terrain shapes."""
        count = len(self._layout.links)
        for column, link in enumerate(links):
            chosen = slice(count, None) if link == TERRAIN else slice(link, link + 1)
            self.friction[rows, chosen] = coefficients[:, column, None]
        self.apply_friction(rows)

    def apply_friction(self, rows: Rows) -> None:
        """Write ``friction``, and the torsional and rolling friction that go with it, into Bullet."""
        for slot in rows:
            factors = self._products.factors(self.friction[slot])
            torsional = self._products.lengths(self._torsional, factors)
            rolling = self._products.lengths(self._rolling, factors)
            for body, link, number in self._contact_bodies(slot):
                self._client.changeDynamics(
                    body,
                    link,
                    lateralFriction=factors[number],
                    spinningFriction=torsional[number],
                    rollingFriction=rolling[number],
                )

    def _set_restitution(self) -> None:
        factors = self._products.factors(nominal(self._layout, "restitution"))
        for slot in range(self._count):
            for body, link, number in self._contact_bodies(slot):
                self._client.changeDynamics(body, link, restitution=factors[number])

    def _contact_bodies(self, slot: int) -> list[tuple[int, int, int]]:
        """Body, Bullet link and number among the materials of each link that collides, then of each terrain shape."""
        found = []
        for entity in self._layout.entities:
            for offset, index in enumerate(self._stage.links[entity.index]):
                if index in self._stage.colliding[entity.index]:
                    found.append((self._stage.bodies[slot][entity.index], index, entity.links.start + offset))
        links = len(self._layout.links)
        return found + [(body, -1, number) for number, body in enumerate(self._stage.terrain[slot], links)]
