"""The metrics of the conformance scenarios that MuJoCo misses, with a limit, which has a margin, and the reason."""

from __future__ import annotations

from orbit_core.interfaces import Gap
from orbit_mjmodel.gaps import CONTACT, MOTION

GAPS: tuple[Gap, ...] = (*MOTION, *CONTACT)
