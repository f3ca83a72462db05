"""The particles of a scene and what holds them together, as arrays: one description for all environments."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import Cloth, DeformableSpec, Rope, Scene

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int32]
_LAYER = 0.38
"""Radius of cloth's particles against each other, in edges: above 0.35, half a square's diagonal from its middle."""


@dataclass(frozen=True, eq=False)
class Constraints:
    """Constraints of one kind in the order of their colours: those of one colour share no particle.

    Edges of ropes are not coloured: the solver takes a whole rope at once.
    """

    particles: IntArray
    """(C, k)"""
    weights: FloatArray
    """(C, w) numbers that the kernel needs of each."""
    owners: IntArray
    """(C,) index of the deformable."""
    ranges: tuple[tuple[int, int], ...]
    """First and one past the last of each colour; of edges, of each rope, in their order along it."""


@dataclass(frozen=True, eq=False)
class Model:
    """P particles of D deformables, one after another."""

    slices: tuple[slice, ...]
    """Columns of each deformable."""
    rest: FloatArray
    """(P, 3) m in the environment's frame."""
    masses: FloatArray
    """(P,) kg"""
    radii: FloatArray
    """(P,) m"""
    own_radii: FloatArray
    """(P,) m that particles keep from each other: of cloth, so much that its layers do not pass between each other's
    particles."""
    touches: IntArray
    """(P,) 1 for particles of what collides with itself."""
    owners: IntArray
    """(P,) index of the deformable."""
    damping: FloatArray
    """(P,) 1/s"""
    mates: IntArray
    """(P, 2) particles before and after each along its rope, or -1: of cloth all."""
    triangles: Constraints
    """Weights: the inverse of the 2 x 2 matrix of edges at rest, row by row; 1 / (E t A); Poisson's ratio."""
    edges: Constraints
    """Of ropes. Weights: length at rest; l / (E A)."""
    bends: Constraints
    """Of four particles, or three of a rope. Weights: four coefficients of the curvature; 1 / stiffness."""

    @property
    def meets(self) -> bool:
        """True if any two particles may touch."""
        return bool(self.touches.any()) or len(set(self.owners.tolist())) > 1


def build(scene: Scene) -> Model:
    """Assemble what a scene's cloths and ropes are made of.

    Raises:
        ConfigurationError: a cloth is not flat at rest.
    """
    parts = [_particles_of(spec, n) for n, spec in enumerate(scene.deformables)]
    starts = np.cumsum([0, *(len(part.rest) for part in parts)])
    slices = tuple(slice(int(a), int(b)) for a, b in pairwise(starts))
    return Model(
        slices,
        np.concatenate([part.rest for part in parts]),
        np.concatenate([part.masses for part in parts]),
        np.concatenate([part.radii for part in parts]),
        np.concatenate([part.own_radii for part in parts]),
        np.concatenate([part.touches for part in parts]),
        np.concatenate([part.owners for part in parts]),
        np.concatenate([part.damping for part in parts]),
        np.concatenate([_moved(part.mates, start) for part, start in zip(parts, starts[:-1], strict=True)]),
        *(
            _joined([getattr(part, kind) for part in parts], starts, columns, width)
            for kind, columns, width in (("triangles", 3, 6), ("edges", 2, 2), ("bends", 4, 5))
        ),
    )


def _particles_of(spec: DeformableSpec, owner: int) -> Model:
    """Return the particles of a cloth or rope; of anything else, which other modules compute, none."""
    if isinstance(spec, Cloth):
        return _cloth(spec, owner)
    if isinstance(spec, Rope):
        return _rope(spec, owner)
    none = np.zeros(0, np.float32)
    kinds = {"triangles": (3, 6), "edges": (2, 2), "bends": (4, 5)}
    return Model(
        (), np.zeros((0, 3), np.float32), none, none, none, none.astype(np.int32), none.astype(np.int32), none,
        np.zeros((0, 2), np.int32), **{name: _constraints([], [], owner, *shape) for name, shape in kinds.items()},
    )  # fmt: skip


def _joined(parts: list[Constraints], starts: npt.NDArray[np.int64], columns: int, width: int) -> Constraints:
    """Join the constraints of all deformables and colour them together."""
    particles = [part.particles + np.int32(start) for part, start in zip(parts, starts[:-1], strict=True)]
    joined = np.concatenate([np.zeros((0, columns), np.int32), *particles])
    weights = np.concatenate([np.zeros((0, width), np.float32), *(part.weights for part in parts)])
    owners = np.concatenate([np.zeros(0, np.int32), *(part.owners for part in parts)])
    # Edges are solved rope by rope and in their order, so that a rope is its own colour.
    colors = owners.astype(np.int64) if columns == 2 else _colors(joined)
    order = np.argsort(colors, kind="stable")
    bounds = np.searchsorted(colors[order], np.arange(colors.max(initial=-1) + 2))
    ranges = tuple((int(a), int(b)) for a, b in pairwise(bounds) if b > a)
    return Constraints(joined[order].astype(np.int32), weights[order].astype(np.float32), owners[order], ranges)


def _colors(particles: npt.NDArray[np.int32]) -> npt.NDArray[np.int64]:
    """Greedy colouring (C,): the first colour that no constraint on the same particles has."""
    taken: dict[int, int] = {}
    colors = np.zeros(len(particles), dtype=np.int64)
    for number, row in enumerate(particles.tolist()):
        used = 0
        for particle in row:
            used |= taken.get(particle, 0)
        color = (~used & (used + 1)).bit_length() - 1  # the lowest bit that is not set
        colors[number] = color
        for particle in row:
            taken[particle] = taken.get(particle, 0) | (1 << color)
    return colors


def _constraints(particles: npt.ArrayLike, weights: npt.ArrayLike, owner: int, columns: int, width: int) -> Constraints:
    rows = np.asarray(particles, dtype=np.int32).reshape(-1, columns)
    # Empty lists keep their number of columns, which kernels index.
    numbers = np.asarray(weights, dtype=np.float32).reshape(-1, width)
    return Constraints(rows, numbers, np.full(len(rows), owner, np.int32), ())


def _part(
    spec: Cloth | Rope,
    owner: int,
    masses: npt.NDArray[np.float64],
    radius: float,
    own_radius: float,
    **kinds: Constraints,
) -> Model:
    rest = spec.pose.transform(spec.rest_positions).astype(np.float32)
    empty = {"triangles": (3, 6), "edges": (2, 2), "bends": (4, 5)}
    made = {name: kinds.get(name, _constraints([], [], owner, *shape)) for name, shape in empty.items()}
    count = len(rest)
    return Model(
        (),
        rest,
        masses.astype(np.float32),
        np.full(count, radius, np.float32),
        np.full(count, own_radius, np.float32),
        np.full(count, int(spec.self_collisions), np.int32),
        np.full(count, owner, np.int32),
        np.full(count, spec.damping, np.float32),
        _mates(count) if isinstance(spec, Rope) else np.full((count, 2), -1, np.int32),
        **made,
    )


def _moved(mates: IntArray, start: np.int64) -> IntArray:
    """Neighbours as columns of the whole scene."""
    return np.where(mates < 0, -1, mates + start).astype(np.int32)


def _mates(count: int) -> IntArray:
    """(P, 2) neighbours along a rope; -1 beyond its ends."""
    numbers = np.arange(count, dtype=np.int32)
    return np.column_stack((numbers - 1, np.where(numbers + 1 < count, numbers + 1, -1))).astype(np.int32)


def _cloth(spec: Cloth, owner: int) -> Model:
    vertices, faces = spec.rest_positions, np.asarray(spec.mesh.faces, dtype=np.int64)
    flat = _flattened(spec)
    edges = np.stack((flat[faces[:, 1]] - flat[faces[:, 0]], flat[faces[:, 2]] - flat[faces[:, 0]]), axis=-1)
    areas = 0.5 * np.abs(np.linalg.det(edges))
    masses = np.zeros(len(vertices))
    np.add.at(masses, faces, (spec.area_density * areas / 3.0)[:, None])
    compliance = 1.0 / (spec.membrane_stiffness * areas)
    ratio = np.full(len(faces), spec.poissons_ratio)
    weights = np.column_stack((np.linalg.inv(edges).reshape(-1, 4), compliance, ratio))
    triangles = _constraints(faces, weights, owner, 3, 6)
    bends = _constraints(*_hinges(flat, faces, spec.bending_stiffness), owner, 4, 5)
    # Layers of cloth keep apart by the mesh's fineness, not only by the thickness: points between them could pass.
    sides = np.linalg.norm(flat[faces] - flat[np.roll(faces, 1, axis=1)], axis=-1)
    own = max(0.5 * spec.thickness, _LAYER * float(sides.min(axis=1).mean()))
    return _part(spec, owner, masses, 0.5 * spec.thickness, own, triangles=triangles, bends=bends)


def _flattened(spec: Cloth) -> npt.NDArray[np.float64]:
    """(P, 2) vertices in the plane of the cloth."""
    vertices = spec.rest_positions
    centred = vertices - vertices.mean(axis=0)
    _, sizes, axes = np.linalg.svd(centred, full_matrices=False)
    if sizes[2] > 1e-4 * sizes[0]:
        raise ConfigurationError(
            f"cloth '{spec.name}' is not flat at rest, which orbit-matter takes it to be: flatten its mesh, and fold "
            "it by writing its particles"
        )
    return centred @ axes[:2].T


def _hinges(flat: npt.NDArray[np.float64], faces: npt.NDArray[np.int64], stiffness: float) -> tuple[list, list]:
    """Pairs of triangles that share an edge, and the coefficients of the curvature across it.

    The isometric bending model of Bergou et al., "A quadratic bending model for inextensible surfaces" (2006): with
    edge (0, 1) and opposite vertices 2 and 3, energy ``3 D / (2 (A0 + A1)) |K x|^2`` of cotangents K.
    """
    if stiffness <= 0.0:
        return [], []
    opposite: dict[tuple[int, int], list[int]] = {}
    for a, b, c in faces.tolist():
        for i, j, k in ((a, b, c), (b, c, a), (c, a, b)):
            opposite.setdefault((min(i, j), max(i, j)), []).append(k)
    particles, weights = [], []
    for (i, j), others in opposite.items():
        if len(others) != 2:
            continue
        k, m = others
        c01, c02 = _cotangent(flat, i, j, k), _cotangent(flat, i, j, m)
        c03, c04 = _cotangent(flat, j, i, k), _cotangent(flat, j, i, m)
        area = _area(flat, i, j, k) + _area(flat, i, j, m)
        particles.append((i, j, k, m))
        weights.append((c03 + c04, c01 + c02, -c01 - c03, -c02 - c04, area / (3.0 * stiffness)))
    return particles, weights


def _cotangent(flat: npt.NDArray[np.float64], at: int, first: int, second: int) -> float:
    a, b = flat[first] - flat[at], flat[second] - flat[at]
    return float(a @ b / abs(a[0] * b[1] - a[1] * b[0]))


def _area(flat: npt.NDArray[np.float64], i: int, j: int, k: int) -> float:
    a, b = flat[j] - flat[i], flat[k] - flat[i]
    return 0.5 * abs(float(a[0] * b[1] - a[1] * b[0]))


def _rope(spec: Rope, owner: int) -> Model:
    points = spec.rest_positions
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    masses = np.zeros(len(points))
    # Half of each edge's mass to either end.
    masses[:-1] += 0.5 * spec.linear_density * lengths
    masses[1:] += 0.5 * spec.linear_density * lengths
    numbers = np.arange(len(points))
    pairs = np.column_stack((numbers[:-1], numbers[1:]))
    edges = _constraints(pairs, np.column_stack((lengths, lengths / spec.axial_stiffness)), owner, 2, 2)
    bends = _constraints([], [], owner, 4, 5)
    if len(points) > 2 and spec.bending_stiffness > 0.0:
        before, after = lengths[:-1], lengths[1:]
        span = 0.5 * (before + after)
        first, last = 1.0 / (before * span), 1.0 / (after * span)
        curvature = np.column_stack((first, -first - last, last, np.zeros_like(span)))
        compliance = 1.0 / (spec.bending_stiffness * span)
        triples = np.column_stack((numbers[:-2], numbers[1:-1], numbers[2:], numbers[:-2]))
        bends = _constraints(triples, np.column_stack((curvature, compliance)), owner, 4, 5)
    return _part(spec, owner, masses, spec.radius, spec.radius, edges=edges, bends=bends)
