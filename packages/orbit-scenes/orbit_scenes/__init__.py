"""Scenes: procedural rooms and furniture, household things with grasps, importers of object sets, mesh scans."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
