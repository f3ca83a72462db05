"""Surface of a liquid as a mesh: a field around its particles, and a surface net of where it has a certain value."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.floating]

_CELL = 0.5
"""Spacings of the grid's cells."""
_REACH = 1.2
"""Spacings that a particle's share of the field reaches."""
_LEVEL = 0.4
"""Of the field where the surface is: a liquid of a thousand particles is drawn with its volume."""
_LIMIT = 2**20
"""Cells to each side of the first particle; what is further away is not drawn."""
_AROUND = np.array([(0, 0), (0, -1), (-1, -1), (-1, 0)])
"""The four cells around an edge, in the two axes across it."""


def liquid_surface(particles: FloatArray, spacing: float) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Return the surface of a liquid.

    Only cells near particles are held, so that drops which fly far apart cost no more than a pool (surface nets:
    Gibson, "Constrained elastic surface nets", 1998).

    Args:
        particles: (P, 3) m.
        spacing: metres between particles at rest.

    Returns:
        Vertices (V, 3) m and triangles (F, 3), counter-clockwise from outside.
    """
    particles = particles[np.isfinite(particles).all(axis=1)]
    if not len(particles):
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int64)
    cell, origin = _CELL * spacing, particles[0]
    nodes, field = _field((particles - origin) / cell, _REACH / _CELL)
    vertices: list[npt.NDArray[np.int64]] = []
    crossings: list[FloatArray] = []
    inward: list[npt.NDArray[np.bool_]] = []
    for axis in range(3):
        step = np.eye(3, dtype=np.int64)[axis]
        other = _values(nodes, field, nodes + step)
        crosses = (field > _LEVEL) != (other > _LEVEL)
        a, b, at = field[crosses], other[crosses], nodes[crosses]
        crossings.append(at + ((_LEVEL - a) / (b - a))[:, None] * step)
        across = np.zeros((4, 3), dtype=np.int64)
        across[:, [(axis + 1) % 3, (axis + 2) % 3]] = _AROUND
        vertices.append(at[:, None] + across)
        inward.append(a > b)
    cells, places = np.concatenate(vertices), np.concatenate(crossings)
    chosen, quads = np.unique(_keys(cells.reshape(-1, 3)), return_inverse=True)
    quads = quads.reshape(-1, 4)
    # A cell's vertex is the mean of where the surface crosses its edges.
    counts = np.bincount(quads.ravel(), minlength=len(chosen))[:, None]
    sums = [np.bincount(quads.ravel(), np.repeat(places[:, k], 4), minlength=len(chosen)) for k in range(3)]
    points = np.stack(sums, axis=1) / np.maximum(counts, 1)
    quads[~np.concatenate(inward)] = quads[~np.concatenate(inward)][:, ::-1]
    faces = np.concatenate((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]))[:, ::-1]
    return (points * cell + origin).astype(np.float32), faces


def _field(particles: FloatArray, reach: float) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Return nodes (K, 3) near particles (P, 3), in cells and in the order of their keys, and the field (K,) there."""
    near = particles[(np.abs(particles) < _LIMIT - 8).all(axis=1)]
    wide = int(np.ceil(reach))
    offsets = np.stack(np.meshgrid(*[np.arange(-wide, wide + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    nodes = np.rint(near).astype(np.int64)[:, None] + offsets
    share = np.maximum(1.0 - ((nodes - near[:, None]) ** 2).sum(axis=-1) / reach**2, 0.0) ** 3
    kept = share > 0.0
    keys, index = np.unique(_keys(nodes[kept]), return_inverse=True)
    return _nodes(keys), np.bincount(index, share[kept], minlength=len(keys)).astype(np.float64)


def _values(nodes: npt.NDArray[np.int64], field: FloatArray, wanted: npt.NDArray[np.int64]) -> FloatArray:
    """Return the field at wanted nodes; zero where there is none."""
    keys, asked = _keys(nodes), _keys(wanted)
    found = np.minimum(np.searchsorted(keys, asked), len(keys) - 1)
    return np.where(keys[found] == asked, field[found], 0.0)


def _keys(nodes: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    x, y, z = (nodes + _LIMIT).T
    return (x << 42) + (y << 21) + z


def _nodes(keys: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    low = 2**21 - 1
    return np.stack((keys >> 42, (keys >> 21) & low, keys & low), axis=1) - _LIMIT
