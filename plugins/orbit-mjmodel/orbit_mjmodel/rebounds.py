"""Pairs of shapes of which one rebounds: restitution acts along the contact's normal, and friction is left as it is.

MuJoCo gives the normal and the friction of a contact one reference acceleration, so that a lively rebound leaves
friction weak. An explicit pair has a reference for each. Along the normal it is ``-(1 + e) v / dt``, which turns the
speed of approach ``v`` into ``e v`` within one step; what sinks in is lifted slowly by a weak spring.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations

import mujoco
import numpy as np

from orbit_core.scene import PhysicsMaterial

_LIFT = 0.005
"""Stiffness of the spring that lifts what has sunk in, as a share of ``1 / dt^2``. An impact sinks in by up to one
step's way, so that the spring adds up to this to the restitution; half of it is taken off in advance."""
_GRIP = 0.9
"""Share of the speed of slip that friction may remove in a step, up to Coulomb's limit. The larger it is, the more of
an impact's slip is stopped, and the higher hops what slides on: MuJoCo's convex cone adds ``mu`` times the share that
friction could not remove to the speed along the normal."""
_ONE_STEP = ("implicitfast", "implicit", "euler")
"""Integrators that turn the acceleration at the beginning of a step into the speed at its end."""
# Less, and a box on four contacts rebounds too fast; more, and single precision loses momentum.
_IMPEDANCE = (0.997, 0.997, 0.001, 0.5, 2.0)


@dataclass(frozen=True, eq=False)
class Collider:
    """A geom of a shape that is the same in all kinds of environments."""

    geom: mujoco.MjsGeom
    body: str
    movable: bool
    material: PhysicsMaterial


def rebounds_in_one_step(integrator: str, cone: str) -> bool:
    """Return True if a reference of ``-(1 + e) v / dt`` gives the rebound, and friction may have a separate one."""
    return integrator in _ONE_STEP and cone == "elliptic"


def add_rebound_pairs(
    spec: mujoco.MjSpec, colliders: Sequence[Collider], excluded: Collection[frozenset[str]], dt: float
) -> None:
    """Write out the pairs of ``colliders`` that may touch and of which one rebounds.

    Args:
        spec: to which the pairs are added.
        colliders: all geoms whose pairs may be written out; they are given names.
        excluded: pairs of names of bodies that pass through each other.
        dt: the physics step, in seconds.
    """
    for number, collider in enumerate(colliders):
        collider.geom.name = f"collider{number}"
    for one, other in combinations(colliders, 2):
        restitution = max(one.material.restitution, other.material.restitution)
        if restitution == 0.0 or one.material.compliance or other.material.compliance:
            continue
        apart = one.body == other.body or frozenset((one.body, other.body)) in excluded
        if apart or not (one.movable or other.movable):
            continue
        sliding, torsional, rolling = np.maximum(one.geom.friction, other.geom.friction)
        spec.add_pair(
            geomname1=one.geom.name,
            geomname2=other.geom.name,
            condim=max(one.geom.condim, other.geom.condim),
            friction=(sliding, sliding, torsional, rolling, rolling),
            solref=(-_LIFT / dt**2, -(1.0 + restitution - 0.5 * _LIFT) / dt),
            solreffriction=(0.0, -_GRIP / dt),
            solimp=_IMPEDANCE,
        )
