"""What MuJoCo misses of the conformance scenarios: by how much, with a margin, and why."""

from __future__ import annotations

from orbit_core.interfaces import Gap
from orbit_mjmodel.gaps import CONTACT, MOTION

GAPS: tuple[Gap, ...] = (*MOTION, *CONTACT)
