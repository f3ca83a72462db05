"""Actuator models that are fitted to recordings of real joints."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
