"""Collision shapes without volume, as exporters write them for markers and for links that nothing should touch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orbit_assets.findings import Findings
from orbit_core.preparation.scene_data import extents
from orbit_core.scene import Box, Capsule, Cylinder, Geometry, Mesh, Sphere

_HALF_THICKNESS = 0.5e-3
"""Metres."""


def touchable(geometry: Geometry, findings: Findings, where: str) -> Geometry | None:
    """Return a shape that can collide: the shape itself, or a plate 1 mm thick for a flat one.

    Args:
        geometry: of a ``<collision>``.
        findings: notes what is changed or left out.
        where: the link, for the note.

    Returns:
        The shape, or ``None`` for a point or a line, which nothing can touch.
    """
    match geometry:
        case Box(half_extents) if 0.0 in half_extents:
            x, y, z = (length or _HALF_THICKNESS for length in half_extents)
            solid = Box((x, y, z)) if half_extents.count(0.0) == 1 else None
        case Cylinder(radius, 0.0) if radius > 0.0:
            solid = Cylinder(radius, _HALF_THICKNESS)
        case Sphere(0.0) | Capsule(0.0) | Cylinder(0.0):
            solid = None
        case Mesh() if extents(geometry.vertices) == 2:
            solid = _thickened(geometry)
        case _:
            return geometry
    if solid is None:
        findings.leave_out("a <collision> of size zero, which nothing touches,", where)
    else:
        findings.note(f"a flat <collision> of {where} is a plate {2e3 * _HALF_THICKNESS:g} mm thick")
    return solid


def _thickened(mesh: Mesh) -> Mesh:
    """The convex hull of a flat mesh, with thickness."""
    from trimesh.convex import convex_hull

    points = np.asarray(mesh.vertices, dtype=np.float64)
    centred = points - points.mean(axis=0)
    normal = np.linalg.eigh(centred.T @ centred).eigenvectors[:, 0]
    hull = convex_hull(np.concatenate((points + _HALF_THICKNESS * normal, points - _HALF_THICKNESS * normal)))
    vertices, faces = np.asarray(hull.vertices, dtype=np.float32), np.asarray(hull.faces, dtype=np.int32)
    return replace(mesh, vertices=np.ascontiguousarray(vertices), faces=np.ascontiguousarray(faces))
