"""A closed surface embedded in a coarse grid of cells: no mesher, and as few unknowns as the shape needs.

Cells that the surface cuts have the stiffness and the mass of what is inside of them. Vertices of the surface, and the
points of its contact, follow the nodes of the cell that they are in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import ConfigurationError
from orbit_core.plugin_kit.closed_surfaces import inside_lattice
from orbit_core.scene import SoftBody
from orbit_matter.solids import element, skin
from orbit_matter.solids.element import NODES, FloatArray

IntArray = npt.NDArray[np.int32]
SAMPLES = 6
"""Along each edge of a cell, by which what is inside of it is found; even, so that octants have whole ones."""
LEAST_FILL = 0.02
"""Part of its stiffness and mass that a cell has at least, so that no node of a cell with a vertex is left loose."""
MOST_UNKNOWNS = 6000
"""Of one solid: its dense inverse then takes 144 MB."""


@dataclass(frozen=True, eq=False)
class Sites:
    """Points that move with a solid."""

    cells: IntArray
    """(S,) cell that each is in."""
    weights: FloatArray
    """(S, 27) of the cell's nodes."""
    areas: FloatArray
    """(S, 3, 3) m^2 of the surface around each, as of :class:`~orbit_matter.solids.skin.Skin`."""


@dataclass(frozen=True, eq=False)
class Embedding:
    """The cells of one solid at rest, in the frame of its mesh."""

    size: FloatArray
    """(3,) edges of a cell, m."""
    cells: IntArray
    """(C, 27) nodes."""
    kinds: IntArray
    """(C,) row of each cell in ``stiffness``."""
    stiffness: FloatArray
    """(K, 81, 81) N/m; whole cells share the first."""
    nodes: FloatArray
    """(n, 3) m."""
    masses: FloatArray
    """(n,) kg"""
    contacts: Sites
    """Points of the surface that meet other things."""
    vertices: Sites
    """Vertices of the mesh, which are shown, measured and held."""
    between: Sites
    """Points of triangles that span several nodes, which are held where all vertices around them are."""
    corners: IntArray
    """(between, 3) vertices around each of these points; of a point of an edge one of them twice."""

    def assembled(self) -> FloatArray:
        """Return the stiffness matrix of the whole solid, (3 n, 3 n), N/m."""
        count = 3 * len(self.nodes)
        found = np.zeros((count, count))
        for nodes, kind in zip(self.cells, self.kinds, strict=True):
            rows = (3 * nodes[:, None] + np.arange(3)).ravel()
            found[np.ix_(rows, rows)] += self.stiffness[kind]
        return found

    def weights_of(self, sites: Sites) -> FloatArray:
        """Return the weights of all nodes at sites, (S, n)."""
        found = np.zeros((len(sites.cells), len(self.nodes)))
        np.add.at(found, (np.arange(len(sites.cells))[:, None], self.cells[sites.cells]), sites.weights)
        return found


def embed(spec: SoftBody) -> Embedding:
    """Embed a solid in a grid along the axes of its mesh.

    Raises:
        ConfigurationError: the grid has too many nodes, or its cells do not hang together.
    """
    vertices, faces = spec.rest_positions, np.asarray(spec.mesh.faces, dtype=np.int64)
    low, extent = vertices.min(axis=0), np.ptp(vertices, axis=0)
    counts = cell_counts(extent, spec.resolution)
    _check_count(spec, counts, extent)
    size = extent / counts
    surface = skin.sampled(vertices, faces, 0.25 * float(size.min()))
    corners, shares = _between(vertices, faces, 0.5 * size)
    inside = _inside(vertices, faces, low, size, counts)
    fills = inside.mean(axis=(3, 4, 5))
    spanned = np.einsum("pk,pkc->pc", shares, vertices[corners])
    places = np.concatenate((surface.points, vertices, spanned))
    index = np.clip(np.floor((places - low) / size).astype(np.int64), 0, counts - 1)
    # A cell that holds a vertex is kept even where none of its samples is inside.
    needed = np.zeros(counts, dtype=bool)
    needed[tuple(index.T)] = True
    chosen = np.argwhere((fills > 0.0) | needed)
    numbers = np.full(counts, -1, np.int32)
    numbers[tuple(chosen.T)] = np.arange(len(chosen))
    cells, nodes = _numbered(chosen, counts, low, size)
    _check_whole(spec, cells)
    kinds, stiffness, masses = _properties(spec, size, cells, len(nodes), inside[tuple(chosen.T)])
    # Samples and the least fill are off by a few per cent; the weight is not.
    masses *= spec.mass / masses.sum()
    local = 2.0 * ((places - low) / size - index) - 1.0
    weights, owners = element.shape_functions(local), numbers[tuple(index.T)]
    parts = (surface.areas, np.zeros((len(vertices), 3, 3)), np.zeros((len(spanned), 3, 3)))
    ends = np.cumsum([len(areas) for areas in parts])[:-1]
    sites = zip(np.split(owners, ends), np.split(weights, ends), parts, strict=True)
    contacts, held, between = (Sites(*each) for each in sites)
    return Embedding(size, cells, kinds, stiffness, nodes, masses, contacts, held, between, corners)


def _between(vertices: FloatArray, faces: npt.NDArray[np.int64], most: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return points of triangles longer than ``most`` (3,) m along an axis: vertices (P, 3) and their shares (P, 3).

    A triangle whose vertices alone are held leaves the nodes between them free, by which a solid that hangs by the
    corners of its cells sags forty times too deep.
    """
    found: dict[tuple[tuple[int, float], ...], tuple[IntArray, FloatArray]] = {}
    lengths = np.abs(vertices[faces] - np.roll(vertices[faces], 1, axis=1)) / most
    parts = np.ceil(lengths.max(axis=(1, 2)) - 1e-6).astype(np.int64)
    for corners, count in zip(faces, parts.tolist(), strict=True):
        for a in range(count + 1):
            for b in range(count + 1 - a):
                shares = np.array([a, b, count - a - b]) / count
                if (shares > 0.0).sum() < 2:
                    continue
                # Points of an edge are shared by two triangles, and are of its two vertices only.
                around = np.where(shares > 0.0, corners, corners[int(shares.argmax())])
                key = tuple(sorted((int(c), round(s, 9)) for c, s in zip(corners, shares, strict=True) if s > 0.0))
                found[key] = (around.astype(np.int32), shares)
    if not found:
        return np.zeros((0, 3), np.int32), np.zeros((0, 3))
    around, shares = zip(*found.values(), strict=True)
    return np.stack(around), np.stack(shares)


def cell_counts(extent: FloatArray, resolution: float | None) -> npt.NDArray[np.int64]:
    """Return the cells along each axis of a solid.

    Args:
        extent: of its box (3,), m.
        resolution: longest edge of a cell, m. None takes half the least extent or a quarter of the largest, the
            longer of both: a beam has a row of four cells, a block two along each edge.
    """
    if resolution is None:
        longest = max(0.5 * float(extent.min()), 0.25 * float(extent.max()))
        return np.maximum(1, np.round(extent / longest - 1e-6)).astype(np.int64)
    return np.maximum(1, np.ceil(extent / resolution - 1e-6)).astype(np.int64)


def _check_count(spec: SoftBody, counts: npt.NDArray[np.int64], extent: FloatArray) -> None:
    unknowns = 3 * int(np.prod(2 * counts + 1))
    if unknowns > MOST_UNKNOWNS:
        would = float((extent / counts).max())
        while 3 * int(np.prod(2 * cell_counts(extent, float(f"{would:.2g}")) + 1)) > MOST_UNKNOWNS:
            would *= 1.02
        raise ConfigurationError(
            f"soft body '{spec.name}' would have {unknowns} unknowns in {' x '.join(map(str, counts))} cells, and "
            f"{MOST_UNKNOWNS} is the most that is computed: a resolution of {would:.2g} m would do"
        )


def _check_whole(spec: SoftBody, cells: IntArray) -> None:
    """Refuse pieces that share no node: one rotation and one preconditioner are no good for both, and they diverge."""
    piece = np.arange(len(cells))
    lowest = np.full(int(cells.max()) + 1, len(cells))
    while True:
        # Each cell takes the lowest number among those that it shares a node with, until none changes.
        np.minimum.at(lowest, cells, piece[:, None])
        joined = lowest[cells].min(axis=1)
        if (joined == piece).all():
            break
        piece = joined
    count = len(np.unique(piece))
    if count > 1:
        raise ConfigurationError(
            f"the mesh of soft body '{spec.name}' is of {count} pieces that do not touch each other: make each a "
            "SoftBody, or give it a resolution so large that they share cells"
        )


def _inside(
    vertices: FloatArray, faces: npt.NDArray[np.int64], low: FloatArray, size: FloatArray, counts: npt.NDArray[np.int64]
) -> npt.NDArray[np.bool_]:
    """Return which samples of each cell are inside, (X, Y, Z, s, s, s) along x, y and z."""
    steps = SAMPLES * counts
    axes = [low[a] + size[a] / SAMPLES * (np.arange(steps[a]) + 0.5) for a in range(3)]
    found = inside_lattice(axes, vertices, faces)
    blocks = found.reshape(counts[0], SAMPLES, counts[1], SAMPLES, counts[2], SAMPLES)
    return blocks.transpose(0, 2, 4, 1, 3, 5)


def _numbered(
    chosen: npt.NDArray[np.int64], counts: npt.NDArray[np.int64], low: FloatArray, size: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return the nodes (C, 27) of cells (C, 3), and the positions of all nodes that are used."""
    offsets = (element.places() + 1.0).astype(np.int64)
    lattice = 2 * chosen[:, None] + offsets
    span = 2 * counts + 1
    keys = (lattice[..., 2] * span[1] + lattice[..., 1]) * span[0] + lattice[..., 0]
    used, cells = np.unique(keys, return_inverse=True)
    x, y, z = used % span[0], used // span[0] % span[1], used // (span[0] * span[1])
    nodes = low + 0.5 * size * np.stack((x, y, z), axis=-1)
    return cells.reshape(-1, NODES).astype(np.int32), nodes


def _properties(
    spec: SoftBody, size: FloatArray, cells: IntArray, count: int, inside: npt.NDArray[np.bool_]
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the row of each cell in the stiffness matrices, these, and shares of the mass of all nodes."""
    material = element.elasticity(spec.youngs_modulus, spec.poissons_ratio)
    whole = element.stiffness(size, material, *element.quadrature())
    line = (2.0 * np.arange(SAMPLES) + 1.0) / SAMPLES - 1.0
    samples = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    even = element.mass_shares(samples)
    matrices, kinds, masses = [whole], np.zeros(len(cells), np.int32), np.zeros(count)
    for number, within in enumerate(inside):
        fill = float(within.mean())
        # Of an emptier cell the samples are too few to say where its mass is.
        shares = even
        if fill < 1.0:
            halves = within.reshape(2, SAMPLES // 2, 2, SAMPLES // 2, 2, SAMPLES // 2).mean(axis=(1, 3, 5))
            cut = element.stiffness(size, material, *element.quadrature(halves.transpose(2, 1, 0).ravel()))
            kinds[number] = len(matrices)
            matrices.append(cut + max(0.0, LEAST_FILL - fill) * whole)
            if fill > LEAST_FILL:
                shares = element.mass_shares(samples[within.ravel()])
        masses[cells[number]] += max(fill, LEAST_FILL) * shares
    return kinds, np.stack(matrices), masses
