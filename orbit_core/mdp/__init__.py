"""Observation, reward, event and termination functions that tasks share, and their domain randomisation."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
