"""Collision shapes as MuJoCo geoms."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import mujoco
import numpy as np

from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import Box, Capsule, Cylinder, HeightField, Mesh, MeshCollision, Plane, Shape, Sphere
from orbit_mujoco.materials import ContactParameters

_HULL_THICKNESS = 0.1
"""Metres of ground below the lowest point of a height field."""


class GeomBuilder:
    """Adds geoms to a specification; a mesh that several shapes share is stored once."""

    def __init__(self, spec: mujoco.MjSpec) -> None:
        self._spec = spec
        self._meshes: dict[Mesh, str] = {}
        self._height_fields = 0

    def add(self, body: mujoco.MjsBody, shape: Shape, contact: ContactParameters, name: str) -> None:
        """Add ``shape`` to ``body``; ``name`` is for messages.

        Raises:
            ConfigurationError: MuJoCo has no such shape.
        """
        geom = body.add_geom(
            pos=shape.pose.position,
            quat=shape.pose.orientation,
            friction=contact.friction,
            condim=contact.condim,
            solref=contact.solref,
            solimp=contact.solimp,
            solmix=contact.solmix,
        )
        match shape.geometry:
            case Box(half_extents):
                geom.type, geom.size = mujoco.mjtGeom.mjGEOM_BOX, half_extents
            case Sphere(radius):
                geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, (radius, 0, 0)
            case Capsule(radius, half_length):
                geom.type, geom.size = mujoco.mjtGeom.mjGEOM_CAPSULE, (radius, half_length, 0)
            case Cylinder(radius, half_length):
                geom.type, geom.size = mujoco.mjtGeom.mjGEOM_CYLINDER, (radius, half_length, 0)
            case Plane():
                geom.type, geom.size = mujoco.mjtGeom.mjGEOM_PLANE, (0, 0, 1)
            case Mesh(collision=MeshCollision.CONVEX_HULL) as mesh:
                geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, self._hull(mesh)
            case HeightField() as field:
                self._set_height_field(geom, shape, field)
            case other:
                raise ConfigurationError(f"MuJoCo cannot collide the {type(other).__name__} of {name} as it is")

    def _hull(self, mesh: Mesh) -> str:
        """The mesh's convex hull: MuJoCo makes it of vertices that come without faces."""
        if mesh not in self._meshes:
            name = self._meshes[mesh] = f"mesh{len(self._meshes)}"
            self._spec.add_mesh(
                name=name,
                uservert=np.asarray(mesh.vertices, dtype=np.float64).ravel(),
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
            )
        return self._meshes[mesh]

    def _set_height_field(self, geom: mujoco.MjsGeom, shape: Shape, field: HeightField) -> None:
        heights = np.asarray(field.heights, dtype=np.float64)
        lowest, span = heights.min(), max(float(np.ptp(heights)), 1e-6)
        name = f"height_field{self._height_fields}"
        self._height_fields += 1
        self._spec.add_hfield(
            name=name,
            nrow=heights.shape[0],
            ncol=heights.shape[1],
            size=(field.size[0] / 2, field.size[1] / 2, span, _HULL_THICKNESS),
            userdata=((heights - lowest) / span).ravel(),
        )
        geom.type, geom.hfieldname = mujoco.mjtGeom.mjGEOM_HFIELD, name
        geom.pos = shape.pose.transform((0.0, 0.0, float(lowest)))
