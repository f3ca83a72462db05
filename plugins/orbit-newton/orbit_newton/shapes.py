"""Collision shapes as Newton's."""

# pyright: reportMissingImports=false
# pyright: reportArgumentType=false

from __future__ import annotations

from dataclasses import dataclass, field

import newton
import numpy as np
import warp as wp

from orbit_core.interfaces import ConfigurationError
from orbit_core.plugin_kit.meshes import hull_of
from orbit_core.scene import (
    Box,
    Capsule,
    Cylinder,
    HeightField,
    Mesh,
    MeshCollision,
    PhysicsMaterial,
    Plane,
    Pose,
    Shape,
    Sphere,
)


@dataclass
class ShapeBuilder:
    """Adds shapes to a world; a mesh that several shapes share is stored once."""

    world: newton.ModelBuilder
    """Builder that gets the shapes."""
    gap: float
    """m between shapes within which contacts are made."""
    links: list[int] = field(default_factory=list)
    """Link of each shape so far."""
    materials: list[PhysicsMaterial] = field(default_factory=list)
    """Material of each shape so far."""
    _meshes: dict[Mesh, newton.Mesh] = field(default_factory=dict)

    def add(self, body: int, link: int, shape: Shape, subject: str) -> None:
        """Add ``shape`` of ``link`` to ``body``, -1 for the world; ``subject`` is for messages.

        Raises:
            ConfigurationError: Newton has no such shape there.
        """
        place = {"xform": transform(shape.pose), "cfg": self._config(shape.material)}
        match shape.geometry:
            case Box((x, y, z)):
                self.world.add_shape_box(body, hx=float(x), hy=float(y), hz=float(z), **place)
            case Sphere(radius):
                self.world.add_shape_sphere(body, radius=float(radius), **place)
            case Capsule(radius, half_length):
                self.world.add_shape_capsule(body, radius=float(radius), half_height=float(half_length), **place)
            case Cylinder(radius, half_length):
                self.world.add_shape_cylinder(body, radius=float(radius), half_height=float(half_length), **place)
            case Plane():
                self.world.add_shape_plane(None, body=body, width=0.0, length=0.0, **place)
            case Mesh(collision=MeshCollision.CONVEX_HULL) as mesh:
                self.world.add_shape_convex_hull(body, mesh=self._mesh(mesh), **place)
            case Mesh() as mesh:
                self.world.add_shape_mesh(body, mesh=self._mesh(mesh), **place)
            case HeightField() as heights if body == -1:
                self.world.add_shape_heightfield(heightfield=_height_field(heights), **place)
            case other:
                raise ConfigurationError(f"Newton cannot collide the {type(other).__name__} of {subject} as it is")
        self.links.append(link)
        self.materials.append(shape.material)

    def _config(self, material: PhysicsMaterial) -> newton.ModelBuilder.ShapeConfig:
        return newton.ModelBuilder.ShapeConfig(
            # Masses come from the description; a density would add the shape's own.
            density=0.0,
            mu=float(material.dynamic_friction),
            mu_torsional=float(material.torsional_friction),
            mu_rolling=float(material.rolling_friction),
            restitution=float(material.restitution),
            gap=self.gap,
            has_particle_collision=False,
        )

    def _mesh(self, mesh: Mesh) -> newton.Mesh:
        # Keyed by the mesh, because a scene repeats meshes, and each has an acceleration structure on the device.
        if mesh not in self._meshes:
            # The description's mesh need not be convex, and Newton takes the mesh of a hull as it is.
            own = hull_of(mesh) if mesh.collision is MeshCollision.CONVEX_HULL else mesh
            vertices, faces = np.asarray(own.vertices, np.float32), np.asarray(own.faces, np.int32)
            self._meshes[mesh] = newton.Mesh(vertices, faces.ravel(), compute_inertia=False)
        return self._meshes[mesh]


def _height_field(field: HeightField) -> newton.Heightfield:
    heights = np.asarray(field.heights, dtype=np.float32)
    rows, columns = heights.shape
    x, y = field.size
    return newton.Heightfield(heights, nrow=rows, ncol=columns, hx=x / 2, hy=y / 2)


def transform(pose: Pose) -> wp.transform:
    """Newton's form of a pose: quaternions have their real part last."""
    w, x, y, z = map(float, pose.orientation)
    return wp.transform(wp.vec3(*map(float, pose.position)), wp.quat(x, y, z, w))
