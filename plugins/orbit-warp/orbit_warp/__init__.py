"""The Warp backend: thousands of environments on one GPU through MuJoCo-Warp; the same on a CPU, for correctness.

Importing this package imports neither Warp nor MuJoCo.
"""

from orbit_warp.backend import WarpBackend
from orbit_warp.config import WarpConfig

__all__ = ["WarpBackend", "WarpConfig"]
