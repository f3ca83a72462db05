"""Length of a substep that suits the materials and meshes of a scene.

One sweep of a substep carries forces over one edge or so, which makes what hangs too long and what bends too soft: by
``0.42 g h^2 L / (n l^2)`` of the length for cloth of extent L and edges l in n sweeps over its membrane (measured at 9
to 33 rows and 1 to 3 sweeps; ropes are solved whole), and noticeably where ``h (pi / l)^2 sqrt(D / rho)``, the phase of
the shortest bending wave, is above 3. Where a rope is under a tension T the pull of its edges across it is explicit: it
jitters, and carries waves at another speed than ``sqrt(T / rho)``, in substeps above ``0.6 l sqrt(rho / T)`` (measured
at 20 N and 0.05 kg/m: period 0.3 % off at 0.4 of ``l sqrt(rho / T)``, 2.6 % at 0.6, 72 % at 1). Tensions other than
those of loads that hang on it are not known beforehand.
"""

from __future__ import annotations

import math

import numpy as np

from orbit_core.interfaces import Approximation
from orbit_core.plugin_kit.bodies import hanging_weight
from orbit_core.scene import Cloth, Rope, Scene, SoftBody

LONGEST, SHORTEST = 1.25e-3, 0.25e-3
"""Seconds, bounds of a substep that is chosen."""
SHORTEST_OF_WHIPS = 0.125e-3
"""Seconds, for ropes with free bodies, which cost little."""
_GATHERED = 0.84e-3
"""Seconds in which fingers gather a flat cloth between them: of 12 hands that pressed on one and closed, all held it
at 0.83 ms, and 7 at 1.25 ms with more sweeps over its membrane in return."""
LONGEST_OF_SOLIDS = 1.25e-3
"""Seconds. Contacts are as firm as one linearisation of them allows, ``15 m / h^2``: at 2.5 ms the pads of a hand sank
into a block of 60 g until it slipped out, and a block between plates yielded 5 % too little."""
MOST_SWEEPS = 3
"""Over membranes in a substep: they cost less than more substeps do, and as many more of them make up for it."""
_GRAVITY = 9.81
_STRETCH = 0.008
"""Of its length that a hanging thing may be too long."""
_SLACK = 0.42
_PHASE = 3.0
_TAUT = 0.6
_WHIP = 0.03
"""Edges that a rope passes in a substep with the speed ``sqrt(g L)``: a rope of 26 particles that was let go with a bob
from 90 to 170 degrees keeps its energy or loses some in sharp folds at 0.03, and gains some at 0.06."""


def chosen(scene: Scene, longest: float | None = None) -> tuple[float, int]:
    """Seconds of a substep, and sweeps over membranes in it, with which all cloths and ropes are what they should be.

    Args:
        scene: whose deformables are meant.
        longest: seconds of a substep that is given, and not chosen.
    """
    hanging = min((_hanging(spec) for spec in scene.deformables), default=math.inf)
    # A hammock bears what may rest on it by the same sweeps as its own weight.
    hanging = min([hanging, *(bound for spec in scene.deformables for _, bound in _laden(spec, scene))])
    bending = min((_bending(spec) for spec in scene.deformables), default=math.inf)
    most = _GATHERED if any(isinstance(spec, Cloth) for spec in scene.deformables) else LONGEST
    taut = min((_taut(spec, scene) for spec in scene.deformables), default=math.inf)
    whip = min((_whip(spec, scene) for spec in scene.deformables), default=math.inf)
    # Whips come last: they may go below SHORTEST, as ropes cost little.
    begin = longest or min(max(SHORTEST, min(most, bending, taut)), whip)
    # Stretch falls with the square of the substep and with the first power of the sweeps; 1e-6 absorbs rounding.
    sweeps = max(1, min(MOST_SWEEPS, math.ceil((begin / hanging) ** 2 - 1e-6)))
    return longest or min(begin, max(SHORTEST, hanging * math.sqrt(sweeps))), sweeps


def of_solids(scene: Scene, longest: float | None = None) -> int:
    """Return how many steps solids take in a physics step.

    Args:
        scene: whose solids are meant.
        longest: seconds of a step that is given, and not chosen.
    """
    if not any(isinstance(spec, SoftBody) for spec in scene.deformables):
        return 1
    return max(1, math.ceil(scene.physics_dt / min(longest or LONGEST_OF_SOLIDS, LONGEST_OF_SOLIDS) - 1e-6))


def report(scene: Scene, substep: float, sweeps: int) -> tuple[Approximation, ...]:
    """Report what is too long or too soft at a substep of ``substep`` seconds with ``sweeps`` over membranes."""
    found: list[Approximation] = []
    for spec in scene.deformables:
        bounds = {
            "its length": _hanging(spec) * math.sqrt(sweeps),
            "its bending stiffness": _bending(spec),
            "its waves under its load": _taut(spec, scene),
            **{f"bearing '{name}', should it lie on it": b * math.sqrt(sweeps) for name, b in _laden(spec, scene)},
        }
        for asked, bound in bounds.items():
            # One per cent of tolerance, so that substeps chosen from the same bounds are not reported.
            if bound < 0.99 * substep:
                why = f"a substep of {bound * 1e3:.2g} ms would do, and {substep * 1e3:.2g} ms is used"
                got = "another speed" if "waves" in asked else "more than it gives way"
                found.append(Approximation(f"'{spec.name}'", asked, got, why))
    return tuple(found)


def _hanging(spec: object) -> float:
    """Seconds that stretch allows with one sweep."""
    if not isinstance(spec, Cloth):
        return math.inf
    extent = float(np.ptp(spec.rest_positions, axis=0).max())
    return edge_length(spec) * math.sqrt(_STRETCH / (_SLACK * _GRAVITY * extent))


def _bending(spec: object) -> float:
    """Seconds that bending allows."""
    if isinstance(spec, Cloth):
        density = spec.area_density
    elif isinstance(spec, Rope):
        density = spec.linear_density
    else:
        return math.inf
    return _PHASE * (edge_length(spec) / math.pi) ** 2 * math.sqrt(density / max(spec.bending_stiffness, 1e-30))


def _taut(spec: object, scene: Scene) -> float:
    """Seconds that waves across a rope allow under the weight of the free bodies that are attached to it."""
    if not isinstance(spec, Rope):
        return math.inf
    tension = hanging_weight(spec, scene)
    if not tension:
        return math.inf
    return _TAUT * edge_length(spec) * math.sqrt(spec.linear_density / tension)


def _whip(spec: object, scene: Scene) -> float:
    """Seconds in which no edge of a rope that swings with a free body, or whips past it, turns too far."""
    if not isinstance(spec, Rope) or not hanging_weight(spec, scene):
        return math.inf
    length = float(np.linalg.norm(np.diff(spec.rest_positions, axis=0), axis=1).sum())
    return max(SHORTEST_OF_WHIPS, _WHIP * edge_length(spec) / math.sqrt(_GRAVITY * length))


def _laden(spec: object, scene: Scene) -> list[tuple[str, float]]:
    """Free bodies that may rest on cloth that is held, and the seconds with which it bears each with one sweep.

    Half a body's weight pulls at each side of the cloth between two rows of held particles.
    """
    if not isinstance(spec, Cloth):
        return []
    things = {thing.name: thing for thing in (*scene.objects, *scene.robots)}
    fixed = [a for a in spec.attachments if a.entity is None or things[a.entity].fixed_base]
    held = sum(len(attachment.particles) for attachment in fixed)
    free = {n: t for n, t in things.items() if t.is_free_body}
    if held < 2:
        return []
    edge, gravity = edge_length(spec), float(np.linalg.norm(scene.gravity))
    width = min(0.5 * held * edge, float(np.ptp(spec.rest_positions, axis=0).max()))
    bound = edge * math.sqrt(_STRETCH * spec.area_density * 2.0 * width / (2.0 * _SLACK * max(gravity, 1e-9)))
    return [(name, bound / math.sqrt(thing.articulation.links[0].mass)) for name, thing in free.items()]


def edge_length(spec: Cloth | Rope) -> float:
    """Metres: of a rope the mean edge, of cloth the mean of its triangles' shortest."""
    if isinstance(spec, Rope):
        return float(np.linalg.norm(np.diff(spec.rest_positions, axis=0), axis=1).mean())
    corners = spec.rest_positions[np.asarray(spec.mesh.faces)]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).min(axis=1).mean())
