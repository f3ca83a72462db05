"""Where a robot misses a check on every engine, by its own nature: declared gaps that hold on all of them."""

from __future__ import annotations

from orbit_core.interfaces import Gap

ROBOT_GAPS: tuple[Gap, ...] = ()
