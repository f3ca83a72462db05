"""Checks that a robot is the same on every engine: its mass, its links, its drives, its grip and its stand."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
