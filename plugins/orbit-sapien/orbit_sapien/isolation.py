"""The places of environments, and the links that may collide, as PhysX's filter words."""

from __future__ import annotations

import itertools
import math

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import Approximation, EntityLayout

COLORS = 31
"""Bits of a filter word that tell environments apart over a shared ground."""
_EXCLUSION_BITS = 32


def grid_offset(index: int, spacing: float) -> npt.NDArray[np.float64]:
    """The offset of an environment on a square spiral, the same for any number of environments."""
    if index == 0:
        return np.zeros(3)
    ring = math.ceil((math.sqrt(index + 1) - 1) / 2)
    side, step = divmod(index - (2 * ring - 1) ** 2, 2 * ring)
    x, y = ((ring, step - ring + 1), (ring - 1 - step, ring), (-ring, ring - 1 - step), (step - ring + 1, -ring))[side]
    return spacing * np.array([x, y, 0.0])


def color(offset: npt.NDArray[np.float64], spacing: float) -> int:
    """Equal colours lie at least 5.4 cells apart: on the lattice ``x + 12 y = 0`` modulo 31."""
    x, y = np.rint(offset[:2] / spacing).astype(int)
    return int((x + 12 * y) % COLORS)


def exclusion_groups(entity: EntityLayout, report: list[Approximation] | None) -> list[int]:
    """Third filter word of each link: two that share a bit do not collide. Neighbours never do, by PhysX's own rule."""
    articulation = entity.spec.articulation
    names = articulation.link_names
    if not articulation.self_collisions:
        return [1] * len(names)
    words = [0] * len(names)
    excluded = {frozenset(pair) for pair in (*articulation.collision_exclusions, *articulation.joined_links)}
    colliding = [link.name for link in articulation.links if link.collisions]
    open_pairs = [pair for pair in itertools.combinations(colliding, 2) if frozenset(pair) in excluded]
    for bit in range(_EXCLUSION_BITS):
        if not open_pairs:
            break
        # A bit serves all pairs within a clique of links that never meet, so that cliques are grown greedily: 32 bits
        # are few for a hand with hundreds of excluded pairs.
        clique = list(open_pairs[0])
        clique += [
            name for name in colliding
            if name not in clique and all(frozenset((name, member)) in excluded for member in clique)
        ]  # fmt: skip
        # Each name was tested against the pair that began the clique and not against those added with it.
        clique = _pruned(clique, excluded)
        for name in clique:
            words[names.index(name)] |= 1 << bit
        open_pairs = [pair for pair in open_pairs if not set(pair) <= set(clique)]
    if open_pairs and report is not None:
        asked = f"{len(open_pairs)} more pairs of links that do not collide, {' and '.join(open_pairs[0])} the first"
        why = f"PhysX's filter word has {_EXCLUSION_BITS} bits"
        report.append(Approximation(f"'{entity.name}'", asked, "they collide", why))
    return words


def _pruned(names: list[str], excluded: set[frozenset[str]]) -> list[str]:
    """The names that are excluded from all kept before them."""
    kept: list[str] = []
    for name in names:
        if all(frozenset((name, other)) in excluded for other in kept):
            kept.append(name)
    return kept
