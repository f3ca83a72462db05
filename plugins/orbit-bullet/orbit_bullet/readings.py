"""The readings of Bullet, in its own frames and in double precision, and their conversion to the core's state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from orbit_bullet.buffers import Buffers
from orbit_core.interfaces import SceneLayout
from orbit_core.plugin_kit.rotations import compose, cross

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of K environments; an engine converts those of all its worlds at once."""

    bodies: FloatArray
    """(K, L, 13) of each link its centre of mass, principal axes (x, y, z, w), and velocities at the centre of mass.

    Bullet also tells of the link's frame, but rounds it to single precision, in coordinates of kilometres.
    """
    positions: FloatArray
    """(K, J) of joints."""
    velocities: FloatArray
    """(K, J) of joints."""

    @staticmethod
    def of(layout: SceneLayout, count: int) -> Readings:
        """Create readings without values."""
        joints, links = len(layout.joints), len(layout.links)
        return Readings(np.zeros((count, links, 13)), np.zeros((count, joints)), np.zeros((count, joints)))

    def rows(self, start: int, stop: int) -> Readings:
        """Views of some environments."""
        return Readings(self.bodies[start:stop], self.positions[start:stop], self.velocities[start:stop])

    def convert(
        self, buffers: Buffers, rows: slice | npt.NDArray[np.int64], offsets: FloatArray, origins: FloatArray
    ) -> None:
        """Fill the rows of joints and links in ``buffers``.

        Args:
            buffers: Of the same K environments.
            rows: Which of them.
            offsets: (L, 7) each link's pose in its principal axes.
            origins: (K, 3) where each environment stands in its world.
        """
        bodies = self.bodies[rows]
        positions, quaternions = compose(bodies[..., :3], bodies[..., [6, 3, 4, 5]], offsets)
        lever = positions - bodies[..., :3]
        positions -= origins[rows, None]
        quaternions *= np.copysign(1.0, quaternions[..., :1])
        buffers.link_poses[rows] = np.concatenate((positions, quaternions), -1)
        buffers.link_velocities[rows, :, :3] = bodies[..., 7:10] + cross(bodies[..., 10:], lever)
        buffers.link_velocities[rows, :, 3:] = bodies[..., 10:]
        buffers.joint_positions[rows] = self.positions[rows]
        buffers.joint_velocities[rows] = self.velocities[rows]
