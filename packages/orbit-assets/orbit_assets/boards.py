"""Furniture of ORBIT's own: links of boxes that are given by two corners, as a joiner measures them."""

from __future__ import annotations

from orbit_assets.mass_properties import shapes_mass_properties
from orbit_core.scene import Box, Color, Link, PhysicsMaterial, Pose, Shape
from orbit_core.scene.pose import Vector3


def box_between(name: str, low: Vector3, high: Vector3, color: Color, surface: PhysicsMaterial) -> Shape:
    """A box between two corners, in metres."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    middle = ((x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2)
    return Shape(Box(((x1 - x0) / 2, (y1 - y0) / 2, (z1 - z0) / 2)), Pose(middle), surface, color, name)


def solid_part(
    name: str, shapes: tuple[Shape, ...], density: float, label: str, origin: Vector3 = (0.0, 0.0, 0.0)
) -> Link:
    """A solid link of shapes of one density (kg/m^3), given in the whole thing's frame.

    ``origin`` is the place of the link's own frame there.
    """
    inward = Pose(origin).inverse()
    own = tuple(Shape(shape.geometry, inward @ shape.pose, shape.material, shape.color, shape.name) for shape in shapes)
    body = shapes_mass_properties(own, density)
    return Link(name, body.mass, body.center_of_mass, body.inertia, own, own, label)
