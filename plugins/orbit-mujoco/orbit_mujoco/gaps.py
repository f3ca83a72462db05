"""What MuJoCo misses of the conformance scenarios: by how much, with a margin, and why."""

from __future__ import annotations

from orbit_core.interfaces import Gap
from orbit_mjmodel.gaps import CONTACT, CREEP, MOTION

_LEANING = Gap("stack", "drift", 1.6e-3, f"the tower slowly leans over: {CREEP}")
_LEANING_UNDER_LOAD = Gap("loaded_tower", "lean_10", 0.03, f"the tower slowly leans over: {CREEP}")

GAPS: tuple[Gap, ...] = (*MOTION, *CONTACT, _LEANING, _LEANING_UNDER_LOAD)
