"""A rope's particles and the coordinates of the chain of ball joints that represents it.

Each piece's frame has its origin in the piece's first particle and its x axis along the piece. Frames follow each other
without twist. Arrays have a row for each environment; loops run along the rope.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_core.plugin_kit.rotations import cross, multiply, rotate, rotate_inverse

FloatArray = npt.NDArray[np.floating]


def chain_positions(points: FloatArray) -> FloatArray:
    """(n, 7 + 4 (P - 2)) of particles (n, P, 3): the first one's place, its piece's orientation, then the joints'.

    The directions of the pieces are taken, and not their lengths.
    """
    along = _directions(points)
    frame = _turn_x_to(along[:, 0])
    found = [points[:, 0], frame]
    for piece in range(1, along.shape[1]):
        joint = _turn_x_to(rotate_inverse(frame, along[:, piece]))
        frame = multiply(frame, joint)
        found.append(joint)
    return np.concatenate(found, axis=1)


def chain_velocities(points: FloatArray, velocities: FloatArray, coordinates: FloatArray) -> FloatArray:
    """(n, 6 + 3 (P - 2)) of particles' velocities (n, P, 3), at :func:`chain_positions`; what stretches is left out."""
    along = _directions(points)
    lengths = np.linalg.norm(np.diff(points, axis=1), axis=-1, keepdims=True)
    spins = cross(along, np.diff(velocities, axis=1)) / np.maximum(lengths, 1e-12)
    frame = coordinates[:, 3:7]
    found = [velocities[:, 0], rotate_inverse(frame, spins[:, 0])]
    for piece in range(1, along.shape[1]):
        start = 7 + 4 * (piece - 1)
        frame = multiply(frame, coordinates[:, start : start + 4])
        found.append(rotate_inverse(frame, spins[:, piece] - spins[:, piece - 1]))
    return np.concatenate(found, axis=1)


def tips(places: FloatArray, frames: FloatArray, length: float) -> FloatArray:
    """(n, 3) where pieces end whose frames are at ``places`` (n, 3) with quaternions ``frames`` (n, 4)."""
    return places + rotate(frames, np.broadcast_to((length, 0.0, 0.0), places.shape))


def _directions(points: FloatArray) -> FloatArray:
    along = np.diff(np.asarray(points, dtype=np.float64), axis=1)
    return along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-12)


def _turn_x_to(directions: FloatArray) -> FloatArray:
    """(n, 4) the shortest rotation that takes the x axis to unit vectors (n, 3)."""
    x, y, z = directions.T
    turn = np.stack((1.0 + x, np.zeros_like(x), -z, y), axis=1)
    turn[x < -1.0 + 1e-9] = (0.0, 0.0, 1.0, 0.0)  # about turns through any axis across
    return turn / np.linalg.norm(turn, axis=1, keepdims=True)
