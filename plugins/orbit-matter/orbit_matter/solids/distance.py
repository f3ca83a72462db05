"""Signed distance to the surface of a solid at rest, on a lattice: by it points within the solid find the way out."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false, reportAttributeAccessIssue=false
# pyright: reportInvalidTypeForm=false
# Warp's arrays and structs carry their types at run time.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import warp as wp

from orbit_core.scene import SoftBody
from orbit_matter.solids.element import FloatArray
from orbit_matter.solids.grid import Embedding, cell_counts

_FINEST, _MOST = 8, 200_000
"""Spaces of the lattice along each edge of a cell, and points that it may have before they become fewer."""
_AROUND = 2
"""Spaces by which the lattice reaches beyond the solid: along an edge, distances inside have no slope."""


@dataclass(frozen=True, eq=False)
class Lattice:
    """Distances around one solid, in the frame of its mesh."""

    low: FloatArray
    """(3,) m, its first point."""
    spacing: FloatArray
    """(3,) m"""
    values: npt.NDArray[np.float32]
    """(X, Y, Z) m, negative inside."""


@wp.kernel(enable_backward=False)
def _measure(mesh: wp.uint64, points: wp.array[wp.vec3], farthest: float, found: wp.array[float]):
    i = wp.tid()
    # Winding numbers tell inside from outside at edges too, where the normals of faces disagree.
    query = wp.mesh_query_point_sign_winding_number(mesh, points[i], farthest)
    near = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
    found[i] = wp.length(points[i] - near) * query.sign


def lattice(spec: SoftBody, part: Embedding) -> Lattice:
    """Measure distances at points that divide the cells of a solid."""
    vertices = spec.rest_positions
    low, extent = vertices.min(axis=0), np.ptp(vertices, axis=0)
    counts = cell_counts(extent, spec.resolution)
    spaces = _FINEST
    while np.prod(spaces * counts + 1 + 2 * _AROUND) > _MOST and spaces > 2:
        spaces -= 1
    spacing = part.size / spaces
    low = low - _AROUND * spacing
    axes = [low[a] + spacing[a] * np.arange(spaces * counts[a] + 1 + 2 * _AROUND) for a in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return Lattice(low, spacing, distances(spec, points.reshape(-1, 3)).reshape(points.shape[:3]))


def distances(spec: SoftBody, points: FloatArray) -> npt.NDArray[np.float32]:
    """Return the distance to the surface of a solid, m, negative inside, of points (P, 3) in the frame of its mesh."""
    vertices = spec.rest_positions
    farthest = float(np.abs(points).max() + np.abs(vertices).max()) * 4.0
    with wp.ScopedDevice("cpu"):
        mesh = wp.Mesh(
            wp.array(vertices.astype(np.float32), dtype=wp.vec3),
            wp.array(np.asarray(spec.mesh.faces, np.int32).ravel(), dtype=int),
            support_winding_number=True,
        )
        found = wp.zeros(len(points), dtype=float)
        flat = wp.array(points.astype(np.float32), dtype=wp.vec3)
        wp.launch(_measure, len(flat), inputs=[mesh.id, flat, farthest, found])
        return np.array(found.numpy(), np.float32)
