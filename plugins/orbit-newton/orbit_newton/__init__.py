"""Newton's solvers other than MuJoCo-Warp, each as a separate backend.

Importing this package imports neither Newton nor Warp.
"""

from orbit_newton.backends import FeatherstoneBackend, XpbdBackend
from orbit_newton.config import FeatherstoneConfig, XpbdConfig

__all__ = ["FeatherstoneBackend", "FeatherstoneConfig", "XpbdBackend", "XpbdConfig"]
