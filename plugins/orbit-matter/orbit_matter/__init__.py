"""Cloth, rope and elastic solids for any physics engine. Importing this package does not import Warp."""

from orbit_matter.config import MatterConfig
from orbit_matter.plugin import OrbitMatter

__all__ = ["MatterConfig", "OrbitMatter"]
