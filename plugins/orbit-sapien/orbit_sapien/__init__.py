"""The SAPIEN backend: PhysX 5 on the CPU, and images up to path tracing.

Importing this package does not import SAPIEN.
"""

from orbit_sapien.backend import SapienBackend
from orbit_sapien.config import SapienConfig

__all__ = ["SapienBackend", "SapienConfig"]
