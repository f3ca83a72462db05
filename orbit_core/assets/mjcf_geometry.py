"""Geoms of a compiled MJCF model as shapes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Box, Capsule, Color, Cylinder, Geometry, Mesh, PhysicsMaterial, Pose, Shape, Sphere
from orbit_core.scene.pose import Vector3, canonical

_UNPAINTED: Color = (0.5, 0.5, 0.5, 1.0)
"""A geom of this colour shows its material's."""


@dataclass(eq=False)
class Geoms:
    """Those of one model; what is not taken as it is becomes a line of ``notes``."""

    model: Any
    mujoco: Any
    path: Path
    notes: list[str]

    def of_body(self, body: int) -> Iterator[int]:
        """The body's geoms, without terrain."""
        model, kinds = self.model, self.mujoco.mjtGeom
        first = int(model.body_geomadr[body])
        for geom in range(first, first + int(model.body_geomnum[body])):
            if kinds(model.geom_type[geom]) not in (kinds.mjGEOM_PLANE, kinds.mjGEOM_HFIELD):
                yield geom

    def shape(self, geom: int) -> Shape:
        """A geom with its pose in the body, material and colour."""
        model = self.model
        pose = Pose(vector_of(model.geom_pos[geom]), canonical(tuple(model.geom_quat[geom])))
        sliding, torsional, rolling = (float(value) for value in model.geom_friction[geom])
        dimensions = int(model.geom_condim[geom])
        sliding = sliding if dimensions >= 3 else 0.0
        material = PhysicsMaterial(
            static_friction=sliding,
            dynamic_friction=sliding,
            torsional_friction=torsional if dimensions >= 4 else 0.0,
            rolling_friction=rolling if dimensions >= 6 else 0.0,
        )
        return Shape(self._geometry(geom), pose, material, self._color(geom), model.geom(geom).name)

    def _geometry(self, geom: int) -> Geometry:
        model, kinds = self.model, self.mujoco.mjtGeom
        x, y, z = size = vector_of(model.geom_size[geom])
        match kinds(model.geom_type[geom]):
            case kinds.mjGEOM_BOX:
                return Box(size)
            case kinds.mjGEOM_SPHERE:
                return Sphere(x)
            case kinds.mjGEOM_CAPSULE:
                return Capsule(x, y)
            case kinds.mjGEOM_CYLINDER:
                return Cylinder(x, y)
            case kinds.mjGEOM_ELLIPSOID:
                return self._ellipsoid((x, y, z), geom)
            case kinds.mjGEOM_MESH:
                return self._mesh(int(model.geom_dataid[geom]))
            case kind:
                raise AssetError(f"geom '{model.geom(geom).name}' of {self.path} is of {kind.name}: make it a mesh")

    def _ellipsoid(self, radii: Vector3, geom: int) -> Mesh:
        from trimesh.creation import icosphere

        self.notes.append(f"ellipsoid {self.model.geom(geom).name or geom} is a mesh of 320 triangles")
        ball = icosphere(subdivisions=2)
        return Mesh(np.asarray(ball.vertices) * radii, np.asarray(ball.faces))

    def _mesh(self, mesh: int) -> Mesh:
        model = self.model
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        return Mesh(model.mesh_vert[first : first + count].copy(), model.mesh_face[face : face + faces].copy())

    def _color(self, geom: int) -> Color:
        model = self.model
        rgba = model.geom_rgba[geom]
        if model.geom_matid[geom] >= 0 and np.allclose(rgba, _UNPAINTED):
            rgba = model.mat_rgba[model.geom_matid[geom]]
        red, green, blue, alpha = (float(value) for value in rgba)
        return (red, green, blue, alpha)


def vector_of(values: Any) -> Vector3:
    """Three numbers as Python's."""
    x, y, z = (float(value) for value in values)
    return (x, y, z)
