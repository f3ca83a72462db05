"""A closed surface filled with tetrahedra, whose first nodes are the surface's vertices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import AssetError
from orbit_core.scene import Mesh

FloatArray = npt.NDArray[np.float64]
# Least volume of a tetrahedron, over that of a regular one with the same longest edge.
_FLATTEST = 0.1
# Least distance of an inner node from the surface's vertices, in mean edge lengths.
_INTERIOR = 0.6


def fill(mesh: Mesh, name: str) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Nodes (n, 3) and tetrahedra (t, 4): a Delaunay tessellation of the vertices and a lattice within.

    Raises:
        AssetError: the surface encloses nothing.
    """
    from scipy.spatial import Delaunay, KDTree

    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    edges = vertices[faces] - np.roll(vertices[faces], 1, axis=1)
    length = float(np.linalg.norm(edges, axis=-1).mean())
    lattice = _lattice(vertices.min(0), vertices.max(0), length)
    far = KDTree(vertices).query(lattice)[0] > _INTERIOR * length if len(lattice) else np.zeros(0, bool)
    inner = lattice[far]
    inner = inner[_inside(inner, vertices, faces)]
    nodes = np.concatenate((vertices, inner))
    cells = np.asarray(Delaunay(nodes).simplices, dtype=np.int64)
    corners = nodes[cells]
    spans = corners[:, 1:] - corners[:, :1]
    volumes = np.linalg.det(spans) / 6
    longest = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=-1).max(axis=(1, 2))
    solid = np.abs(volumes) > _FLATTEST * longest**3 / (6 * np.sqrt(2))
    solid &= _inside(corners.mean(1), vertices, faces)
    cells[volumes < 0] = cells[volumes < 0][:, [0, 2, 1, 3]]
    cells = cells[solid]
    if not len(cells):
        raise AssetError(f"the surface of soft body '{name}' encloses nothing: close it, with faces outwards")
    return nodes, cells


def volume_of(nodes: FloatArray, cells: npt.NDArray[np.int64]) -> float:
    """Cubic metres."""
    corners = nodes[cells]
    return float(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6)


def smallest_height(nodes: FloatArray, cells: npt.NDArray[np.int64]) -> float:
    """The shortest distance in metres from a corner to the face across, over all tetrahedra."""
    corners = nodes[cells]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    areas = [
        np.linalg.norm(np.cross(corners[:, b] - corners[:, a], corners[:, c] - corners[:, a]), axis=-1)
        for a, b, c in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))
    ]
    return float((volumes / np.max(areas, axis=0)).min())


def write_vtk(path: Path, nodes: FloatArray, cells: npt.NDArray[np.int64]) -> None:
    """Legacy VTK, as Bullet reads it."""
    lines = ["# vtk DataFile Version 2.0", "tetrahedra", "ASCII", "DATASET UNSTRUCTURED_GRID"]
    lines += [f"POINTS {len(nodes)} double", *(f"{x:.9g} {y:.9g} {z:.9g}" for x, y, z in nodes)]
    lines += [f"CELLS {len(cells)} {5 * len(cells)}", *(f"4 {a} {b} {c} {d}" for a, b, c, d in cells)]
    lines += [f"CELL_TYPES {len(cells)}", *(["10"] * len(cells))]
    path.write_text("\n".join(lines) + "\n")


def _lattice(lower: FloatArray, upper: FloatArray, spacing: float) -> FloatArray:
    axes = [np.arange(a + spacing / 2, b, spacing) for a, b in zip(lower, upper, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def _inside(points: FloatArray, vertices: FloatArray, faces: npt.NDArray[np.integer]) -> npt.NDArray[np.bool_]:
    """Return a mask of points inside, by the solid angle that the surface covers (van Oosterom and Strackee, 1983)."""
    arms = vertices[faces][None] - points[:, None, None]
    a, b, c = (arms[:, :, i] for i in range(3))
    la, lb, lc = (np.linalg.norm(arm, axis=-1) for arm in (a, b, c))
    triple = (a * np.cross(b, c)).sum(-1)
    below = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.arctan2(triple, below).sum(-1) > np.pi
