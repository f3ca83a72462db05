"""The surfaces that a directional light reaches, found in a depth picture taken from the light's side.

Bullet's own shadows are as coarse as the picture, and no darker than it chooses. The map here covers what the picture
shows. The camera that takes it stands so far away that its rays are all but parallel, for Bullet's software renderer
draws nothing by parallel projection.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.scene import Box, CameraSpec, Capsule, Cylinder, Geometry, HeightField, Mesh, Plane, Sphere
from orbit_core.scene.pose import Vector3

_Array = npt.NDArray[Any]

# Pixels of the map along its side for each along the picture's longer side.
_FINER = 2
# Metres from the camera to the middle of what is seen: rays 1 m off the middle are askew by 1 mm/m.
_AWAY = 1000.0
# Metres before and behind the middle that count.
_DEEP = 20.0
# Metres around the middle beyond which all is lit.
_REACH = 3.0
# Metres that a surface may be behind what the light reaches, on top of its slant over half a square.
_SLACK = 0.002
# Least cosine between surface and light that the slack is computed with.
_GRAZING = 0.05


@dataclass(frozen=True)
class MapCamera:
    """The camera of one map: column-wise matrices as Bullet takes them."""

    axes: _Array
    """(3, 3) rows right, up, backward."""
    eye: _Array
    """(3,) m, position of the camera."""
    half: float
    """Metres at the middle's distance that the map reaches to each side."""
    size: int
    """Width and height of the map in pixels."""

    near = _AWAY - _DEEP
    """m of depth at which the map begins."""
    far = _AWAY + _DEEP
    """m of depth at which it ends."""

    @property
    def view(self) -> list[float]:
        """World to camera."""
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = self.axes, -self.axes @ self.eye
        return view.T.ravel().tolist()

    @property
    def vertical_fov(self) -> float:
        """Radians."""
        return 2.0 * math.atan(self.half / _AWAY)

    def reached(self, points: _Array, cosines: _Array, depths: _Array, coarse: _Array) -> npt.NDArray[np.bool_]:
        """Return a mask (P,) of points (P, 3) that the light reaches; outside of the map it does.

        Args:
            points: on surfaces.
            cosines: (P,) between surface and light.
            depths: (size, size) in metres, the map.
            coarse: (P,) metres by which points may be off along the view.
        """
        size, cosines = self.size, cosines.clip(_GRAZING, 1.0)
        local = (points - self.eye) @ self.axes.T
        distance = -local[:, 2]
        column = np.floor((local[:, 0] / distance * _AWAY / self.half + 1.0) * (size / 2)).astype(np.int64)
        row = np.floor((1.0 - local[:, 1] / distance * _AWAY / self.half) * (size / 2)).astype(np.int64)
        inside = (column >= 0) & (column < size) & (row >= 0) & (row < size)
        nearest = depths[row.clip(0, size - 1), column.clip(0, size - 1)]
        corner = math.sqrt(2.0) * self.half / size  # of a square, from its middle
        slack = _SLACK + 2.0 * coarse + corner * np.sqrt(1.0 - cosines**2) / cosines
        return ~inside | (distance < nearest + slack)


def map_camera(
    direction: Vector3, points: _Array, casters: tuple[_Array, _Array], middle: _Array, camera: CameraSpec
) -> MapCamera:
    """A camera that sees what casts shadows on what a picture shows, as the light does.

    Args:
        direction: of the light, a unit vector.
        points: (P, 3) what the picture shows.
        casters: centres (C, 3) and radii (C,) of balls round all that casts shadows.
        middle: (3,) of what moves; the map ends 3 m from there.
        camera: whose picture it is.
    """
    backward = -np.asarray(direction)
    across = np.cross((0.0, 1.0, 0.0) if abs(backward[1]) < 0.9 else (1.0, 0.0, 0.0), backward)
    right = across / np.linalg.norm(across)
    axes = np.stack((right, np.cross(backward, right), backward))
    centers, radii = (casters[0] - middle) @ axes[:2].T, casters[1][:, None]
    shown = (points - middle) @ axes[:2].T
    low, high = np.full(2, -_REACH), np.full(2, _REACH)
    for least, most in ((shown, shown), (centers - radii, centers + radii)):
        if len(least):
            low, high = np.maximum(low, least.min(0)), np.minimum(high, most.max(0))
    center = middle + (low + high) / 2 @ axes[:2]
    half = float(max((high - low).max() / 2 * 1.02, 0.05))
    return MapCamera(axes, center + _AWAY * backward, half, _FINER * max(camera.width, camera.height))


def ball_radius(geometry: Geometry) -> float:
    """Radius of the ball round a shape's origin that holds it; zero for a plane, which shadows nothing drawn."""
    match geometry:
        case Box(half_extents):
            return math.hypot(*half_extents)
        case Sphere(radius):
            return radius
        case Capsule(radius, half_length):
            return radius + half_length
        case Cylinder(radius, half_length):
            return math.hypot(radius, half_length)
        case Plane():
            return 0.0
        case Mesh() as mesh:
            return float(np.linalg.norm(mesh.vertices, axis=-1).max())
        case HeightField() as field:
            return math.hypot(field.size[0] / 2, field.size[1] / 2, float(np.abs(field.heights).max()))
