"""Where things stand in a USD stage, and the shapes, surfaces and colours found there, in SI units with z up."""

from __future__ import annotations

import functools
import importlib
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import (
    Box,
    Capsule,
    Color,
    Compliance,
    Cylinder,
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

_TO_Z = {"X": Pose.from_euler(0.0, math.pi / 2, 0.0), "Y": Pose.from_euler(-math.pi / 2, 0.0, 0.0), "Z": Pose()}
"""The rotation that takes z to a prim's own axis."""
_SHEAR = 1e-4
"""Relative; stages hold most numbers in single precision."""


@functools.cache
def pxr() -> Any:
    """USD's package ``pxr``, which has no types, with the modules used here imported.

    Newton's schemas of joint friction, armature and mimic joints must register before USD first looks any schema up.

    Raises:
        AssetError: they are not installed.
    """
    try:
        importlib.import_module("newton_usd_schemas")
        for module in ("Gf", "Sdf", "Tf", "Usd", "UsdGeom", "UsdPhysics", "UsdSemantics", "UsdShade", "Vt"):
            importlib.import_module(f"pxr.{module}")
    except ImportError as error:
        raise AssetError(
            f'USD files need the packages usd-core and newton-usd-schemas: pip install "orbit-core[usd]" ({error})'
        ) from None
    return importlib.import_module("pxr")


def attribute(prim: Any, name: str, default: Any = None) -> Any:
    """The value of an attribute, or ``default`` where the prim has no such attribute or no value for it."""
    found = prim.GetAttribute(name)
    value = found.Get() if found else None
    return default if value is None else value


def label(prim: Any) -> str:
    """The name given to a prim: its display name, which may hold any characters, or else its name in the stage."""
    return prim.GetDisplayName() or prim.GetName()


@dataclass(frozen=True)
class Units:
    """A stage's units in SI, and the rotation that takes its up axis to z.

    Link frames turn with the stage, so that a link at rest in a y-up stage has its frame's z up here; whatever is fixed
    to a link is given in that frame.
    """

    length: float
    mass: float
    up: Pose

    @staticmethod
    def of(stage: Any) -> Units:
        """Those that a stage's metadata name."""
        upright = pxr().UsdGeom.GetStageUpAxis(stage) == pxr().UsdGeom.Tokens.z
        return Units(
            pxr().UsdGeom.GetStageMetersPerUnit(stage),
            pxr().UsdPhysics.GetStageKilogramsPerUnit(stage),
            Pose() if upright else Pose.from_euler(math.pi / 2, 0.0, 0.0),
        )

    def effort(self, angular: bool) -> float:
        """N m (angular) or N of one unit of effort."""
        return self.mass * self.length ** (2 if angular else 1)

    def inertia(self, angular: bool) -> float:
        """kg m^2 (angular) or kg of one unit of inertia."""
        return self.mass * (self.length**2 if angular else 1.0)

    def position(self, angular: bool) -> float:
        """Radians or metres of one unit of joint position."""
        return math.radians(1.0) if angular else self.length


@dataclass(frozen=True, eq=False)
class Placement:
    """A prim's pose in its link's frame, and the stretch (3, 3) of its own axes into metres."""

    pose: Pose
    stretch: FloatArray

    @staticmethod
    def of(prim: Any, body: Any, units: Units) -> Placement:
        """Of a prim that moves with the prim ``body``."""
        inverse = Pose.from_matrix(_rigid(_world_matrix(body, units.length))).inverse()
        matrix = _world_matrix(prim, units.length)
        rigid = _rigid(matrix)
        stretch = rigid[:3, :3].T @ matrix[:3, :3]
        return Placement(units.up @ inverse @ Pose.from_matrix(rigid), stretch)

    def point(self, position: Any) -> FloatArray:
        """A point (3,) of the prim's own space in the link's frame."""
        return self.pose.transform(self.stretch @ np.asarray(position, dtype=float))

    def frame(self, position: Any, rotation: Any) -> Pose:
        """A USD vector and quaternion of the prim's own space as a pose in the link's frame."""
        return self.pose @ Pose(_vector(self.stretch @ np.asarray(position, dtype=float)), _quaternion(rotation))

    def scale(self, prim: Any) -> FloatArray:
        """The stretch along each of the prim's axes (3,), without sign.

        Raises:
            AssetError: the prim is sheared.
        """
        scale = np.abs(np.diag(self.stretch))
        if np.abs(self.stretch - np.diag(np.diag(self.stretch))).max() > _SHEAR * scale.max():
            raise AssetError(f"{prim.GetPath()} is sheared by its transforms: only a mesh can be")
        return scale


def read_shape(prim: Any, body: Any, units: Units, notes: list[str]) -> Shape | None:
    """The shape of a geometric prim in its link's frame; ``None`` for a kind that holds no surface.

    Raises:
        AssetError: no engine has a shape like it.
    """
    placement = Placement.of(prim, body, units)
    kind = prim.GetTypeName()
    if kind == "Mesh":
        geometry: Geometry | None = _mesh(pxr().UsdGeom.Mesh(prim), placement, notes)
        pose = placement.pose
    else:
        geometry = _primitive(prim, kind, placement)
        pose = placement.pose @ _TO_Z[attribute(prim, "axis", "Z")]
    if geometry is None:
        return None
    return Shape(geometry, pose, read_material(prim, units), read_color(prim), label(prim))


def _primitive(prim: Any, kind: str, placement: Placement) -> Geometry | None:
    if kind == "Plane":
        return Plane()
    if kind not in ("Cube", "Sphere", "Capsule", "Cylinder"):
        return None
    scale = placement.scale(prim)
    if kind == "Cube":
        x, y, z = (float(value) for value in 0.5 * attribute(prim, "size") * scale)
        return Box((x, y, z))
    axis = "XYZ".index(attribute(prim, "axis", "Z"))
    round_axes = (0, 1, 2) if kind == "Sphere" else tuple(index for index in range(3) if index != axis)
    across = scale[list(round_axes)]
    # A capsule's round caps stay round only where it is scaled the same along all its axes.
    must_agree = scale if kind == "Capsule" else across
    if np.ptp(must_agree) > _SHEAR * scale.max():
        raise AssetError(f"{prim.GetPath()} is a {kind.lower()} scaled by {scale}: make it round, or a mesh")
    radius = float(attribute(prim, "radius") * across[0])
    if kind == "Sphere":
        return Sphere(radius)
    half_length = float(0.5 * attribute(prim, "height") * scale[axis])
    return Capsule(radius, half_length) if kind == "Capsule" else Cylinder(radius, half_length)


def _mesh(mesh: Any, placement: Placement, notes: list[str]) -> Mesh:
    prim = mesh.GetPrim()
    points = np.asarray(mesh.GetPointsAttr().Get() or (), dtype=float).reshape(-1, 3)
    counts = np.asarray(mesh.GetFaceVertexCountsAttr().Get() or (), dtype=int)
    indices = np.asarray(mesh.GetFaceVertexIndicesAttr().Get() or (), dtype=int)
    if len(points) == 0 or len(counts) == 0 or indices.max() >= len(points):
        raise AssetError(f"{prim.GetPath()} is a mesh without faces, or with faces of vertices that it lacks")
    faces = _triangles(counts, indices)
    mirrored = np.linalg.det(placement.stretch) < 0
    if mirrored != (mesh.GetOrientationAttr().Get() == "leftHanded"):
        faces = faces[:, ::-1]
    return Mesh(points @ placement.stretch.T, np.ascontiguousarray(faces), _mesh_collision(prim, notes))


def _triangles(counts: npt.NDArray[np.int_], indices: npt.NDArray[np.int_]) -> npt.NDArray[np.int_]:
    """Fans of triangles (F, 3) of polygons given one after another."""
    starts = np.cumsum(counts) - counts
    fans = np.maximum(counts - 2, 0)
    first = np.repeat(starts, fans)
    step = np.arange(fans.sum()) - np.repeat(np.cumsum(fans) - fans, fans)
    return indices[np.stack((first, first + step + 1, first + step + 2), axis=1)]


def _mesh_collision(prim: Any, notes: list[str]) -> MeshCollision:
    approximation = attribute(prim, "physics:approximation")
    if approximation == "none":
        return MeshCollision.TRIANGLES
    if approximation not in (None, "convexHull"):
        notes.append(f"{prim.GetPath()} asks for the collision approximation '{approximation}'; it has its convex hull")
    return MeshCollision.CONVEX_HULL


def read_material(prim: Any, units: Units) -> PhysicsMaterial:
    """The physics material bound to a prim; the default one where none is."""
    material, _ = pxr().UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
    if not material or not material.GetPrim().HasAPI(pxr().UsdPhysics.MaterialAPI):
        return PhysicsMaterial()
    source = material.GetPrim()
    read = PhysicsMaterial(
        static_friction=float(attribute(source, "physics:staticFriction")),
        dynamic_friction=float(attribute(source, "physics:dynamicFriction")),
        restitution=float(attribute(source, "physics:restitution")),
    )
    if "NewtonMaterialAPI" not in source.GetAppliedSchemas():
        return read
    stiffness = float(attribute(source, "newton:contactStiffness", -math.inf))
    damping = float(attribute(source, "newton:contactDamping", -math.inf))
    return replace(
        read,
        torsional_friction=float(attribute(source, "newton:torsionalFriction")) * units.length,
        rolling_friction=float(attribute(source, "newton:rollingFriction")) * units.length,
        compliance=Compliance(stiffness * units.mass, max(damping, 0.0) * units.mass) if stiffness > 0 else None,
    )


def read_color(prim: Any) -> Color:
    """A prim's display colour, or else the diffuse colour of the preview surface bound to it, or else grey."""
    gprim = pxr().UsdGeom.Gprim(prim)
    colors = gprim.GetDisplayColorPrimvar().Get()
    if colors:
        opacities = gprim.GetDisplayOpacityPrimvar().Get()
        return _color(colors[0], opacities[0] if opacities else 1.0)
    material, _ = pxr().UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
    surface = material.ComputeSurfaceSource()[0] if material else None
    if surface:
        diffuse, opacity = surface.GetInput("diffuseColor"), surface.GetInput("opacity")
        if diffuse and (value := diffuse.Get()) is not None:
            alpha = opacity.Get() if opacity else None
            return _color(value, 1.0 if alpha is None else alpha)
    return Shape(Plane()).color


def _color(rgb: Any, alpha: float) -> Color:
    red, green, blue = (float(value) for value in rgb)
    return (red, green, blue, float(alpha))


def _world_matrix(prim: Any, length: float) -> FloatArray:
    """The prim's transform (4, 4) in the stage, acting on columns, translation in metres."""
    if prim.IsPseudoRoot():
        return np.diag((length, length, length, 1.0))
    matrix = np.array(pxr().UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(pxr().Usd.TimeCode.Default())).T
    matrix[:3] *= length
    return matrix


def _rigid(matrix: FloatArray) -> FloatArray:
    """The nearest rigid transform: the rotation of the polar decomposition, and the translation."""
    u, _, vt = np.linalg.svd(matrix[:3, :3])
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
    # USD's way to say that principal axes are the body's own is a quaternion of zeros.
    return canonical(quaternion) if any(quaternion) else (1.0, 0.0, 0.0, 0.0)
