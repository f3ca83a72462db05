"""Cloth, rope and elastic solids for any physics engine. Importing this package does not import Warp."""

from __future__ import annotations

from orbit_matter.config import MatterConfig
from orbit_matter.plugin import OrbitMatter

__all__ = ["MatterConfig", "OrbitMatter"]
