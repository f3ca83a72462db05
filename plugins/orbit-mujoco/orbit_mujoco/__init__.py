"""The MuJoCo backend: multi-threaded CPU simulation through ``mujoco.batch.Batch``, and its renderer.

Importing this package does not import MuJoCo.
"""

from orbit_mujoco.backend import MujocoBackend
from orbit_mujoco.config import MujocoConfig

__all__ = ["MujocoBackend", "MujocoConfig"]
