"""Collision shapes as PhysX's."""

# pyright: reportAttributeAccessIssue=false

# SAPIEN's stubs ask for shapes of arrays that NumPy's types cannot express.
# pyright: reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import Approximation, AssetError
from orbit_core.plugin_kit.meshes import height_field_mesh
from orbit_core.scene import Box, Capsule, Cylinder, HeightField, Mesh, MeshCollision, Plane, Pose, Shape, Sphere
from orbit_sapien.native import native_pose, physx

Z_TO_X = Pose((0.0, 0.0, 0.0), (math.sqrt(0.5), 0.0, -math.sqrt(0.5), 0.0))
"""PhysX's round shapes lie along x, and its plane looks along x."""
# Metres by which a cooked hull may differ from the one asked for before it is reported.
_TOLERATED = 1e-4
_UNSCALED = np.ones(3, np.float32)


def collision_shape(
    shape: Shape, material: physx.PhysxMaterial, subject: str, report: list[Approximation] | None
) -> physx.PhysxCollisionShape:
    """PhysX's shape, placed in its link; differences are added to ``report`` if given.

    Raises:
        AssetError: PhysX does not cook the shape; names it.
    """
    pose = shape.pose
    try:
        match shape.geometry:
            case Box(half_extents):
                made = physx.PhysxCollisionShapeBox(np.asarray(half_extents, np.float32), material)
            case Sphere(radius):
                made = physx.PhysxCollisionShapeSphere(radius, material)
            case Capsule(radius, half_length):
                made, pose = physx.PhysxCollisionShapeCapsule(radius, half_length, material), pose @ Z_TO_X
            case Cylinder(radius, half_length):
                made, pose = physx.PhysxCollisionShapeCylinder(radius, half_length, material), pose @ Z_TO_X
            case Plane():
                made, pose = physx.PhysxCollisionShapePlane(material), pose @ Z_TO_X
            case Mesh(collision=MeshCollision.CONVEX_HULL) as mesh:
                made = physx.PhysxCollisionShapeConvexMesh(mesh.vertices.astype(np.float32), _UNSCALED, material)
                if report is not None:
                    report += _hull_approximation(mesh.vertices, made, subject)
            case Mesh() as mesh:
                made = _surface(mesh.vertices, mesh.faces, material)
            case HeightField() as field:
                made = _surface(*height_field_mesh(field), material)
    except RuntimeError as error:
        what = (
            f"shape '{shape.name}' of {subject}" if shape.name else f"the {type(shape.geometry).__name__} of {subject}"
        )
        raise AssetError(f"PhysX cannot collide {what} ({error}): repair its mesh or replace it") from error
    made.set_local_pose(native_pose(pose))
    # PhysX adds the offsets of both shapes, so that each gets half of the pair's distance.
    if shape.contact_distance is not None:
        made.set_contact_offset(min(made.get_contact_offset(), 0.5 * shape.contact_distance))
    return made


def _surface(
    vertices: npt.NDArray[np.floating], faces: npt.NDArray[np.integer], material: physx.PhysxMaterial
) -> physx.PhysxCollisionShapeTriangleMesh:
    if not len(faces):  # of which PhysX would make an additional triangle
        raise RuntimeError("it has no triangles")
    return physx.PhysxCollisionShapeTriangleMesh(
        vertices.astype(np.float32), faces.astype(np.uint32), _UNSCALED, material
    )


def _hull_approximation(
    vertices: npt.NDArray[np.floating], made: physx.PhysxCollisionShapeConvexMesh, subject: str
) -> list[Approximation]:
    """Compare the cooked hull's support with the requested one, over directions spread evenly on the sphere."""
    # Fibonacci's spiral: equal areas for each direction, without the crowding of a grid at the poles.
    index = np.arange(256) + 0.5
    height, turn = 1 - index / 128, math.pi * (1 + math.sqrt(5)) * index
    width = np.sqrt(1 - height**2)
    directions = np.stack((width * np.cos(turn), width * np.sin(turn), height), -1)
    gap = np.abs((vertices @ directions.T).max(0) - (np.asarray(made.vertices) @ directions.T).max(0)).max()
    if gap <= _TOLERATED:
        return []
    got = f"a hull of {len(made.vertices)} vertices that differs by up to {1000 * gap:.2g} mm"
    return [Approximation(subject, f"the hull of {len(vertices)} vertices", got, "PhysX's cooking simplifies hulls")]
