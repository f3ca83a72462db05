"""Collision shapes as MuJoCo geoms."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import itertools
from collections.abc import Iterator

import mujoco
import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import Approximation, ConfigurationError
from orbit_core.plugin_kit.meshes import convex_faces, few_faces
from orbit_core.scene import Box, Capsule, Cylinder, HeightField, Mesh, MeshCollision, Plane, Pose, Shape, Sphere
from orbit_mjmodel.materials import ContactParameters

PRISM_DEPTH = 0.01
"""Metres that each face of a surface reaches inward."""
# Largest difference of a solid's corners from those of a box, over its size, and of its angles.
_SQUARE = 1e-6
# Metres of ground below the lowest point of a height field.
_GROUND_DEPTH = 0.1
# Metres; narrower faces are left out.
_LEAST_WIDTH = 1e-5
# Levels of the octree that holds a mesh's distances: its finest cells are 2^-7 of the mesh's box.
_FIELD_DEPTH = 7
FloatArray = npt.NDArray[np.float64]
Part = tuple[mujoco.mjtGeom, tuple[float, float, float], str, Pose]
"""A geom's type, size, asset and pose."""


class GeomBuilder:
    """Adds geoms to a specification; a mesh that several shapes share is stored once."""

    def __init__(self, spec: mujoco.MjSpec) -> None:
        self._spec = spec
        self._hulls: dict[Mesh, str] = {}
        self._fields: dict[Mesh, str] = {}
        self._numbers = itertools.count()  # of meshes: a specification lists all of them to count them

    def add(self, body: mujoco.MjsBody, part: Part, contact: ContactParameters, name: str = "") -> mujoco.MjsGeom:
        """Add ``part`` to ``body``, under a name or none."""
        kind, size, asset, pose = part
        return body.add_geom(
            name=name,
            type=kind,
            size=size,
            meshname=asset if kind in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_SDF) else "",
            hfieldname=asset if kind == mujoco.mjtGeom.mjGEOM_HFIELD else "",
            pos=pose.position,
            quat=pose.orientation,
            friction=contact.friction,
            condim=contact.condim,
            solref=contact.solref,
            solimp=contact.solimp,
            solmix=contact.solmix,
        )

    def parts(self, body: mujoco.MjsBody, shape: Shape, name: str) -> Iterator[Part]:
        """The geoms that make up a shape on ``body``: one, but for a surface of triangles. ``name`` is for messages.

        Raises:
            ConfigurationError: MuJoCo has no such shape.
        """
        pose = shape.pose
        match shape.geometry:
            case Box(half_extents):
                yield mujoco.mjtGeom.mjGEOM_BOX, half_extents, "", pose
            case Sphere(radius):
                yield mujoco.mjtGeom.mjGEOM_SPHERE, (radius, 0, 0), "", pose
            case Capsule(radius, half_length):
                yield mujoco.mjtGeom.mjGEOM_CAPSULE, (radius, half_length, 0), "", pose
            case Cylinder(radius, half_length):
                yield mujoco.mjtGeom.mjGEOM_CYLINDER, (radius, half_length, 0), "", pose
            case Plane():
                yield mujoco.mjtGeom.mjGEOM_PLANE, (0, 0, 1), "", pose
            case Mesh(collision=MeshCollision.CONVEX_HULL) as mesh:
                yield mujoco.mjtGeom.mjGEOM_MESH, (0, 0, 0), self._hull(mesh), pose
            case Mesh(collision=MeshCollision.SIGNED_DISTANCE) as mesh:
                yield mujoco.mjtGeom.mjGEOM_SDF, (0, 0, 0), self._field(mesh), pose
            case Mesh() as mesh if body.mocap or body == self._spec.worldbody:
                for face, normal in _wide_faces(mesh):
                    yield self._solid(face, face - PRISM_DEPTH * normal, pose)
            case HeightField() as field if (faces := few_faces(field)) is not None:
                lowest = float(np.min(field.heights)) - _GROUND_DEPTH
                for face in faces:
                    yield self._solid(face, np.column_stack((face[:, :2], np.full(len(face), lowest))), pose)
            case HeightField() as field:
                lowest = Pose((0.0, 0.0, float(np.min(field.heights))))
                yield mujoco.mjtGeom.mjGEOM_HFIELD, (0, 0, 0), self._height_field(field), pose @ lowest
            case other:
                raise ConfigurationError(f"MuJoCo cannot collide the {type(other).__name__} of {name} as it is")

    def _solid(self, face: FloatArray, base: FloatArray, pose: Pose) -> Part:
        """The part between a convex face (corners, 3) and its ``base``: a box where it is one, and else a hull."""
        down = base - face
        ends = np.array((face[0], face[1], face[-1], base[0]))
        sides = ends[1:] - ends[0]
        lengths = np.linalg.norm(sides, axis=-1)
        axes = sides.T / lengths
        skew = np.abs(axes.T @ axes - np.eye(3)).max()
        if len(face) == 4 and np.ptp(down, axis=0).max() < _SQUARE and skew < _SQUARE:
            open_corner = np.abs(face[0] + face[2] - face[1] - face[3]).max()
            if open_corner < _SQUARE * lengths.max():
                frame = np.eye(4)
                frame[:3, :3], frame[:3, 3] = axes * (1.0, 1.0, np.linalg.det(axes)), 0.5 * (face + base).mean(0)
                return mujoco.mjtGeom.mjGEOM_BOX, tuple(0.5 * lengths), "", pose @ Pose.from_matrix(frame)
        return mujoco.mjtGeom.mjGEOM_MESH, (0, 0, 0), self._asset(np.concatenate((face, base))), pose

    def _hull(self, mesh: Mesh) -> str:
        if mesh not in self._hulls:
            self._hulls[mesh] = self._asset(np.asarray(mesh.vertices, dtype=np.float64))
        return self._hulls[mesh]

    def _field(self, mesh: Mesh) -> str:
        """The mesh with an octree of distances, which MuJoCo makes as it compiles."""
        if mesh not in self._fields:
            asset = self._spec.add_mesh(
                name=f"mesh{next(self._numbers)}",
                uservert=np.asarray(mesh.vertices, dtype=np.float64).ravel(),
                userface=np.asarray(mesh.faces, dtype=np.int32).ravel(),
                octree_maxdepth=_FIELD_DEPTH,
            )
            self._fields[mesh] = asset.name
        return self._fields[mesh]

    def _asset(self, vertices: FloatArray) -> str:
        """The convex hull of ``vertices``: MuJoCo makes it of vertices that come without faces."""
        mesh = self._spec.add_mesh(
            name=f"mesh{next(self._numbers)}",
            uservert=vertices.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
        )
        return mesh.name

    def _height_field(self, field: HeightField) -> str:
        heights = np.asarray(field.heights, dtype=np.float64)
        span = max(float(np.ptp(heights)), 1e-6)
        asset = self._spec.add_hfield(
            name=f"height_field{len(self._spec.hfields)}",
            nrow=heights.shape[0],
            ncol=heights.shape[1],
            size=(field.size[0] / 2, field.size[1] / 2, span, _GROUND_DEPTH),
            userdata=((heights - heights.min()) / span).ravel(),
        )
        return asset.name


def geometry_approximations(shape: Shape, subject: str) -> list[Approximation]:
    """List the approximations in MuJoCo of a shape's geometry."""
    if not (isinstance(shape.geometry, Mesh) and shape.geometry.collision is MeshCollision.TRIANGLES):
        return []
    got = f"prisms that reach {1000 * PRISM_DEPTH:.0f} mm inward"
    return [Approximation(subject, "a surface of triangles", got, "MuJoCo's meshes are convex")]


def _wide_faces(mesh: Mesh) -> Iterator[tuple[FloatArray, FloatArray]]:
    """The flat faces (corners, 3) of a surface, with their outward normals; slivers are left out."""
    for face in convex_faces(mesh.vertices, mesh.faces):
        sides = np.roll(face, -1, axis=0) - face
        area = np.cross(face - face[0], sides).sum(0)
        if np.linalg.norm(area) > _LEAST_WIDTH * np.linalg.norm(sides, axis=-1).max():
            yield face, area / np.linalg.norm(area)
