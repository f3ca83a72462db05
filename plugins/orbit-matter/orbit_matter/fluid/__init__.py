"""Liquids as weakly compressible particles."""

from orbit_core.plugin_kit import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
