"""Declared gaps of robots that miss a check on every engine, by their own nature."""

from __future__ import annotations

from orbit_core.interfaces import Gap

ROBOT_GAPS: tuple[Gap, ...] = ()
