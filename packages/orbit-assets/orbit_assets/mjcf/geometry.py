"""Geoms of a compiled MJCF model as shapes, and its masks and exclusions as pairs that do not collide."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from orbit_assets.mjcf.model import Compiled, pose_of, vector_of
from orbit_assets.mjcf.trees import Tree
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import (
    Box,
    Capsule,
    Color,
    Cylinder,
    Geometry,
    HeightField,
    Mesh,
    MeshCollision,
    PhysicsMaterial,
    Plane,
    Shape,
    Sphere,
)
from orbit_core.scene.pose import Vector3

# A geom of this colour shows its material's.
_UNPAINTED: Color = (0.5, 0.5, 0.5, 1.0)
# MuJoCo's viewer draws geoms of the groups below this one, by default.
_DRAWN_GROUPS = 3


class Geoms:
    """Geoms of one tree of a model; ``terrain`` takes over planes and height fields that do not move.

    Raises:
        AssetError: a height field moves, and the options have what cannot be held refused.
    """

    def __init__(self, compiled: Compiled, tree: Tree, *, terrain: bool = False) -> None:
        self.compiled = compiled
        self.tree = tree
        self._meshes: dict[tuple[int, MeshCollision], Mesh] = {}
        model, kinds = compiled.model, compiled.mujoco.mjtGeom
        endless = np.isin(model.geom_type, (int(kinds.mjGEOM_PLANE), int(kinds.mjGEOM_HFIELD)))
        ours = np.isin(model.geom_bodyid, tree.bodies) & endless
        moves = ours & ((model.body_weldid[model.geom_bodyid] != 0) | tree.floating)
        for geom in np.flatnonzero(moves):
            compiled.unsupported(f"{self.called(int(geom))} is a height field that moves", "make it a mesh")
        still = ours & ~moves
        if still.any() and not terrain:
            compiled.notes.append(f"planes and height fields, which are the scene's, are left out: {still.sum()}")
        self._left = moves if terrain else endless

    def of_body(self, body: int) -> Iterator[int]:
        """Yield the body's geoms that are taken over."""
        model = self.compiled.model
        if body == 0 and not self.tree.world_geoms:
            return
        first = int(model.body_geomadr[body])
        for geom in range(first, first + int(model.body_geomnum[body])):
            if not self._left[geom]:
                yield geom

    def shapes(self, body: int) -> tuple[tuple[Shape, ...], tuple[Shape, ...]]:
        """Return the shapes that collide, and the shapes that are drawn."""
        model = self.compiled.model
        collisions: list[Shape] = []
        visuals: list[Shape] = []
        for geom in self.of_body(body):
            shape = self._shape(geom)
            collisions += [shape] if model.geom_contype[geom] or model.geom_conaffinity[geom] else []
            visuals += [shape] if model.geom_group[geom] < _DRAWN_GROUPS and shape.color[3] > 0 else []
        return tuple(collisions), tuple(visuals)

    def called(self, geom: int) -> str:
        """Return the name of the geom for messages."""
        body = self.compiled.body_names[int(self.compiled.model.geom_bodyid[geom])]
        return f"geom '{self.compiled.geom_names[geom] or geom}' of body '{body}'"

    def _shape(self, geom: int) -> Shape:
        """Return a geom with its pose in the body, material and colour."""
        model = self.compiled.model
        sliding, torsional, rolling = model.geom_friction[geom].tolist()
        dimensions = int(model.geom_condim[geom])
        # condim 1 has no friction, 3 adds sliding, 4 torsional and 6 rolling friction.
        sliding = sliding if dimensions >= 3 else 0.0
        material = PhysicsMaterial(
            static_friction=sliding,
            dynamic_friction=sliding,
            torsional_friction=torsional if dimensions >= 4 else 0.0,
            rolling_friction=rolling if dimensions >= 6 else 0.0,
        )
        pose = pose_of(model.geom_pos[geom], model.geom_quat[geom])
        return Shape(self._geometry(geom), pose, material, self._color(geom), self.compiled.geom_names[geom])

    def _geometry(self, geom: int) -> Geometry:
        model, kinds = self.compiled.model, self.compiled.mujoco.mjtGeom
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
                return self._mesh(int(model.geom_dataid[geom]), MeshCollision.CONVEX_HULL)
            case kinds.mjGEOM_SDF:
                self.compiled.notes.append(f"{self.called(geom)}, a signed distance field, is the mesh of its surface")
                return self._mesh(int(model.geom_dataid[geom]), MeshCollision.TRIANGLES)
            case kinds.mjGEOM_PLANE:
                return Plane()
            case kinds.mjGEOM_HFIELD:
                return self._height_field(int(model.geom_dataid[geom]))
            case kind:
                raise AssetError(f"{self.compiled.path}: {self.called(geom)} is of {kind.name}: make it a mesh")

    def _ellipsoid(self, radii: Vector3, geom: int) -> Mesh:
        from trimesh.creation import icosphere

        self.compiled.notes.append(f"{self.called(geom)}, an ellipsoid, is a mesh of 320 triangles")
        # 320 triangles: within 1 % of the ellipsoid, and few enough to collide as a hull.
        ball = icosphere(subdivisions=2)
        return Mesh(np.asarray(ball.vertices) * radii, np.asarray(ball.faces))

    def _mesh(self, mesh: int, collision: MeshCollision) -> Mesh:
        """Return one object however many geoms show it, so that engines store the mesh once."""
        if (mesh, collision) not in self._meshes:
            model = self.compiled.model
            first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
            face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
            vertices = model.mesh_vert[first : first + count].copy()
            self._meshes[mesh, collision] = Mesh(vertices, model.mesh_face[face : face + faces].copy(), collision)
        return self._meshes[mesh, collision]

    def _height_field(self, field: int) -> HeightField:
        model = self.compiled.model
        rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
        first = int(model.hfield_adr[field])
        x, y, top, _ = model.hfield_size[field].tolist()
        # Heights of a compiled field are normalised to [0, 1]; the fourth size is the base's thickness.
        heights = model.hfield_data[first : first + rows * columns].reshape(rows, columns) * top
        return HeightField(heights.astype(np.float64), (2 * x, 2 * y))

    def _color(self, geom: int) -> Color:
        model = self.compiled.model
        rgba = model.geom_rgba[geom]
        # MuJoCo takes the material's colour where the geom has its default one.
        if model.geom_matid[geom] >= 0 and np.allclose(rgba, _UNPAINTED):
            rgba = model.mat_rgba[model.geom_matid[geom]]
        red, green, blue, alpha = rgba.tolist()
        return (red, green, blue, alpha)


def self_collisions(compiled: Compiled, geoms: Geoms, tree: Tree) -> tuple[bool, tuple[tuple[str, str], ...]]:
    """Return whether any two links may collide, and the pairs that never do although others may."""
    model = compiled.model
    types = np.zeros(model.nbody, np.int64)
    affinities = np.zeros(model.nbody, np.int64)
    for body in tree.bodies:
        for geom in geoms.of_body(body):
            types[body] |= int(model.geom_contype[geom])
            affinities[body] |= int(model.geom_conaffinity[geom])
    bodies = np.asarray(tree.bodies)
    solid = np.sort(bodies[(types[bodies] | affinities[bodies]) != 0])
    parent, weld = np.asarray(model.body_parentid), np.asarray(model.body_weldid)
    hangs_on = weld[parent[weld]]
    excluded = _excluded(model)
    may = False
    apart: list[tuple[str, str]] = []
    unfiltered: list[tuple[str, str]] = []
    # A row of all later bodies at a time: the number of pairs grows with the square, and only NumPy is fast enough.
    for position, first in enumerate(solid[:-1]):
        later = solid[position + 1 :]
        meet = (types[first] & affinities[later]) | (types[later] & affinities[first])
        one, others = weld[first], weld[later]
        joined = (
            (one == others) | ((one != 0) & (one == hangs_on[later])) | ((others != 0) & (others == hangs_on[first]))
        )
        free = (meet != 0) & ~joined & ~np.isin(later, list(excluded.get(int(first), ())))
        neighbours = parent[later] == first
        # The engine filters no pair with a body that is fixed to the world, where a joint moves the other.
        unfiltered += [(compiled.body_names[first], compiled.body_names[body]) for body in later[free & neighbours]]
        free, later = free[~neighbours], later[~neighbours]
        may = may or bool(free.any())
        apart += [(compiled.body_names[first], compiled.body_names[body]) for body in later[~free]]
    if unfiltered:
        pairs = ", ".join(f"{one} with {other}" for one, other in unfiltered)
        compiled.notes.append(f"bodies fixed to the world do not collide with those that they carry by joints: {pairs}")
    return (True, tuple(apart)) if may else (False, ())


def _excluded(model: Any) -> dict[int, set[int]]:
    """Return for each body the bodies that an ``<exclude>`` names with it."""
    found: dict[int, set[int]] = {}
    for mark in model.exclude_signature.tolist():
        # The two bodies' numbers, 16 bits each.
        for one, other in ((mark >> 16, mark & 0xFFFF), (mark & 0xFFFF, mark >> 16)):
            found.setdefault(one, set()).add(other)
    return found
