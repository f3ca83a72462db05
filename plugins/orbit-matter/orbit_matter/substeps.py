"""How long a substep may be for what a scene's matter is made of.

One sweep of a substep carries forces over one edge or so, which makes what hangs too long and what bends too soft: by
``0.42 g h^2 L / l^2`` of the length for cloth of extent L and edges l (measured at 9 to 33 rows; ropes are solved
whole), and noticeably where ``h (pi / l)^2 sqrt(D / rho)``, the phase of the shortest bending wave, is above 3.
"""

from __future__ import annotations

import math

import numpy as np

from orbit_core.interfaces import Approximation
from orbit_core.scene import Cloth, Rope, Scene

LONGEST, SHORTEST = 1.25e-3, 0.25e-3
"""Seconds."""
_GRAVITY = 9.81
_STRETCH = 0.008
"""Of its length that a hanging thing may be too long."""
_SLACK = 0.42
_PHASE = 3.0


def needed(scene: Scene) -> float:
    """The longest substep in seconds with which all of the scene's cloths and ropes are what they should be."""
    return min((min(bound) for bound in map(_bounds, scene.deformables) if bound), default=LONGEST)


def chosen(scene: Scene) -> float:
    """:func:`needed`, within what is sensible."""
    return min(LONGEST, max(SHORTEST, needed(scene)))


def report(scene: Scene, substep: float) -> tuple[Approximation, ...]:
    """What is too long or too soft at a substep, in seconds."""
    found: list[Approximation] = []
    for spec in scene.deformables:
        for bound, asked in zip(_bounds(spec), ("its length", "its bending stiffness"), strict=False):
            if bound < 0.99 * substep:
                why = f"a substep of {bound * 1e3:.2g} ms would do, and {substep * 1e3:.2g} ms is used"
                found.append(Approximation(f"'{spec.name}'", asked, "more than it gives way", why))
    return tuple(found)


def _bounds(spec: object) -> tuple[float, ...]:
    """Seconds that stretch and bending allow."""
    if isinstance(spec, Rope):
        edge = float(np.linalg.norm(np.diff(spec.rest_positions, axis=0), axis=1).mean())
        return (math.inf, _bending(edge, spec.bending_stiffness, spec.linear_density))
    if isinstance(spec, Cloth):
        corners = spec.rest_positions[np.asarray(spec.mesh.faces)]
        edge = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).min(axis=1).mean())
        extent = float(np.ptp(spec.rest_positions, axis=0).max())
        hanging = edge * math.sqrt(_STRETCH / (_SLACK * _GRAVITY * extent))
        return (hanging, _bending(edge, spec.bending_stiffness, spec.area_density))
    return ()


def _bending(edge: float, stiffness: float, density: float) -> float:
    return _PHASE * (edge / math.pi) ** 2 * math.sqrt(density / max(stiffness, 1e-30))
