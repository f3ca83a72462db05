"""Elastic solids: any closed surface embedded in a coarse grid of quadratic hexahedra, stepped implicitly."""

from orbit_core.plugin_kit import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
