"""Many trainings with varied settings, on the machines of a Ray cluster."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
