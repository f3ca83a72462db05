"""Audit of asset files and robots: comparison with other readers of a format, and checks of plausibility."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
