"""Checks and simplifications of scene data before an engine sees it."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
