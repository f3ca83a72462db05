"""A solid as MuJoCo steps it: a grid of cells of eight nodes around its surface, which follows them.

MuJoCo's own matrix of a trilinear cell locks in bending: a beam of ten cells droops a third too little. These cells
have the incompatible modes of Taylor, Beresford and Wilson, *A non-conforming element for stress analysis* (1976),
eliminated within each cell, with which the same beam is right within 1 %. Its quadratic cells bend as well, but their
contacts leave out what nodes take with a negative share, so that friction does not hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import ConfigurationError
from orbit_core.plugin_kit.closed_surfaces import inside_lattice
from orbit_core.scene import SoftBody

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
CORNERS = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
"""Corners (8, 3) of a cell, in MuJoCo's order."""

# Corners of a cell that no edge joins, turned so that the tetrahedron has a positive volume.
_TETRAHEDRON = [0, 3, 6, 5]
# Sub-cells along each edge of a cell, with two points of Gauss each, by which what is inside of the cell is found.
_SUBCELLS = 3
# Part of a cell's stiffness and mass that it has at least, so that no node of a cell with a vertex is left loose.
_LEAST_FILL = 0.05
# Part of a cell inside, below which its samples are too few for incompatible modes.
_FEW = 0.3
# Unknowns of one solid: MuJoCo's step then takes some 50 ms.
_MOST_UNKNOWNS = 3000
# Of Newton's method, by which masses of nodes are found in 5 to 8.
_MOST_ITERATIONS = 30
# Weight of smooth displacements against what is written, where vertices say nothing about a node.
_SMOOTH, _STILL = 1e-6, 1e-10
# Depth of the tetrahedra under the surface, by which it collides, over the mean edge of their triangle. MuJoCo spreads
# what presses on a face over all four corners: at 0.5 a block is 2.7 % too stiff, at 0.03 solids tremble on each other.
_DEPTH = 0.2
# The same over the thickness of the solid there.
_THIN = 0.4
# Part of a triangle by which rays meet it beyond its edges.
_EDGE = 1e-6
# Of pairs of a ray and a triangle at a time, which take 300 bytes each.
_MOST_PAIRS = 300_000


@dataclass(frozen=True, eq=False)
class SolidGrid:
    """The grid around one solid at rest, in the frame of its mesh."""

    counts: IntArray
    """(3,) cells along each axis."""
    nodes: FloatArray
    """(n, 3) m, along z, then y, then x."""
    masses: FloatArray
    """(n,) kg; zero for nodes of empty cells alone, which do not move."""
    stiffness: FloatArray
    """(C, 24, 24) N/m of each cell, by node and axis."""
    weights: FloatArray
    """(V, m) of the m nodes that move, at each vertex of the mesh."""

    @property
    def moving(self) -> npt.NDArray[np.bool_]:
        """Mask (n,) of the nodes that move."""
        return self.masses > 0.0

    @property
    def fillers(self) -> IntArray:
        """Nodes (c, 4) of a tetrahedron in each cell that is not empty."""
        full = self.stiffness.any(axis=(1, 2))
        return _corners(self.counts)[full][:, _TETRAHEDRON]

    def firmness(self, step: float) -> FloatArray:
        """Return how many times as heavy each moving node (m,) is to a push of one step as its mass alone.

        Neighbours, which elasticity ties to it, bear with it: implicitly integrated, ``M + step^2 K`` resists.
        """
        count = len(self.nodes)
        corners = _corners(self.counts)
        resisting = np.zeros((count, 3, count, 3))
        for own, matrix in zip(corners, self.stiffness.reshape(-1, 8, 3, 8, 3), strict=True):
            resisting[own[:, None], :, own] += step**2 * matrix.transpose(0, 2, 1, 3)
        resisting = resisting.reshape(3 * count, 3 * count)
        moving = np.repeat(self.moving, 3)
        resisting = resisting[np.ix_(moving, moving)] + np.diag(np.repeat(self.masses[self.moving], 3))
        yielding = np.linalg.inv(resisting).diagonal().reshape(-1, 3).mean(axis=1)
        return 1.0 / (self.masses[self.moving] * yielding)

    def nearest(self) -> IntArray:
        """Return the moving node (V,) that has the largest part in each vertex."""
        return self.weights.argmax(axis=1)

    # Kept, and only where vertices are written: of a thousand nodes it takes seconds.
    @cached_property
    def fit(self) -> FloatArray:
        """Matrix (m, V) from displacements of vertices to those of nodes, smooth where these are free."""
        place = np.cumsum(self.moving) - 1
        lattice = np.arange(len(self.nodes)).reshape(self.counts + 1)
        rows = [self.weights]
        for axis in range(3):
            lines = np.moveaxis(lattice, axis, 0)
            rows.append(_STILL * _differences((lines[:-1], lines[1:]), (-1.0, 1.0), self.moving, place))
            rows.append(_SMOOTH * _differences((lines[:-2], lines[1:-1], lines[2:]), (1, -2, 1), self.moving, place))
        return np.asarray(np.linalg.pinv(np.concatenate(rows), rcond=1e-13)[:, : len(self.weights)], dtype=np.float64)


def _differences(
    along: tuple[npt.NDArray[np.int64], ...], factors: tuple[float, ...], moving: npt.NDArray[np.bool_], place: IntArray
) -> FloatArray:
    """Return a row for each line of neighbours that all move."""
    lines = np.stack([nodes.ravel() for nodes in along], axis=-1)
    lines = lines[moving[lines].all(axis=1)]
    found = np.zeros((len(lines), int(moving.sum())))
    found[np.arange(len(lines))[:, None], place[lines]] = factors
    return found


def embed(spec: SoftBody) -> SolidGrid:
    """Embed a solid in a grid along the axes of its mesh.

    Raises:
        ConfigurationError: the grid has too many nodes.
    """
    vertices, faces = spec.rest_positions, np.asarray(spec.mesh.faces)
    low, extent = vertices.min(axis=0), np.ptp(vertices, axis=0)
    counts = cell_counts(extent, spec.resolution)
    _check_count(spec, counts, extent)
    size, stride = extent / counts, counts + 1
    cells, corners = _cells(counts), _corners(counts)
    nodes = low + size * np.stack(np.unravel_index(np.arange(int(stride.prod())), stride), axis=-1)
    within = _within(vertices, faces, low, size, counts)
    home = np.clip(((vertices - low) / size).astype(np.int64), 0, counts - 1)
    # A cell with a vertex is kept even where none of its samples is inside.
    used = np.asarray(within.any(axis=1))
    used[np.ravel_multi_index(tuple(home.T), tuple(counts))] = True
    masses, stiffness = _properties(spec, size, used, within, corners, len(nodes))
    masses = _with_inertia(masses * (spec.mass / masses.sum()), nodes, counts, spec, low, size, cells, within)
    shares = np.zeros((len(vertices), len(nodes)))
    own = corners[np.ravel_multi_index(tuple(home.T), tuple(counts))]
    shares[np.arange(len(vertices))[:, None], own] = _shape_functions((vertices - low) / size - home)
    return SolidGrid(counts, nodes, masses, stiffness, shares[:, masses > 0.0])


def _cells(counts: IntArray) -> IntArray:
    """Return the place (C, 3) of each cell in the grid."""
    return np.stack(np.unravel_index(np.arange(int(counts.prod())), counts), axis=-1)


def _corners(counts: IntArray) -> IntArray:
    """Return the nodes (C, 8) of each cell."""
    x, y, z = np.moveaxis(_cells(counts)[:, None] + CORNERS, -1, 0)
    return (x * (counts[1] + 1) + y) * (counts[2] + 1) + z


def cell_counts(extent: FloatArray, resolution: float | None) -> IntArray:
    """Return the cells along each axis.

    Args:
        extent: of the solid's box (3,), m.
        resolution: longest edge of a cell, m. None takes half the least extent or a tenth of the largest, the longer
            of both: a beam has a row of ten cells, a block two along each edge.
    """
    if resolution is None:
        longest = max(0.5 * float(extent.min()), 0.1 * float(extent.max()))
        return np.maximum(1, np.round(extent / longest - 1e-6)).astype(np.int64)
    return np.maximum(1, np.ceil(extent / resolution - 1e-6)).astype(np.int64)


def shortest_edge(spec: SoftBody) -> float:
    """Return the metres of a cell's shortest edge, which waves cross first."""
    extent = np.ptp(spec.rest_positions, axis=0)
    return float((extent / cell_counts(extent, spec.resolution)).min())


def _check_count(spec: SoftBody, counts: IntArray, extent: FloatArray) -> None:
    unknowns = 3 * int(np.prod(counts + 1))
    if unknowns > _MOST_UNKNOWNS:
        would = float((extent / counts).max())
        while 3 * int(np.prod(cell_counts(extent, float(f"{would:.2g}")) + 1)) > _MOST_UNKNOWNS:
            would *= 1.02
        raise ConfigurationError(
            f"soft body '{spec.name}' would have {unknowns} unknowns in {' x '.join(map(str, counts))} cells, and "
            f"MuJoCo's own has {_MOST_UNKNOWNS} at most: a resolution of {would:.2g} m would do"
        )


def _within(
    vertices: FloatArray, faces: npt.NDArray[np.integer], low: FloatArray, size: FloatArray, counts: IntArray
) -> npt.NDArray[np.bool_]:
    """Return which samples of each cell are inside, (C, S)."""
    line = _line()
    axes = [low[a] + size[a] * (np.arange(counts[a])[:, None] + line).ravel() for a in range(3)]
    shape = np.stack((counts, np.full(3, len(line))), axis=-1).ravel()
    blocks = inside_lattice(axes, vertices, faces).reshape(shape)
    return blocks.transpose(0, 2, 4, 1, 3, 5).reshape(int(counts.prod()), -1)


def _line() -> FloatArray:
    """Return the places of samples along an edge from 0 to 1, each with the same part of it."""
    middles = (np.arange(_SUBCELLS) + 0.5) / _SUBCELLS
    return (middles[:, None] + 0.5 / _SUBCELLS * np.array((-1.0, 1.0)) / np.sqrt(3.0)).ravel()


def _samples() -> FloatArray:
    """Return points (S, 3) of a cell from 0 to 1, which integrate cubics exactly."""
    line = _line()
    return np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)


def _shape_functions(local: FloatArray) -> FloatArray:
    """Return (..., 8) of points (..., 3) from 0 to 1."""
    return np.where(CORNERS, local[..., None, :], 1.0 - local[..., None, :]).prod(axis=-1)


def _properties(
    spec: SoftBody,
    size: FloatArray,
    used: npt.NDArray[np.bool_],
    within: npt.NDArray[np.bool_],
    corners: IntArray,
    count: int,
) -> tuple[FloatArray, FloatArray]:
    """Return the masses of all nodes, whose sum is yet to be set, and the stiffness of each cell."""
    samples = _samples()
    shapes = _shape_functions(samples)
    whole = _stiffness(spec, size, samples)
    masses, stiffness = np.zeros(count), np.zeros((len(corners), *whole.shape))
    for cell in np.flatnonzero(used):
        fill = float(within[cell].mean())
        if fill >= 1.0:
            stiffness[cell] = whole
        elif fill >= _FEW:
            stiffness[cell] = fill * _stiffness(spec, size, samples[within[cell]])
        else:
            stiffness[cell] = max(fill, _LEAST_FILL) * whole
        parts = shapes[within[cell]].mean(axis=0) if fill > _LEAST_FILL else shapes.mean(axis=0)
        masses[corners[cell]] += max(fill, _LEAST_FILL) * parts
    return masses, stiffness


def _stiffness(spec: SoftBody, size: FloatArray, samples: FloatArray) -> FloatArray:
    """Return the matrix (24, 24) of a whole cell whose strains are the mean of those at samples (S, 3)."""
    modulus, nu = spec.youngs_modulus, spec.poissons_ratio
    shear, lame = modulus / (2.0 * (1.0 + nu)), modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    elasticity = np.diag([2.0 * shear] * 3 + [shear] * 3)
    elasticity[:3, :3] += lame
    factors = np.where(CORNERS, samples[:, None, :], 1.0 - samples[:, None, :])
    others = np.stack([factors[..., (1, 2)], factors[..., (0, 2)], factors[..., (0, 1)]], axis=-2).prod(axis=-1)
    gradients = np.where(CORNERS, 1.0, -1.0) * others / size
    compatible = _strains(gradients)
    # Modes 4 s (1 - s) along each axis, which bulge as a bent cell does; less their mean, so that a cell of which only
    # a part is inside still takes uniform strains exactly.
    bulges = _strains(np.eye(3) * (4.0 - 8.0 * samples[:, None, :]) / size)
    bulges -= bulges.mean(axis=0)
    volume = float(size.prod()) / len(samples)
    own, mixed, inner = (
        volume * one.reshape(-1, one.shape[2]).T @ (elasticity @ other).reshape(-1, other.shape[2])
        for one, other in ((compatible, compatible), (compatible, bulges), (bulges, bulges))
    )
    return own - mixed @ np.linalg.solve(inner, mixed.T)


def _strains(gradients: FloatArray) -> FloatArray:
    """Return matrices (S, 6, 3 k) from displacements to strains, of functions with gradients (S, k, 3)."""
    x, y, z = np.moveaxis(gradients, -1, 0)
    found = np.zeros((len(gradients), 6, gradients.shape[1], 3))
    found[:, 0, :, 0], found[:, 1, :, 1], found[:, 2, :, 2] = x, y, z
    found[:, 3, :, 0], found[:, 3, :, 1] = y, x
    found[:, 4, :, 1], found[:, 4, :, 2] = z, y
    found[:, 5, :, 2], found[:, 5, :, 0] = x, z
    return found.reshape(len(gradients), 6, -1)


def _with_inertia(
    masses: FloatArray,
    nodes: FloatArray,
    counts: IntArray,
    spec: SoftBody,
    low: FloatArray,
    size: FloatArray,
    cells: IntArray,
    within: npt.NDArray[np.bool_],
) -> FloatArray:
    """Move mass inwards so that the solid turns as it should: shares of cells are too far out, 1.5 times in a block."""
    places = (low + size * (cells[:, None] + _samples()))[within]
    axes = np.flatnonzero(counts > 1)  # along one cell there is no node further in
    middle = masses @ nodes / masses.sum()
    scale = float(np.ptp(nodes, axis=0).max())
    arms = (nodes - middle) / scale
    moments = np.concatenate((np.ones((len(nodes), 1)), arms, arms[:, axes] ** 2), axis=1)
    asked = np.concatenate(((1.0, 0.0, 0.0, 0.0), np.var(places[:, axes], axis=0) / scale**2)) * spec.mass
    # The nearest positive masses, as of an exponential family, by Newton's method on its factors.
    factors = np.zeros(len(asked))
    for _ in range(_MOST_ITERATIONS):
        moved = masses * np.exp(moments @ factors)
        missed = moments.T @ moved - asked
        if np.abs(missed).max() < 1e-12 * spec.mass:
            return moved
        factors -= np.linalg.lstsq((moments.T * moved) @ moments, missed, rcond=None)[0]
    return masses  # a shape whose nodes allow no such masses keeps the shares of its cells


def skin(spec: SoftBody) -> tuple[FloatArray, IntArray]:
    """Return the points that collide, which begin with the vertices, and a tetrahedron under each triangle.

    Elasticity is that of the grid: these say only where the surface is, and may overlap each other.
    """
    vertices, faces = spec.rest_positions, np.asarray(spec.mesh.faces, dtype=np.int64)
    triangles = vertices[faces]
    edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=-1).mean(axis=1)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    middles = triangles.mean(axis=1)
    depths = np.minimum(_DEPTH * edges, _THIN * _thicknesses(middles, -normals, triangles))
    apexes = middles - depths[:, None] * normals
    # Counter-clockwise from outside, so that a triangle turned over has its apex in front.
    numbers = len(vertices) + np.arange(len(faces))
    return np.concatenate((vertices, apexes)), np.column_stack((faces[:, (0, 2, 1)], numbers))


def _thicknesses(starts: FloatArray, directions: FloatArray, triangles: FloatArray) -> FloatArray:
    """Return the metres (F,) from starts (F, 3) on the surface to where rays leave the solid."""
    a, ab, ac = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    across = np.cross(ab, ac)
    found = np.full(len(starts), np.inf)
    size = max(1, _MOST_PAIRS // len(triangles))
    # In parts, for all pairs at once would fill memory.
    for start in range(0, len(starts), size):
        some = slice(start, start + size)
        arms = a[None] - starts[some, None]
        towards = directions[some] @ across.T
        # Triangles that face along the ray are what it leaves by.
        leaving = towards > 1e-12 * np.abs(towards).max()
        towards = np.where(leaving, towards, 1.0)
        ways, turned = (arms * across).sum(axis=-1) / towards, np.cross(arms, directions[some, None])
        u, v = (turned * ac).sum(axis=-1) / towards, -(turned * ab).sum(axis=-1) / towards
        # A little wider, for a ray that meets an edge must not pass between its two triangles.
        left = leaving & (ways > 0.0) & (u >= -_EDGE) & (v >= -_EDGE) & (u + v <= 1.0 + _EDGE)
        found[some] = np.where(left, ways, np.inf).min(axis=1)
    return found
