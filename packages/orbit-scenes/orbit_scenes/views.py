"""Camera poses from which a whole scene is seen."""

from __future__ import annotations

import math

import numpy as np

from orbit_core.plugin_kit.meshes import triangles
from orbit_core.scene import Plane, Pose, Scene, look_at

# Part of the picture's height that the scene fills, and the camera's angle above the horizon: over walls, into rooms.
_FILL, _ABOVE = 0.8, 1.05


def overview(scene: Scene, fov: float = 0.8) -> Pose:
    """Return the pose of a camera that sees all objects of a scene obliquely from above.

    Args:
        scene: to be seen.
        fov: vertical field of view, rad.
    """
    points = [
        (entity.pose @ shape.pose).transform(triangles(shape.geometry).bounds)
        for entity in scene.objects
        for shape in entity.articulation.root.collisions
        if not isinstance(shape.geometry, Plane)
    ]
    corners = np.concatenate(points) if points else np.array(((-1.0, -1.0, 0.0), (1.0, 1.0, 1.0)))
    low, high = corners.min(0), corners.max(0)
    middle = (low + high) / 2
    # The picture is wider than high, and a house seen obliquely is foreshortened along y.
    across = max(high[0] - low[0], 1.2 * (high[1] - low[1]))
    away = across / 2 / math.tan(fov / 2) / _FILL
    x, y, z = (float(value) for value in middle)
    return look_at((x, y - away * math.cos(_ABOVE), z + away * math.sin(_ABOVE)), (x, y, z * 0.6))
