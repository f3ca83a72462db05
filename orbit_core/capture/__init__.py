"""Captured functions: tensor operations and calls to an engine that are traced once, compiled, and replayed."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
