"""Friction and restitution: factors per link whose products come nearest to the larger value of each pair.

Bullet multiplies the coefficients of the two things that touch; the contract asks for the larger. With one value
everywhere, its root for each is exact. In general the factors solve ``log f_i + log f_j = log max(v_i, v_j)`` over all
pairs that may touch, in the least-squares sense; what remains is reported.

Torsional and rolling friction of a pair are ``r_i f_j + r_j f_i`` in Bullet (``btManifoldResult``), with the factors
``f`` of sliding friction. With ``r_i = f_i s_i`` that is ``f_i f_j (s_i + s_j)``, so that the shares ``s`` solve
``s_i + s_j = max(v_i, v_j) / (f_i f_j)`` over the same pairs.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import Approximation, SceneLayout
from orbit_core.scene import Capsule, Cylinder, PhysicsMaterial, Shape, Sphere

FloatArray = npt.NDArray[np.float64]
# The value in the place of zero, which has no logarithm.
_LEAST = 1e-6
# Sliding friction of a pair below which its torsional and rolling friction fall short, rather than disturb others'.
_LEAST_SLIDING = 0.01
# Metres below which deviations of torsional and rolling friction count as parts of this.
_LEAST_LENGTH = 1e-4
# Relative deviation of a pair's value.
_WORTH_REPORTING = 0.02


class PairProducts:
    """The factors of links 0 .. L-1 and terrain shapes L .. L+T-1 for any values of theirs."""

    def __init__(self, layout: SceneLayout) -> None:
        self.subjects = _subjects(layout)
        """Materials of links and terrain shapes, by which factors are found."""
        self._pairs = np.array(sorted(_touching(layout)), dtype=np.int64).reshape(-1, 2)
        count = len(self.subjects)
        system = np.zeros((len(self._pairs), count))
        np.add.at(system, (np.arange(len(self._pairs))[:, None], self._pairs), 1.0)
        # A whisper of a wish for equal shares picks one of many solutions.
        self._solve = np.linalg.pinv(np.concatenate((system, 1e-4 * np.eye(count)))) if count else np.zeros((0, 0))

    def factors(self, values: FloatArray) -> FloatArray:
        """Factors (n,) of values (n,)."""
        if not len(values) or not values.any():
            return np.zeros_like(values)
        logarithms = np.log(np.maximum(values, _LEAST))
        asked = np.maximum(*logarithms[self._pairs.T]) if len(self._pairs) else np.zeros(0)
        return np.exp(self._solve @ np.concatenate((asked, 0.5e-4 * logarithms)))

    def lengths(self, values: FloatArray, factors: FloatArray) -> FloatArray:
        """Return torsional or rolling friction (n,) in metres that, with ``factors`` of friction, yield values (n,)."""
        if not len(self._pairs) or not values.any():
            return np.zeros_like(values)
        sliding = np.maximum(factors[self._pairs].prod(axis=1), _LEAST_SLIDING)
        shares = self._solve @ np.concatenate((values[self._pairs].max(axis=1) / sliding, np.zeros_like(values)))
        return factors * np.maximum(shares, 0.0)

    def report_lengths(self, what: str, values: FloatArray, factors: FloatArray) -> list[Approximation]:
        """Report the error of sums of lengths: one line, about the worst pair."""
        lengths = self.lengths(values, factors)
        first, second = self._pairs.T
        got = lengths[first] * factors[second] + lengths[second] * factors[first]
        why = "Bullet adds up the two lengths of a pair, each times the other's sliding friction"
        return self._worst(what, values, got, _LEAST_LENGTH, why)

    def report(self, what: str, values: FloatArray) -> list[Approximation]:
        """Report the error of the products: one line, about the worst pair."""
        if not len(self._pairs) or not values.any():
            return []
        factors = self.factors(values)
        why = "Bullet multiplies the two coefficients of a pair; the factors given come nearest for all pairs together"
        return self._worst(what, values, factors[self._pairs].prod(axis=1), 0.05, why)

    def _worst(self, what: str, values: FloatArray, got: FloatArray, least: float, why: str) -> list[Approximation]:
        """A line about the pair whose value got (P,) is furthest from the larger one; relative, above ``least``."""
        asked = values[self._pairs].max(axis=1)
        off = np.abs(got - asked) / np.maximum(asked, least)
        missed = int((off > _WORTH_REPORTING).sum())
        if not missed:
            return []
        worst = int(off.argmax())
        first, second = (self.subjects[i] for i in self._pairs[worst])
        subject = f"{what} of {missed} of {len(self._pairs)} pairs that may touch"
        return [
            Approximation(
                subject,
                f"the larger of two, {asked[worst]:.3g} between {first} and {second}",
                f"{got[worst]:.3g} there, the furthest off",
                why,
            )
        ]


def nominal(layout: SceneLayout, name: str) -> FloatArray:
    """The field ``name`` of the materials of links, then terrain shapes: the largest of a link's shapes."""
    groups = [link.collisions for link in layout.links] + [(shape,) for shape in layout.scene.terrain]
    return np.array([max((getattr(s.material, name) for s in shapes), default=0.0) for shapes in groups])


def rolling_friction(layout: SceneLayout) -> FloatArray:
    """Rolling friction of links, then terrain shapes: where a shape is round, or a material asks for more than usual.

    A flat thing does not roll, and what the smallest friction would add to its contacts is time alone.
    """
    groups = [link.collisions for link in layout.links] + [(shape,) for shape in layout.scene.terrain]
    return np.array([max(map(_rolling_friction, shapes), default=0.0) for shapes in groups])


def _rolling_friction(shape: Shape) -> float:
    asked = shape.material.rolling_friction
    rolls = isinstance(shape.geometry, Sphere | Capsule | Cylinder)
    return asked if rolls or asked > PhysicsMaterial.rolling_friction else 0.0


def material_report(layout: SceneLayout) -> list[Approximation]:
    """List the approximations in Bullet of single materials."""
    found: list[Approximation] = []
    groups = [link.collisions for link in layout.links] + [(shape,) for shape in layout.scene.terrain]
    for subject, shapes in zip(_subjects(layout), groups, strict=True):
        for shape in shapes:
            found += _shape_report(shape, subject)
        for name in ("dynamic_friction", "restitution", "torsional_friction", "rolling_friction"):
            values = sorted({getattr(shape.material, name) for shape in shapes})
            if len(values) > 1:
                why = "Bullet knows one material per link"
                found.append(Approximation(subject, f"{name} {values} of its shapes", f"{values[-1]} for all", why))
    return list(dict.fromkeys(found))


def _shape_report(shape: Shape, subject: str) -> list[Approximation]:
    material = shape.material
    found: list[Approximation] = []
    if material.static_friction != material.dynamic_friction:
        asked = f"static friction {material.static_friction}, dynamic {material.dynamic_friction}"
        why = "Bullet knows one coefficient of sliding friction"
        found.append(Approximation(subject, asked, f"{material.dynamic_friction} for both", why))
    if material.restitution:
        why = "an impact is resolved within one step, and slow impacts do not rebound"
        found.append(Approximation(subject, f"restitution {material.restitution}", "rebounds of fast impacts", why))
    if material.compliance:
        asked = f"stiffness {material.compliance.stiffness}, damping {material.compliance.damping}"
        why = "Bullet applies stiffness and damping at each contact point: a face on four points is four times as stiff"
        found.append(Approximation(subject, asked, "the same at each contact point", why))
    return found


def _subjects(layout: SceneLayout) -> list[str]:
    names = [f"link '{link.name}' of '{e.name}'" for e in layout.entities for link in e.spec.articulation.links]
    return names + [f"terrain shape '{shape.name}'" for shape in layout.scene.terrain]


def _touching(layout: SceneLayout) -> set[tuple[int, int]]:
    """Pairs of links and terrain shapes that may touch; one that shares all else with another counts once."""
    links = len(layout.links)
    owner = [*layout.entity_of_link.tolist(), *([-1] * len(layout.scene.terrain))]
    immovable = {entity.root_link for entity in layout.entities if entity.spec.fixed_base}
    immovable |= set(range(links, links + len(layout.scene.terrain)))
    solid = [n for n, link in enumerate(layout.links) if link.collisions]
    solid += range(links, links + len(layout.scene.terrain))
    pairs: set[tuple[int, int]] = set()
    for first, second in combinations(solid, 2):
        if first in immovable and second in immovable:
            continue
        same = owner[first] == owner[second]
        if same and not (owner[first] >= 0 and layout.entities[owner[first]].spec.articulation.self_collisions):
            continue
        pairs.add((first, second))
    return pairs
