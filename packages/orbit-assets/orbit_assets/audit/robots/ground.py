"""Checks of how a robot stands at home: on its feet or wheels, at the ground, over its support."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from orbit_assets.audit.findings import Finding, Severity
from orbit_assets.audit.geometry import shape_points
from orbit_assets.audit.robots.postures import FloatArray, frame_pose
from orbit_core.preparation.validation import link_poses
from orbit_core.scene import RobotSpec

_LEVEL = 0.005
"""Metres between the lowest and the highest foot."""
_ABOVE, _BELOW = 0.02, 0.002
"""Metres from the ground at which a robot may be put: it falls, or is pushed up."""
_SUPPORT = 0.02
"""Metres above the lowest point in which shapes are taken to carry."""
_INSIDE = 0.01
"""Metres from the edge of the support at which a centre of mass is near it."""


@dataclass(frozen=True)
class StanceReport:
    """How a robot with a free base is put on the ground, in metres."""

    clearance: float
    """Of the lowest point of all collision shapes above the ground."""
    uneven: float
    """Between the lowest and the highest of its feet or wheels."""
    margin: float
    """From the centre of mass, seen from above, to the nearest edge of the support; negative outside."""


def measure_stance(spec: RobotSpec, home: Mapping[str, float]) -> StanceReport | None:
    """Measure a robot at home; ``None`` where its base is held, or it collides with nothing."""
    points = _points(spec, home)
    if spec.fixed_base or not len(points):
        return None
    lowest = float(points[:, 2].min())
    heights = [frame_pose(spec, name, home).position[2] for name in (*spec.feet, *spec.wheels)]
    carrying = points[points[:, 2] < lowest + _SUPPORT, :2]
    return StanceReport(
        lowest, max(heights) - min(heights) if heights else 0.0, _margin(carrying, _center_of_mass(spec, home)[:2])
    )


def check_stance(spec: RobotSpec, stance: StanceReport) -> Iterator[Finding]:
    """Findings on the pose, the feet and the balance."""
    if not spec.feet and not spec.wheels:
        yield Finding(Severity.WARNING, "model", "its base is free, and it names neither feet nor wheels to stand on")
    if stance.clearance > _ABOVE:
        text = f"starts {1e3 * stance.clearance:.0f} mm above the ground and falls: lower its pose, or its home"
        yield Finding(Severity.WARNING, "pose", text)
    if stance.clearance < -_BELOW:
        text = f"starts {-1e3 * stance.clearance:.0f} mm within the ground and is thrown up: raise its pose"
        yield Finding(Severity.FAULT, "pose", text)
    if stance.uneven > _LEVEL:
        text = f"are {1e3 * stance.uneven:.0f} mm from level at home: it tips when it lands"
        yield Finding(Severity.WARNING, "feet", text)
    if stance.margin < 0.0:
        text = f"lies {-1e3 * stance.margin:.0f} mm outside its support at home: it falls over"
        yield Finding(Severity.FAULT, "centre of mass", text)
    elif stance.margin < _INSIDE:
        text = f"lies {1e3 * stance.margin:.0f} mm from the edge of its support at home: it may fall over"
        yield Finding(Severity.WARNING, "centre of mass", text)


def _points(spec: RobotSpec, home: Mapping[str, float]) -> FloatArray:
    """(P, 3) of all collision shapes, in the world."""
    poses = link_poses(spec.articulation, home)
    clouds = [
        (spec.pose @ poses[link.name]).transform(shape_points(shape))
        for link in spec.articulation.links
        for shape in link.collisions
    ]
    return np.concatenate(clouds) if clouds else np.zeros((0, 3))


def _center_of_mass(spec: RobotSpec, home: Mapping[str, float]) -> FloatArray:
    poses = link_poses(spec.articulation, home)
    centers = [link.mass * (spec.pose @ poses[link.name]).transform(np.asarray(link.center_of_mass))
               for link in spec.articulation.links]  # fmt: skip
    return np.sum(centers, axis=0) / spec.articulation.mass


def _margin(points: FloatArray, place: FloatArray) -> float:
    """Metres from a place (2,) to the nearest edge of the hull of points (P, 2); negative outside."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        sides = ConvexHull(points).equations  # outward normals and offsets
    except (QhullError, ValueError):  # all in one line
        return -float(np.linalg.norm(points - place, axis=1).min())
    return -float((sides[:, :2] @ place + sides[:, 2]).max())
