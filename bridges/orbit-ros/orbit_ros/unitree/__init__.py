"""Unitree's low-level messages for Go2 and G1, as ``unitree_sdk2`` lays them out."""

from orbit_core.exports import lazy_modules

__getattr__, __dir__ = lazy_modules(__name__)
