"""Kernels compiled ahead of time, and carried to other machines."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
