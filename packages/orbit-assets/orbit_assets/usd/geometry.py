"""Poses, shapes, physics materials and looks of USD prims, in SI units with z up."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_assets.meshes import textured_mesh
from orbit_assets.urdf.reader import is_sizeless
from orbit_assets.usd.appearance import Picture, Pictures, corner_coordinates, finish_of
from orbit_assets.usd.contents import STAGE
from orbit_assets.usd.library import pxr
from orbit_assets.usd.stage import Reading, Units, applies, array, attribute, axis, label, number
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import (
    Box,
    Capsule,
    Color,
    Compliance,
    Cylinder,
    Finish,
    Geometry,
    Mesh,
    MeshCollision,
    PhysicsMaterial,
    Plane,
    Pose,
    Shape,
    Sphere,
)
from orbit_core.scene.pose import FloatArray, Quaternion, Vector3, canonical
from orbit_core.scene.shapes import DULL


class Surfaces:
    """Materials of the geometry of one stage, resolved together, which is faster than one by one."""

    def __init__(self, reading: Reading, gprims: list[Any]) -> None:
        self._reading = reading
        paths = [str(prim.GetPath()) for prim in gprims]
        bound = pxr().UsdShade.MaterialBindingAPI.ComputeBoundMaterials
        self._physics = dict(zip(paths, bound(gprims, "physics")[0], strict=True)) if gprims else {}
        self._drawn = dict(zip(paths, bound(gprims, "")[0], strict=True)) if gprims else {}
        self._pictures = Pictures(reading)

    def material(self, prim: Any) -> PhysicsMaterial:
        """Return the physics material bound to a prim; the default one where none is."""
        source = self.physics_prim(prim)
        if source is None or not source.HasAPI(pxr().UsdPhysics.MaterialAPI):
            return PhysicsMaterial()
        self._note_combination(source)
        units = self._reading.units
        read = PhysicsMaterial(
            static_friction=number(source, "physics:staticFriction"),
            dynamic_friction=number(source, "physics:dynamicFriction"),
            restitution=number(source, "physics:restitution"),
        )
        if "NewtonMaterialAPI" not in source.GetAppliedSchemas():
            return read
        stiffness = number(source, "newton:contactStiffness", -math.inf)
        damping = number(source, "newton:contactDamping", -math.inf)
        read = replace(
            read,
            torsional_friction=number(source, "newton:torsionalFriction") * units.length,
            rolling_friction=number(source, "newton:rollingFriction") * units.length,
            compliance=Compliance(stiffness * units.mass, max(damping, 0.0) * units.mass) if stiffness > 0 else None,
        )
        return self._as_mujoco(prim, read) if applies(prim, "MjcCollisionAPI") else read

    def _as_mujoco(self, prim: Any, material: PhysicsMaterial) -> PhysicsMaterial:
        """Return the material of a collider with MuJoCo's schema: ``condim`` selects the directions of friction.

        Newton's attribute for stiffness then holds MuJoCo's ``solref``, which is in proportion to the mass in contact
        and no
        stiffness of the material.
        """
        if material.compliance is not None:
            self._reading.note("the softness of contacts (solref) of colliders with MuJoCo's schema is left out")
        dimensions = int(number(prim, "mjc:condim", 3.0))
        return PhysicsMaterial(
            static_friction=material.static_friction if dimensions >= 3 else 0.0,
            dynamic_friction=material.dynamic_friction if dimensions >= 3 else 0.0,
            restitution=material.restitution,
            torsional_friction=material.torsional_friction if dimensions >= 4 else 0.0,
            rolling_friction=material.rolling_friction if dimensions >= 6 else 0.0,
        )

    def physics_prim(self, prim: Any) -> Any:
        """Return the material prim of the prim's surface and substance; None without one."""
        material = self._physics.get(str(prim.GetPath()))
        return material.GetPrim() if material else None

    def _note_combination(self, source: Any) -> None:
        for what in ("friction", "restitution"):
            # Engines combine two surfaces in different ways: the contract of ORBIT is the larger value.
            mode = attribute(source, f"physxMaterial:{what}CombineMode")
            if mode not in (None, "max"):
                self._reading.note(
                    f"{source.GetPath()} combines {what} of two surfaces by '{mode}'; everywhere the larger counts"
                )

    def color(self, prim: Any) -> Color:
        """Return a prim's display colour, else the diffuse colour of its preview surface, else grey."""
        gprim = pxr().UsdGeom.Gprim(prim)
        if colors := gprim.GetDisplayColorPrimvar().Get():
            opacities = gprim.GetDisplayOpacityPrimvar().Get()
            if len(colors) > 1:
                self._reading.note(f"{prim.GetPath()} has {len(colors)} colours and is drawn in the first")
            return _color(colors[0], opacities[0] if opacities else 1.0)
        surface = self._surface(prim)
        return _surface_color(surface) if surface else Shape(Plane()).color

    def finish(self, prim: Any) -> tuple[Finish, Picture | None]:
        """Return a prim's roughness and metallic share, and the picture on it.

        Raises:
            AssetError: the picture's file is where the model may not read, or no picture, or too large.
        """
        surface = self._surface(prim)
        return (finish_of(surface), self._pictures.of(surface)) if surface else (DULL, None)

    def _surface(self, prim: Any) -> Any:
        material = self._drawn.get(str(prim.GetPath()))
        return material.ComputeSurfaceSource()[0] if material else None


def _surface_color(surface: Any) -> Color:
    for name in ("diffuseColor", "diffuse_color_constant"):
        found = surface.GetInput(name)
        if found and (value := found.Get()) is not None:
            opacity = surface.GetInput("opacity")
            alpha = opacity.Get() if opacity else None
            return _color(value, 1.0 if alpha is None else alpha)
    return Shape(Plane()).color


def _color(rgb: Any, alpha: float) -> Color:
    red, green, blue = (float(value) for value in rgb)
    return (red, green, blue, float(alpha))


UNNAMED = "orbit:unnamed"
"""Attribute that marks a shape without a name, for every prim has one."""
# Rotations that take z to a prim's own axis.
_TO_Z = {"X": Pose.from_euler(0.0, math.pi / 2, 0.0), "Y": Pose.from_euler(-math.pi / 2, 0.0, 0.0), "Z": Pose()}
# Sides of the pyramid that replaces a cone.
_SIDES = 32
# Relative tolerance of shear; stages hold most numbers in single precision.
_SHEAR = 1e-4


@dataclass(frozen=True, eq=False)
class Placement:
    """A prim's pose in its link's frame, and the stretch (3, 3) of its axes into metres."""

    pose: Pose
    """Rotation and translation, m."""
    stretch: FloatArray
    """(3, 3) scale and shear, with the unit of length."""

    def point(self, position: Any) -> FloatArray:
        """Return a point (3,) of the prim's own space in the link's frame."""
        return self.pose.transform(self.stretch @ np.asarray(position, dtype=float))

    def frame(self, position: Any, rotation: Any) -> Pose:
        """Return a USD vector and quaternion of the prim's own space as a pose in the link's frame."""
        return self.pose @ Pose(_vector(self.stretch @ np.asarray(position, dtype=float)), _quaternion(rotation))

    def scale(self, prim: Any) -> FloatArray:
        """Return the stretch along each of the prim's axes (3,), without sign.

        Raises:
            AssetError: the prim is sheared.
        """
        scale = np.abs(np.diag(self.stretch))
        if np.abs(self.stretch - np.diag(np.diag(self.stretch))).max() > _SHEAR * scale.max():
            raise AssetError(f"{prim.GetPath()} is sheared by its transforms: only a mesh can be")
        return scale


class Placements:
    """Poses of the prims of a stage; each body's is computed once."""

    def __init__(self, units: Units) -> None:
        self._units = units
        self._cache = pxr().UsdGeom.XformCache(pxr().Usd.TimeCode.Default())
        self._bodies: dict[str, Pose] = {}
        self._inverses: dict[str, Pose] = {}

    def of(self, prim: Any, body: Any) -> Placement:
        """Return the pose of a prim that moves with the prim ``body``."""
        matrix = self._matrix(prim)
        rigid = _rigid(matrix)
        stretch = rigid[:3, :3].T @ matrix[:3, :3]
        path = str(body.GetPath())
        if path not in self._inverses:
            self._inverses[path] = self._units.up @ self._body(body).inverse()
        return Placement(self._inverses[path] @ Pose.from_matrix(rigid), stretch)

    def root(self, body: Any) -> Pose:
        """Return the pose of a body's link frame in the world, z up."""
        up = self._units.up
        return up @ self._body(body) @ up.inverse()

    def _body(self, body: Any) -> Pose:
        path = str(body.GetPath())
        if path not in self._bodies:
            self._bodies[path] = Pose.from_matrix(_rigid(self._matrix(body))) if path != STAGE else Pose()
        return self._bodies[path]

    def _matrix(self, prim: Any) -> FloatArray:
        """Return the prim's transform (4, 4) in the stage, acting on columns, translation in metres."""
        length = self._units.length
        if prim.IsPseudoRoot():
            return np.diag((length, length, length, 1.0))
        try:
            # USD's matrices act on rows.
            matrix = np.array(self._cache.GetLocalToWorldTransform(prim)).T
        except pxr().Tf.ErrorException as error:
            raise AssetError(f"{prim.GetPath()} has a transform that USD cannot work out: {error}") from None
        matrix[:3] *= length
        if not np.isfinite(matrix).all():
            raise AssetError(f"{prim.GetPath()} has a transform that is not finite: correct it")
        return matrix


APPROXIMATIONS = {
    "none": MeshCollision.TRIANGLES,
    "convexHull": MeshCollision.CONVEX_HULL,
    "convexDecomposition": MeshCollision.CONVEX_DECOMPOSITION,
    "sdf": MeshCollision.SIGNED_DISTANCE,  # of PhysX' schema
}
"""Collision shapes by USD's name of a collision approximation."""


class Shapes:
    """Reader of the geometry of one stage."""

    def __init__(self, reading: Reading, placements: Placements, gprims: list[Any]) -> None:
        self._reading = reading
        self._placements = placements
        self.surfaces = Surfaces(reading, gprims)
        """Reader of materials and colours."""

    def read(self, prim: Any, body: Any, *, collides: bool) -> Shape | None:
        """Return the shape of a geometric prim in its link's frame; None for a kind without a surface.

        Raises:
            AssetError: no engine has a shape like it.
        """
        placement = self._placements.of(prim, body)
        kind = prim.GetTypeName()
        if kind == "Mesh":
            geometry: Geometry | None = self._mesh(prim, placement, collides)
            pose = placement.pose
        elif kind == "Cone":
            geometry, pose = _cone(prim, placement), placement.pose
            self._reading.note(f"{prim.GetPath()} is a cone and is read as a pyramid of {_SIDES} sides")
        else:
            geometry = _primitive(prim, kind, placement)
            pose = placement.pose @ _TO_Z[axis(prim)]
        if geometry is None:
            return None
        if not collides and is_sizeless(geometry):
            self._reading.note(f"{prim.GetPath()} is drawn with size zero, which shows nothing, and is left out")
            return None
        name = "" if attribute(prim, UNNAMED, False) else label(prim)
        shape = Shape(geometry, pose, self.surfaces.material(prim), self.surfaces.color(prim), name)
        return self._finished(prim, shape, placement)

    def _finished(self, prim: Any, shape: Shape, placement: Placement) -> Shape:
        """Return a shape in its material's finish, a mesh with the coordinates of its picture."""
        finish, picture = self.surfaces.finish(prim)
        if picture is None:
            return shape if finish == DULL else replace(shape, finish=finish)
        color = picture.tint or (1.0, 1.0, 1.0, shape.color[3])
        if picture.laid:
            return replace(shape, color=color, finish=replace(finish, texture=picture.texture))
        geometry = shape.geometry
        corners = self._corners(prim, placement) if isinstance(geometry, Mesh) else None
        points = array(prim, "faceVertexIndices", 1, int)[corners] if corners is not None else None
        laid = (
            corner_coordinates(prim, picture, points, corners) if corners is not None and points is not None else None
        )
        if laid is None or not isinstance(geometry, Mesh):
            self._reading.note(f"{prim.GetPath()} has no coordinates on its picture, and its colour in place of it")
            return replace(shape, finish=finish)
        mesh = replace(textured_mesh(np.asarray(geometry.vertices)[points], laid), collision=geometry.collision)
        return replace(shape, geometry=mesh, color=color, finish=replace(finish, texture=picture.texture))

    def _corners(self, prim: Any, placement: Placement) -> npt.NDArray[np.int_]:
        """Return (F, 3) the corners of a mesh's triangles, among those of all its polygons, as they face outward."""
        counts, indices = (array(prim, name, 1, int) for name in ("faceVertexCounts", "faceVertexIndices"))
        corners = _triangles(counts, np.arange(len(indices)))
        # A mirrored mesh and a left-handed one each turn the faces over; both together do not.
        mirrored = np.linalg.det(placement.stretch) < 0
        return corners[:, ::-1] if mirrored != (attribute(prim, "orientation") == "leftHanded") else corners

    def _mesh(self, prim: Any, placement: Placement, collides: bool) -> Mesh:
        points = array(prim, "points", 3, float)
        counts = array(prim, "faceVertexCounts", 1, int)
        indices = array(prim, "faceVertexIndices", 1, int)
        most = self._reading.options.limits.vertices
        if max(len(points), len(indices)) > most:
            raise AssetError(f"{prim.GetPath()} has over {most} vertices: simplify it, or raise ReadLimits.vertices")
        if len(counts) and (counts.min() < 0 or counts.sum(dtype=float) != len(indices)):
            raise AssetError(
                f"{prim.GetPath()} has faces of {counts.sum(dtype=float):g} corners in all and names {len(indices)}: "
                "export it again"
            )
        if len(points) == 0 or len(indices) == 0 or indices.min() < 0 or indices.max() >= len(points):
            raise AssetError(f"{prim.GetPath()} is a mesh without faces, or with faces of vertices that it lacks")
        faces = indices[self._corners(prim, placement)]
        collision = self._collision(prim) if collides else MeshCollision.CONVEX_HULL
        return Mesh(points @ placement.stretch.T, np.ascontiguousarray(faces), collision)

    def _collision(self, prim: Any) -> MeshCollision:
        approximation = attribute(prim, "physics:approximation")
        if approximation in APPROXIMATIONS:
            return APPROXIMATIONS[approximation]
        if approximation is not None:
            self._reading.note(
                f"{prim.GetPath()} asks for the collision approximation '{approximation}'; it has its convex hull"
            )
        return MeshCollision.CONVEX_HULL


def _primitive(prim: Any, kind: str, placement: Placement) -> Geometry | None:
    if kind == "Plane":
        return Plane()
    if kind not in ("Cube", "Sphere", "Capsule", "Cylinder"):
        return None
    scale = placement.scale(prim)
    if kind == "Cube":
        x, y, z = (float(value) for value in 0.5 * number(prim, "size") * scale)
        return Box((x, y, z))
    along = "XYZ".index(axis(prim))
    round_axes = (0, 1, 2) if kind == "Sphere" else tuple(index for index in range(3) if index != along)
    across = scale[list(round_axes)]
    # A capsule's round caps stay round only where it is scaled the same along all its axes.
    must_agree = scale if kind == "Capsule" else across
    if np.ptp(must_agree) > _SHEAR * scale.max():
        raise AssetError(f"{prim.GetPath()} is a {kind.lower()} scaled by {scale}: make it round, or a mesh")
    radius = float(number(prim, "radius") * across[0])
    if kind == "Sphere":
        return Sphere(radius)
    half_length = float(0.5 * number(prim, "height") * scale[along])
    return Capsule(radius, half_length) if kind == "Capsule" else Cylinder(radius, half_length)


def _cone(prim: Any, placement: Placement) -> Mesh:
    """Build a pyramid of the same volume in place of a cone."""
    turn = 2.0 * np.pi / _SIDES
    # A regular polygon of N sides has the area N/2 r^2 sin(2 pi/N): the radius grows so that it equals the circle's.
    radius = number(prim, "radius") * math.sqrt(turn / math.sin(turn))
    half = 0.5 * number(prim, "height")
    angles = turn * np.arange(_SIDES)
    rim = np.stack((radius * np.cos(angles), radius * np.sin(angles), np.full(_SIDES, -half)), axis=1)
    points = _TO_Z[axis(prim)].transform(np.concatenate((rim, [(0.0, 0.0, half), (0.0, 0.0, -half)])))
    first, following = np.arange(_SIDES), np.roll(np.arange(_SIDES), -1)
    tip, centre = np.full(_SIDES, _SIDES), np.full(_SIDES, _SIDES + 1)
    faces = np.concatenate((np.stack((first, following, tip), 1), np.stack((following, first, centre), 1)))
    mirrored = np.linalg.det(placement.stretch) < 0
    return Mesh(points @ placement.stretch.T, np.ascontiguousarray(faces[:, ::-1] if mirrored else faces))


def _triangles(counts: npt.NDArray[np.int_], indices: npt.NDArray[np.int_]) -> npt.NDArray[np.int_]:
    """Split polygons given one after another into fans of triangles (F, 3)."""
    starts = np.cumsum(counts) - counts
    fans = np.maximum(counts - 2, 0)
    first = np.repeat(starts, fans)
    step = np.arange(fans.sum()) - np.repeat(np.cumsum(fans) - fans, fans)
    return indices[np.stack((first, first + step + 1, first + step + 2), axis=1)]


def _rigid(matrix: FloatArray) -> FloatArray:
    """Return the nearest rigid transform: the rotation of the polar decomposition, and the translation."""
    rotation = matrix[:3, :3]
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > 1e-12:  # no rotation yet
        u, _, vt = np.linalg.svd(rotation)
        rotation = u @ vt
    result = matrix.copy()
    result[:3, :3] = rotation if np.linalg.det(rotation) > 0 else -rotation
    return result


def _vector(values: FloatArray) -> Vector3:
    x, y, z = (float(value) for value in values)
    return (x, y, z)


def _quaternion(rotation: Any) -> Quaternion:
    x, y, z = (float(value) for value in rotation.GetImaginary())
    quaternion = (float(rotation.GetReal()), x, y, z)
    # USD writes a quaternion of zeros for principal axes that are the body's own.
    return canonical(quaternion) if any(quaternion) else (1.0, 0.0, 0.0, 0.0)
