"""Whether surfaces can be touched and drawn: meshes and height fields of finite points, with some extent."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.divergence import MAX_DISTANCE
from orbit_core.interfaces.errors import ArgumentError
from orbit_core.interfaces.typed import wrong
from orbit_core.scene import HeightField, Mesh, MeshCollision, Shape

_FLAT = 1e-6
"""A mesh whose points spread less than this in a direction, relative to their widest, has no extent there."""


def check_mesh(mesh: Mesh, where: str) -> None:
    """Hold a mesh to finite points and to triangles of points that it has, not all on one line.

    Args:
        mesh: the mesh.
        where: its name, for the message.

    Raises:
        ArgumentError: it has no triangle, a point that is not finite or beyond 1e6 m, a triangle of a point that it
            lacks, or no area.
    """
    vertices, faces = mesh.vertices, mesh.faces
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.issubdtype(vertices.dtype, np.floating):
        raise ArgumentError(f"{where}.vertices are {vertices.dtype} of shape {vertices.shape}: give floats (V, 3)")
    if faces.ndim != 2 or faces.shape[1] != 3 or not np.issubdtype(faces.dtype, np.integer):
        raise ArgumentError(f"{where}.faces are {faces.dtype} of shape {faces.shape}: give whole numbers (F, 3)")
    if len(faces) == 0 or len(vertices) < 3:
        raise ArgumentError(f"{where} has {len(vertices)} vertices and {len(faces)} triangles: give it a surface")
    # A comparison with NaN is false, so what is not within the bounds is found, whatever it is.
    if not (vertices.min() >= -MAX_DISTANCE and vertices.max() <= MAX_DISTANCE):
        raise ArgumentError(f"{where} has a vertex that is not finite, or beyond {MAX_DISTANCE:g} m: mend it")
    if faces.min() < 0 or faces.max() >= len(vertices):
        culprit = int(faces.min() if faces.min() < 0 else faces.max())
        raise ArgumentError(
            f"{where} has a triangle of vertex {culprit}, and vertices 0 to {len(vertices) - 1}: mend its faces"
        )
    if extents(mesh.vertices) < 2:
        raise ArgumentError(f"{where} has all its vertices on one line: give it a surface")


def check_hulls(shapes: Iterable[Shape], where: str) -> None:
    """Hold meshes that collide as their convex hulls to hulls with a volume, and those with a field to be closed.

    Args:
        shapes: what collides; meshes among it have passed :func:`check_mesh`.
        where: the name of the shapes, for the message.

    Raises:
        ArgumentError: all points of a mesh lie in one plane, or a mesh that collides by distances is not closed.
    """
    for index, shape in enumerate(shapes):
        mesh, culprit = shape.geometry, f"{where}[{repr(shape.name) if shape.name else index}].geometry"
        if not isinstance(mesh, Mesh) or mesh.collision is MeshCollision.TRIANGLES:
            continue
        if extents(mesh.vertices) < 3:
            raise ArgumentError(
                f"{culprit} lies in a plane, so that its convex hull has no volume: give it thickness, or make it a "
                "thin box"
            )
        if mesh.collision is MeshCollision.SIGNED_DISTANCE and not _closed(mesh):
            raise ArgumentError(
                f"{culprit} is not closed, so that distances to it have no sign: close its surface, or have it collide "
                "otherwise"
            )


def check_height_field(field: HeightField, where: str) -> None:
    """Hold a height field to finite heights on at least two rows and columns, and a size above zero.

    Args:
        field: the height field.
        where: its name, for the message.

    Raises:
        ArgumentError: it is none.
    """
    heights = field.heights
    if heights.ndim != 2 or min(heights.shape) < 2:
        raise ArgumentError(f"{where}.heights have shape {heights.shape}: give at least two rows and two columns")
    if not (heights.min() >= -MAX_DISTANCE and heights.max() <= MAX_DISTANCE):
        raise ArgumentError(f"{where}.heights hold one that is not finite, or beyond {MAX_DISTANCE:g} m: mend it")
    if not all(1e-9 <= length <= MAX_DISTANCE for length in field.size):
        raise wrong(f"{where}.size", field.size, f"lengths of 1e-09 to {MAX_DISTANCE:g} m")


def _closed(mesh: Mesh) -> bool:
    """Whether each edge of a face is that of one other, the other way round."""
    edges = np.stack((mesh.faces, np.roll(mesh.faces, -1, axis=1)), -1).reshape(-1, 2)
    there, back = (np.unique(each, axis=0) for each in (edges, edges[:, ::-1]))
    return len(there) == len(edges) and np.array_equal(there, back)


def extents(points: npt.ArrayLike) -> int:
    """The number of directions, 0 to 3, in which points (V, 3) spread."""
    vertices = np.asarray(points, dtype=np.float64)
    centred = vertices - vertices.mean(axis=0)
    spreads = np.sqrt(np.maximum(np.linalg.eigvalsh(centred.T @ centred / len(centred)), 0.0))
    return int((spreads > max(_FLAT * spreads[-1], 1e-12)).sum())
