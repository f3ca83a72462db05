"""The Bullet backend: CPU simulation in worker processes, with cloth and soft bodies, and a renderer.

Importing this package does not import Bullet.
"""

from orbit_bullet.backend import BulletBackend
from orbit_bullet.config import BulletConfig

__all__ = ["BulletBackend", "BulletConfig"]
