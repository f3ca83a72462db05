"""Ray tracer in closed form and double precision: the truth for the scenarios of rays and images.

C. Ericson, Real-Time Collision Detection (2005), section 5.3; for triangles T. Möller and B. Trumbore, Fast, minimum
storage ray/triangle intersection, J. Graphics Tools 2 (1997).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from orbit_core.scene import Box, CameraSpec, Capsule, Cylinder, HeightField, Mesh, Plane, Pose, Sphere
from orbit_core.scene.shapes import Geometry

Array = npt.NDArray[np.float64]
NOTHING = -1
"""Index of what a ray that meets nothing has met."""


@dataclass(frozen=True)
class Hits:
    """Hits of R rays on things, from outside."""

    distances: Array
    """Distances (R,), infinite for a miss."""
    normals: Array
    """Surface normals (R, 3) in world axes, zero for a miss."""
    things: npt.NDArray[np.int64]
    """Index (R,) of the thing that each ray meets, or NOTHING."""


def trace(things: Sequence[tuple[Geometry, Pose]], origins: Array, directions: Array) -> Hits:
    """The nearest hit of each ray (R, 3); distances are in lengths of its direction."""
    count = len(origins)
    best = Hits(np.full(count, np.inf), np.zeros((count, 3)), np.full(count, NOTHING))
    for index, (geometry, pose) in enumerate(things):
        rotation = np.asarray(pose.rotation_matrix(), np.float64)
        # Closed forms are in each shape's own frame.
        local = (origins - pose.position) @ rotation, directions @ rotation
        distances, normals = _meet(geometry, *local)
        nearer = distances < best.distances
        best.distances[nearer] = distances[nearer]
        best.normals[nearer] = normals[nearer] @ rotation.T
        best.things[nearer] = index
    return best


def steady(hits: Hits, others: Sequence[Hits], cosine: float) -> npt.NDArray[np.bool_]:
    """Return a mask (R,) of rays whose neighbours meet the same thing at about the same normal."""
    alike = np.ones(len(hits.things), dtype=np.bool_)
    for other in others:
        turned = (hits.normals * other.normals).sum(1)
        alike &= (hits.things == other.things) & ((turned > cosine) | (hits.things == NOTHING))
    return alike


def pixel_directions(camera: CameraSpec, right: float = 0.0, up: float = 0.0) -> Array:
    """Vectors (H W, 3) in world axes from the camera through each pixel's centre, moved by some pixels, to depth 1."""
    # Pixels are square: the horizontal field of view follows.
    pitch = 2.0 * np.tan(0.5 * camera.vertical_fov) / camera.height
    x = (np.arange(camera.width) + 0.5 + right - 0.5 * camera.width) * pitch
    y = (0.5 * camera.height - np.arange(camera.height) - 0.5 + up) * pitch
    grid = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1).reshape(-1, 3)
    return grid @ np.asarray(camera.pose.rotation_matrix(), np.float64).T


def _meet(geometry: Geometry, origins: Array, directions: Array) -> tuple[Array, Array]:
    """Distances and normals in the shape's own frame."""
    match geometry:
        case Plane():
            height = np.array([0.0, 0.0, 1.0])
            with np.errstate(divide="ignore", invalid="ignore"):
                distances = np.where(directions[:, 2] < 0.0, -origins[:, 2] / directions[:, 2], np.inf)
            return np.where(distances >= 0.0, distances, np.inf), np.broadcast_to(height, origins.shape)
        case Sphere(radius):
            return _sphere(origins, directions, np.zeros(3), radius)
        case Box(half):
            return _box(origins, directions, np.asarray(half, np.float64))
        case Cylinder(radius, half_length):
            return _cylinder(origins, directions, radius, half_length)
        case Capsule(radius, half_length):
            end = np.array([0.0, 0.0, half_length])
            caps = [_sphere(origins, directions, center, radius) for center in (end, -end)]
            return _nearest([*caps, _cylinder(origins, directions, radius, half_length, capped=False)])
        case Mesh(vertices, faces):
            return _triangles(origins, directions, np.asarray(vertices, np.float64)[np.asarray(faces)])
        case HeightField():
            return _triangles(origins, directions, height_field_triangles(geometry))


def height_field_triangles(field: HeightField) -> Array:
    """Corners (F, 3, 3) of the triangles of a height field, each cell split along its rising diagonal."""
    heights = np.asarray(field.heights, np.float64)
    rows, columns = heights.shape
    x, y = (
        np.linspace(-0.5 * size, 0.5 * size, count) for size, count in zip(field.size, (columns, rows), strict=True)
    )
    points = np.stack((*np.meshgrid(x, y), heights), axis=-1)
    # The split decides where a cell's ridge is: all engines must take the same diagonal.
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    return np.concatenate([np.stack(corners, axis=2).reshape(-1, 3, 3) for corners in ((a, b, c), (a, c, d))])


def _nearest(candidates: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    distances = np.stack([distance for distance, _ in candidates])
    first = distances.argmin(axis=0)
    rows = np.arange(distances.shape[1])
    return distances[first, rows], np.stack([normals for _, normals in candidates])[first, rows]


def _sphere(origins: Array, directions: Array, center: Array, radius: float) -> tuple[Array, Array]:
    away = origins - center
    a, b, c = (directions**2).sum(1), (directions * away).sum(1), (away**2).sum(1) - radius**2
    root = b * b - a * c
    distances = np.where(root >= 0.0, (-b - np.sqrt(root.clip(0.0))) / a, np.inf)
    # Behind the origin.
    distances[distances < 0.0] = np.inf
    return distances, (away + _reached(distances) * directions) / radius


def _box(origins: Array, directions: Array, half: Array) -> tuple[Array, Array]:
    with np.errstate(divide="ignore", invalid="ignore"):
        enter = (-np.sign(directions) * half - origins) / directions
        leave = (np.sign(directions) * half - origins) / directions
    outside = (directions == 0.0) & (np.abs(origins) > half)
    enter = np.where(directions == 0.0, np.where(outside, np.inf, -np.inf), enter)
    leave = np.where(directions == 0.0, np.where(outside, -np.inf, np.inf), leave)
    axis, distances = enter.argmax(1), enter.max(1)
    distances = np.where((distances <= leave.min(1)) & (distances >= 0.0), distances, np.inf)
    return distances, -np.sign(directions) * np.eye(3)[axis]


def _cylinder(
    origins: Array, directions: Array, radius: float, half_length: float, capped: bool = True
) -> tuple[Array, Array]:
    a = (directions[:, :2] ** 2).sum(1)
    b = (directions[:, :2] * origins[:, :2]).sum(1)
    root = b * b - a * ((origins[:, :2] ** 2).sum(1) - radius**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        side = np.where((root >= 0.0) & (a > 0.0), (-b - np.sqrt(root.clip(0.0))) / a, np.inf)
        end = (-np.sign(directions[:, 2]) * half_length - origins[:, 2]) / directions[:, 2]
    points = origins + _reached(side) * directions
    side = np.where((np.abs(points[:, 2]) <= half_length) & (side >= 0.0), side, np.inf)
    around = points * (1.0, 1.0, 0.0) / radius
    if not capped:
        return side, around
    across = origins[:, :2] + _reached(end) * directions[:, :2]
    end = np.where((directions[:, 2] != 0.0) & (end >= 0.0) & ((across**2).sum(1) <= radius**2), end, np.inf)
    return _nearest([(side, around), (end, -np.sign(directions[:, 2:]) * (0.0, 0.0, 1.0))])


def _triangles(origins: Array, directions: Array, corners: Array) -> tuple[Array, Array]:
    """The hits on triangles' front faces, which are counter-clockwise as the ray sees them."""
    first, along, aside = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(directions[:, None], aside)  # (R, F, 3)
    volume = (across * along).sum(2)
    with np.errstate(divide="ignore", invalid="ignore"):
        away = origins[:, None] - first
        u = (away * across).sum(2) / volume
        turned = np.cross(away, along)
        v = (directions[:, None] * turned).sum(2) / volume
        distances = (aside * turned).sum(2) / volume
    inside = (volume > 0.0) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distances >= 0.0)
    distances = np.where(inside, distances, np.inf)
    face, rows = distances.argmin(1), np.arange(len(origins))
    normals = np.cross(along, aside)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return distances[rows, face], normals[face]


def _reached(distances: Array) -> Array:
    """Distances (R, 1) with zero for a miss, so that they may be multiplied."""
    return np.where(np.isfinite(distances), distances, 0.0)[:, None]
