"""Teleoperation: devices that a person moves, what drives a robot by them, and the episodes that are recorded so."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
