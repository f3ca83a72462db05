"""Markers as shapes, for the viewer and for renderers that draw shapes."""

from __future__ import annotations

import math

import numpy as np

from orbit_core.scene import Box, Color, Cylinder, MarkerShape, MarkerSpec, Mesh, Pose, Shape, Sphere

AXIS_COLORS = ((0.9, 0.2, 0.2), (0.2, 0.8, 0.25), (0.2, 0.4, 0.95))
"""Red, green and blue (sRGB, 0 to 1) of the axes x, y and z of a frame."""


def marker_shapes(marker: MarkerSpec) -> tuple[Shape, ...]:
    """A marker as shapes: an arrow along x, or a frame with x, y, z in red, green, blue."""
    size = marker.size
    match marker.shape:
        case MarkerShape.SPHERE:
            return (Shape(Sphere(size / 2), color=marker.color),)
        case MarkerShape.BOX:
            return (Shape(Box((size / 2, size / 2, size / 2)), color=marker.color),)
        case MarkerShape.ARROW:
            return _arrow(size, size / 25, Pose.from_euler(0.0, math.pi / 2, 0.0), marker.color)
        case MarkerShape.FRAME:
            opacity = marker.color[3]
            turns = ((0.0, math.pi / 2, 0.0), (-math.pi / 2, 0.0, 0.0), (0.0, 0.0, 0.0))
            return tuple(
                shape
                for turn, (r, g, b) in zip(turns, AXIS_COLORS, strict=True)
                for shape in _arrow(size, size / 30, Pose.from_euler(*turn), (r, g, b, opacity))
            )


def _arrow(length: float, radius: float, pose: Pose, color: Color) -> tuple[Shape, Shape]:
    """Along z of ``pose``, from its origin."""
    shaft = Cylinder(radius, 0.375 * length)
    return (
        Shape(shaft, pose @ Pose((0.0, 0.0, 0.375 * length)), color=color),
        Shape(_cone(2.5 * radius, 0.25 * length), pose @ Pose((0.0, 0.0, 0.75 * length)), color=color),
    )


def _cone(radius: float, height: float) -> Mesh:
    import trimesh

    cone = trimesh.creation.cone(radius, height, sections=24)
    return Mesh(np.asarray(cone.vertices), np.asarray(cone.faces))
