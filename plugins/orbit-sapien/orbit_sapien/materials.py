"""Contact coefficients per shape whose averages over a pair, which PhysX takes, are the larger of the two asked for.

Shapes with the same coefficients on the same link form a group. With ``m`` the groups' values, ``A`` a row of two
halves for each pair of groups that may meet, and ``t`` the larger value of each pair, each group is given
``m + pinv(A) (t - A m)``: the values nearest to those asked for whose averages are nearest to the larger ones.

Torsional friction is PhysX's patch friction: a single point of contact under the normal force N resists spin about
the normal with up to ``mu r N``, with ``mu`` the pair's sliding coefficient and ``r`` the larger patch radius of its
shapes. A pair is to have the torque ``c N`` with the larger torsional coefficient ``c``, so it wants the radius
``c / mu``. Each group is given the least that one of its pairs wants: no pair then has more than it wants, and each has
just that if some choice of radii gives it to all.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import TERRAIN, Approximation, SceneLayout
from orbit_core.scene import PhysicsMaterial, Shape

FloatArray = npt.NDArray[np.float64]
_TOLERATED = 1e-3


@dataclass(frozen=True)
class Group:
    """Shapes of one link, or of the terrain, that share their coefficients."""

    link: int
    """Number of the link, or TERRAIN."""
    static: float
    """Coefficient of static friction."""
    dynamic: float
    """Coefficient of dynamic friction."""
    restitution: float
    """Coefficient of restitution."""
    torsional: float
    """m, coefficient of torsional friction."""

    @staticmethod
    def of(link: int, material: PhysicsMaterial) -> Group:
        return Group(
            link, material.static_friction, material.dynamic_friction, material.restitution, material.torsional_friction
        )


class PairRule:
    """Turns what groups ask for into what PhysX is given."""

    def __init__(self, layout: SceneLayout) -> None:
        shapes: list[tuple[int, Shape]] = [(TERRAIN, shape) for shape in layout.scene.terrain]
        shapes += [(number, shape) for number, link in enumerate(layout.links) for shape in link.collisions]
        self.groups = tuple(dict.fromkeys(Group.of(link, shape.material) for link, shape in shapes))
        """All groups of the scene."""
        self._pairs = np.array(
            [pair for pair in combinations(range(len(self.groups)), 2) if self._meet(layout, *pair)], dtype=np.int64
        ).reshape(-1, 2)
        averages = np.zeros((len(self._pairs), len(self.groups)))
        np.put_along_axis(averages, self._pairs, 0.5, axis=1)
        self._averages, self._inverse = averages, np.linalg.pinv(averages)

    def index(self, link: int, material: PhysicsMaterial) -> int:
        """Number of the group of a shape."""
        return self.groups.index(Group.of(link, material))

    def asked(self, name: str) -> FloatArray:
        """(groups,) of the coefficient of that name."""
        return np.array([getattr(group, name) for group in self.groups], dtype=np.float64)

    def given(self, asked: FloatArray) -> FloatArray:
        """The values for PhysX of coefficients (..., groups)."""
        correction = self._larger(asked) - asked @ self._averages.T
        # PhysX takes no negative coefficients, which the nearest values may be.
        return np.maximum(asked + correction @ self._inverse.T, 0.0)

    def patch_radii(self, friction: FloatArray) -> FloatArray:
        """Return radii (..., groups) in metres for PhysX, given dynamic friction (..., groups) as requested."""
        wanted = self._larger(self.asked("torsional"))
        sliding = self.given(friction) @ self._averages.T
        with np.errstate(divide="ignore", invalid="ignore"):
            wanted = np.where(sliding > 0, wanted / sliding, np.inf)
        # Infinite until a pair asks for less; a group that meets nothing ends with none at all.
        radii = np.full((len(self.groups), *friction.shape[:-1]), np.inf)
        for end in self._pairs.T:
            np.minimum.at(radii, end, np.moveaxis(wanted, -1, 0))
        return np.moveaxis(np.where(np.isfinite(radii), radii, 0.0), 0, -1)

    def approximations(self, layout: SceneLayout) -> list[Approximation]:
        """Pairs that do not have the larger value."""
        found: list[Approximation] = []
        for name in ("static", "dynamic", "restitution"):
            asked = self.asked(name)
            quantity = "restitution" if name == "restitution" else f"{name} friction"
            why = "PhysX averages coefficients, and no values meet every pair of this scene"
            found += self._misses(layout, quantity, self._larger(asked), self.given(asked) @ self._averages.T, why)
        dynamic = self.asked("dynamic")
        got = self._larger(self.patch_radii(dynamic)) * (self.given(dynamic) @ self._averages.T)
        why = "it is a radius times the sliding coefficient, and no radii meet every pair of this scene"
        found += self._misses(layout, "torsional friction", self._larger(self.asked("torsional")), got, why)
        return found

    def _misses(
        self, layout: SceneLayout, quantity: str, wanted: FloatArray, got: FloatArray, why: str
    ) -> Iterator[Approximation]:
        for pair in np.flatnonzero(np.abs(wanted - got) > _TOLERATED):
            one, other = (_called(layout, self.groups[group].link) for group in self._pairs[pair])
            yield Approximation(f"{one} on {other}", f"{quantity} {wanted[pair]:.3g}", f"{got[pair]:.3g}", why)

    def _larger(self, asked: FloatArray) -> FloatArray:
        return np.maximum(asked[..., self._pairs[:, 0]], asked[..., self._pairs[:, 1]])

    def _meet(self, layout: SceneLayout, one: int, other: int) -> bool:
        links = self.groups[one].link, self.groups[other].link
        if links[0] == links[1]:
            return False
        if all(link == TERRAIN or _immovable(layout, link) for link in links):
            return False
        if TERRAIN in links:
            return True
        first, second = (layout.entity_of_link[link] for link in links)
        return first != second or layout.entities[first].spec.articulation.self_collisions


def _immovable(layout: SceneLayout, link: int) -> bool:
    entity = layout.entities[layout.entity_of_link[link]]
    return entity.spec.fixed_base and link == entity.root_link


def _called(layout: SceneLayout, link: int) -> str:
    if link == TERRAIN:
        return "the terrain"
    entity = layout.entities[layout.entity_of_link[link]]
    return f"link '{layout.links[link].name}' of '{entity.name}'"
