"""Collision shapes as PhysX's."""

# pyright: reportAttributeAccessIssue=false

# SAPIEN's stubs ask for shapes of arrays that NumPy's types cannot express.
# pyright: reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import Approximation, AssetError
from orbit_core.scene import Box, Capsule, Cylinder, HeightField, Mesh, MeshCollision, Plane, Pose, Shape, Sphere
from orbit_sapien.native import native_pose, physx

Z_TO_X = Pose((0.0, 0.0, 0.0), (math.sqrt(0.5), 0.0, -math.sqrt(0.5), 0.0))
"""PhysX's round shapes lie along x, and its plane looks along x."""
_TOLERATED = 1e-4
"""Metres by which a cooked hull may differ from the one asked for before it is reported."""
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
                vertices, faces = mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32)
                made = _surface(vertices, faces, material)
            case HeightField() as field:
                made = _surface(*height_field_triangles(field), material)
    except RuntimeError as error:
        what = (
            f"shape '{shape.name}' of {subject}" if shape.name else f"the {type(shape.geometry).__name__} of {subject}"
        )
        raise AssetError(f"PhysX cannot collide {what} ({error}): repair its mesh or replace it") from error
    made.set_local_pose(native_pose(pose))
    return made


def _surface(
    vertices: npt.NDArray[np.float32], faces: npt.NDArray[np.uint32], material: physx.PhysxMaterial
) -> physx.PhysxCollisionShapeTriangleMesh:
    if not len(faces):  # of which PhysX would make a triangle of its own
        raise RuntimeError("it has no triangles")
    return physx.PhysxCollisionShapeTriangleMesh(vertices, faces, _UNSCALED, material)


def height_field_triangles(field: HeightField) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
    """Vertices (V, 3) and faces (F, 3), two a cell, seen from above."""
    heights = np.asarray(field.heights, np.float32)
    rows, columns = heights.shape
    y, x = np.meshgrid(
        np.linspace(-field.size[1] / 2, field.size[1] / 2, rows),
        np.linspace(-field.size[0] / 2, field.size[0] / 2, columns),
        indexing="ij",
    )
    vertices = np.stack((x, y, heights), -1).reshape(-1, 3).astype(np.float32)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, above, across = corner + 1, corner + columns, corner + columns + 1
    faces = np.concatenate((np.stack((corner, right, across), -1), np.stack((corner, across, above), -1)))
    return vertices, faces.astype(np.uint32)


def _hull_approximation(
    vertices: npt.NDArray[np.floating], made: physx.PhysxCollisionShapeConvexMesh, subject: str
) -> list[Approximation]:
    """How far the cooked hull's support is from the one asked for, over directions spread evenly on the sphere."""
    index = np.arange(256) + 0.5
    height, turn = 1 - index / 128, math.pi * (1 + math.sqrt(5)) * index
    width = np.sqrt(1 - height**2)
    directions = np.stack((width * np.cos(turn), width * np.sin(turn), height), -1)
    gap = np.abs((vertices @ directions.T).max(0) - (np.asarray(made.vertices) @ directions.T).max(0)).max()
    if gap <= _TOLERATED:
        return []
    got = f"a hull of {len(made.vertices)} vertices that differs by up to {1000 * gap:.2g} mm"
    return [Approximation(subject, f"the hull of {len(vertices)} vertices", got, "PhysX's cooking simplifies hulls")]
