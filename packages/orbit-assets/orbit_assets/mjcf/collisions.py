"""Which links of an MJCF model may collide with each other, from its geoms' masks and its exclusions."""

from __future__ import annotations

from typing import Any

import numpy as np

from orbit_assets.mjcf.geometry import Geoms
from orbit_assets.mjcf.model import Compiled
from orbit_assets.mjcf.trees import Tree


def self_collisions(compiled: Compiled, geoms: Geoms, tree: Tree) -> tuple[bool, tuple[tuple[str, str], ...]]:
    """Whether any two links may collide, and the pairs that never do although others may."""
    model = compiled.model
    types = np.zeros(model.nbody, np.int64)
    affinities = np.zeros(model.nbody, np.int64)
    for body in tree.bodies:
        for geom in geoms.of_body(body):
            types[body] |= int(model.geom_contype[geom])
            affinities[body] |= int(model.geom_conaffinity[geom])
    bodies = np.asarray(tree.bodies)
    solid = np.sort(bodies[(types[bodies] | affinities[bodies]) != 0])
    parent, weld = np.asarray(model.body_parentid), np.asarray(model.body_weldid)
    hangs_on = weld[parent[weld]]
    excluded = _excluded(model)
    may = False
    apart: list[tuple[str, str]] = []
    unfiltered: list[tuple[str, str]] = []
    # A row of all later bodies at a time, for time that grows with the square of their number must go by in NumPy.
    for position, first in enumerate(solid[:-1]):
        later = solid[position + 1 :]
        meet = (types[first] & affinities[later]) | (types[later] & affinities[first])
        one, others = weld[first], weld[later]
        joined = (
            (one == others) | ((one != 0) & (one == hangs_on[later])) | ((others != 0) & (others == hangs_on[first]))
        )
        free = (meet != 0) & ~joined & ~np.isin(later, list(excluded.get(int(first), ())))
        neighbours = parent[later] == first
        # The engine filters no pair with a body that is fixed to the world, where a joint moves the other.
        unfiltered += [(compiled.body_names[first], compiled.body_names[body]) for body in later[free & neighbours]]
        free, later = free[~neighbours], later[~neighbours]
        may = may or bool(free.any())
        apart += [(compiled.body_names[first], compiled.body_names[body]) for body in later[~free]]
    if unfiltered:
        pairs = ", ".join(f"{one} with {other}" for one, other in unfiltered)
        compiled.notes.append(f"bodies fixed to the world do not collide with those that they carry by joints: {pairs}")
    return (True, tuple(apart)) if may else (False, ())


def _excluded(model: Any) -> dict[int, set[int]]:
    """For each body, the bodies that an ``<exclude>`` names with it."""
    found: dict[int, set[int]] = {}
    for mark in model.exclude_signature.tolist():
        # The two bodies' numbers, 16 bits each.
        for one, other in ((mark >> 16, mark & 0xFFFF), (mark & 0xFFFF, mark >> 16)):
            found.setdefault(one, set()).add(other)
    return found
