"""The solids of a scene, one after another, as arrays: one description for all environments."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from orbit_core.plugin_kit.closed_surfaces import is_convex
from orbit_core.scene import Scene, SoftBody
from orbit_matter.solids.distance import Lattice, lattice
from orbit_matter.solids.element import CENTER, FloatArray
from orbit_matter.solids.grid import Embedding, IntArray, embed
from orbit_matter.solids.kernels import LANES

CONTACT_SHARE = 15.0
"""Inertias ``m / h^2`` of what moves with it that a contact is firm. Up to this share one linearisation of the contacts
is enough; at 61 they flicker, and a grasped block weighs 6 to 26 % too much."""
HOLD = 2.0
"""Times the stiffness of a cell, ``E`` times its edge, that a held vertex is held with. A beam clamped by 25 vertices
droops 0.5 % more than with 20 times. Firmer holds that are made in a running world, which no preconditioner knows,
would take 16 iterations in the place of 6."""


@dataclass(frozen=True, eq=False)
class SolidModel:
    """B solids with n nodes, C cells and S sites."""

    deformables: tuple[int, ...]
    """Index of each solid among the scene's deformables."""
    embeddings: tuple[Embedding, ...]
    """Grid of each solid."""
    vertices: tuple[slice, ...]
    """Sites that are the vertices of each solid's mesh."""
    between: tuple[slice, ...]
    """Sites between the vertices of each solid, which are held where all vertices around them are."""
    contacts: int
    """Sites of contact, which come before all others."""
    nodes: npt.NDArray[np.float32]
    """(n, 3) m at rest, in the environment's frame."""
    first_node: IntArray
    """(B + 1,)"""
    first_cell: IntArray
    """(B + 1,)"""
    first_row: IntArray
    """(B + 1,) rows of each solid's preconditioner, filled up to multiples of LANES."""
    masses: npt.NDArray[np.float32]
    """(n,) kg."""
    cells: IntArray
    """(C, 27)"""
    kinds: IntArray
    """(C,)"""
    stiffness: npt.NDArray[np.float32]
    """(K, 81, 81)"""
    site_cells: IntArray
    """(S,) cell of each site."""
    weights: npt.NDArray[np.float32]
    """(S, 27)"""
    firmness: npt.NDArray[np.float32]
    """(contacts, 3, 3) N/m of contacts: ``n^T firmness n`` along a normal n."""
    per_area: npt.NDArray[np.float32]
    """(B,) N/m of contacts on a square metre of each solid."""
    holds: npt.NDArray[np.float32]
    """(S - contacts,) N/m of what holds vertices, and points between them."""
    attached: IntArray
    """(S,) 1 for vertices, and points between them, that the scene attaches."""
    inverses: npt.NDArray[np.float32]
    """(blocks of columns, LANES)"""
    inverse_at: IntArray
    """(B, 2) where the preconditioner of the free and of the attached solid begins."""
    middles: npt.NDArray[np.float32]
    """(C, 3) m of cells at rest, in the frame of each mesh."""
    contact_rest: npt.NDArray[np.float32]
    """(contacts, 3) m of points of contact, in the frame of each mesh."""
    lattices: tuple[Lattice, ...]
    """Distances to the surface of each solid; none where matter meets only links."""
    touches: IntArray
    """(B,) 1 for solids that may touch themselves."""
    reach: npt.NDArray[np.float32]
    """(B,) m at rest, within which points of one are too near to each other to touch."""
    shares: npt.NDArray[np.float32]
    """(B, B) part of its firmness with which a point of the first presses on the second."""
    fits: tuple[npt.NDArray[np.float32], ...]
    """(n, V) of each solid: nodes that put vertices where they are written."""


def build(scene: Scene, h: float) -> SolidModel:
    """Assemble the solids of a scene for steps of ``h`` seconds.

    Raises:
        ConfigurationError: the grid of a solid is too fine.
    """
    found = [(n, spec) for n, spec in enumerate(scene.deformables) if isinstance(spec, SoftBody)]
    parts = [_embedded(_Key(spec)) for _, spec in found]
    counts = {name: _starts([len(getattr(part, name)) for part in parts]) for name in ("nodes", "cells", "stiffness")}
    # Rounded up to whole blocks of LANES, which a CPU multiplies at a time.
    rows = _starts([-(-3 * len(part.nodes) // LANES) * LANES for part in parts])
    sites = [getattr(part, name) for name in ("contacts", "vertices", "between") for part in parts]
    site_starts = _starts([len(each.cells) for each in sites])
    places = tuple(slice(int(a), int(b)) for a, b in pairwise(site_starts))
    vertices, between = places[len(parts) : 2 * len(parts)], places[2 * len(parts) :]
    owners = [*range(len(parts))] * 3
    firm = [_contact_firmness(spec, part, h) for (_, spec), part in zip(found, parts, strict=True)]
    holds = [
        np.full(len(getattr(part, name).cells), _hold(spec, part))
        for name in ("vertices", "between")
        for (_, spec), part in zip(found, parts, strict=True)
    ]
    contacts = int(site_starts[len(parts)]) if parts else 0
    attached = np.zeros(int(site_starts[-1]), np.int32)
    for number, (_, spec) in enumerate(found):
        for which, held in zip((vertices, between), _attached(spec, parts[number]), strict=True):
            attached[which[number].start + held] = 1
    inverses, inverse_at = _preconditioners([spec for _, spec in found], h)
    concave = [not is_convex(spec.rest_positions, np.asarray(spec.mesh.faces)) for _, spec in found]
    meets = bool(found) and (len(scene.deformables) > 1 or any(concave))
    return SolidModel(
        deformables=tuple(n for n, _ in found),
        embeddings=tuple(parts),
        vertices=vertices,
        between=between,
        contacts=contacts,
        nodes=_joined([spec.pose.transform(part.nodes) for (_, spec), part in zip(found, parts, strict=True)], (3,)),
        first_node=counts["nodes"],
        first_cell=counts["cells"],
        first_row=rows,
        masses=_joined([part.masses for part in parts], ()),
        cells=_shifted([part.cells for part in parts], counts["nodes"], (27,)),
        kinds=_shifted([part.kinds for part in parts], counts["stiffness"], ()),
        stiffness=_joined([part.stiffness for part in parts], (81, 81)),
        site_cells=_shifted([each.cells for each in sites], counts["cells"][owners] if parts else rows, ()),
        weights=_joined([each.weights for each in sites], (27,)),
        firmness=_joined(firm, (3, 3)),
        per_area=np.array([_per_area(spec, part, h) for (_, spec), part in zip(found, parts, strict=True)], np.float32),
        holds=_joined(holds, ()),
        attached=attached,
        inverses=inverses,
        inverse_at=inverse_at,
        middles=_joined([part.nodes[part.cells[:, CENTER]] for part in parts], (3,)),
        contact_rest=_joined([part.weights_of(part.contacts) @ part.nodes for part in parts], (3,)),
        lattices=tuple(_lattice(_Key(spec)) for _, spec in found) if meets else (),
        touches=np.array(concave, np.int32),
        reach=np.array([part.size.max() for part in parts], np.float32),
        shares=_shares([spec for _, spec in found], parts),
        fits=tuple(_fit(part).astype(np.float32) for part in parts),
    )


class _Key:
    """A solid by what its embedding depends on."""

    def __init__(self, spec: SoftBody) -> None:
        self.spec = spec
        # Pose, friction and attachments are left out: they change neither the grid nor its matrices.
        numbers = (spec.density, spec.youngs_modulus, spec.poissons_ratio, spec.resolution or 0.0)
        mesh = (np.asarray(spec.mesh.vertices, np.float64).tobytes(), np.asarray(spec.mesh.faces, np.int64).tobytes())
        self.key = (spec.name, numbers, mesh)

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self.key == other.key


@functools.lru_cache(maxsize=32)
def _embedded(key: _Key) -> Embedding:
    """Embed a solid, once in a process."""
    return embed(key.spec)


@functools.lru_cache(maxsize=32)
def _lattice(key: _Key) -> Lattice:
    """Measure the distances of a solid, once in a process."""
    return lattice(key.spec, _embedded(key))


def _starts(counts: list[int]) -> IntArray:
    return np.cumsum([0, *counts]).astype(np.int32)


def _joined(parts: list[FloatArray], shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
    return np.concatenate([np.zeros((0, *shape)), *parts]).astype(np.float32)


def _shifted(parts: list[IntArray], starts: IntArray, shape: tuple[int, ...]) -> IntArray:
    """Join indices of each solid as indices of all."""
    moved = [part + start for part, start in zip(parts, starts, strict=False)]
    return np.concatenate([np.zeros((0, *shape), np.int32), *moved]).astype(np.int32)


def _attached(spec: SoftBody, part: Embedding) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the vertices of a solid that the scene attaches, and the points between vertices of one attachment."""
    by = np.full(len(spec.rest_positions), -1)
    for number, held in enumerate(spec.attachments):
        by[list(held.particles)] = number
    around = by[part.corners]
    between = (around >= 0).all(axis=1) & (around == around[:, :1]).all(axis=1)
    return np.flatnonzero(by >= 0), np.flatnonzero(between)


def _contact_firmness(spec: SoftBody, part: Embedding, h: float) -> FloatArray:
    return _per_area(spec, part, h) * part.contacts.areas


def _per_area(spec: SoftBody, part: Embedding, h: float) -> float:
    """Return the firmness of a square metre of a solid's surface, N/m."""
    return CONTACT_SHARE * spec.mass / (h * h) / float(np.einsum("pii->", part.contacts.areas))


def _shares(specs: list[SoftBody], parts: list[Embedding]) -> npt.NDArray[np.float32]:
    """Return the part of its firmness with which a point of each solid (B, 1) presses on each other one (1, B)."""
    # Both have points where they touch, each with a half of what the less firm of them has on a square metre.
    firm = np.array([s.mass / np.einsum("pii->", p.contacts.areas) for s, p in zip(specs, parts, strict=True)])
    return (0.5 * np.minimum(1.0, firm[None] / np.maximum(firm[:, None], 1e-300))).astype(np.float32)


def _hold(spec: SoftBody, part: Embedding) -> float:
    return HOLD * spec.youngs_modulus * float(part.size.min())


# Preconditioners -----------------------------------------------------------------------------------------------------


def _preconditioners(specs: list[SoftBody], h: float) -> tuple[npt.NDArray[np.float32], IntArray]:
    """Return the inverses of all solids' matrices at rest without contacts, and where each begins."""
    blocks, places, begin = [np.zeros((0, LANES), np.float32)], np.zeros((len(specs), 2), np.int32), 0
    for number, spec in enumerate(specs):
        part = _embedded(_Key(spec))
        vertices, between = _attached(spec, part)
        held = [*vertices.tolist(), *(len(part.vertices.cells) + between).tolist()]
        for kind, sites in enumerate(([], held)):
            if kind and not sites:
                # A solid that the scene attaches nowhere has one preconditioner, which serves for both.
                places[number, 1] = places[number, 0]
                continue
            packed = _packed(_inverse(_Key(spec), spec.damping, h, tuple(sites)))
            blocks.append(packed)
            places[number, kind] = begin
            begin += len(packed)
    return np.concatenate(blocks), places


@functools.lru_cache(maxsize=8)
def _inverse(key: _Key, damping: float, h: float, held: tuple[int, ...]) -> FloatArray:
    """Invert the matrix of a step for a solid at rest, once in a process.

    Of its vertices, and the points between them after these, those in ``held`` are held.
    """
    spec, part = key.spec, _embedded(key)
    # BDF2, as in the kernels: velocities are ``3 d / (2 h)``, inertias ``9 m / (4 h^2)``.
    matrix = part.assembled() * (1.0 + 1.5 * damping / h)
    matrix[np.diag_indices(len(matrix))] += np.repeat(2.25 / (h * h) * part.masses, 3)
    # Held vertices resist alike in all directions, so that the matrix may be turned with the body.
    if held:
        weights = np.concatenate((part.weights_of(part.vertices), part.weights_of(part.between)))[list(held)]
        firm = _hold(spec, part) * weights.T @ weights
        for axis in range(3):
            matrix[axis::3, axis::3] += firm
    return np.asarray(np.linalg.inv(matrix), np.float64)


def _packed(matrix: FloatArray) -> npt.NDArray[np.float32]:
    """Return blocks of LANES rows, column after column, (blocks x columns, LANES)."""
    count = len(matrix)
    blocks = -(-count // LANES)
    # Rows beyond the last are zero, and so is what they give.
    padded = np.zeros((blocks * LANES, count))
    padded[:count] = matrix
    return padded.reshape(blocks, LANES, count).transpose(0, 2, 1).reshape(-1, LANES).astype(np.float32)


# Writing -------------------------------------------------------------------------------------------------------------

_SMOOTH = 1e-4
"""Weight of the smoothness of the nodes between vertices, against that of vertices being where they are written."""


def _fit(part: Embedding) -> FloatArray:
    """Return the matrix (n, V) that turns vertices into nodes.

    It is exact for what moves, turns or stretches as a whole; the rest is fitted to the vertices by least squares,
    as smooth as it can be in between.
    """
    weights = part.weights_of(part.vertices)
    vertices = weights @ part.nodes
    # What is uniform goes through the mean deformation, and only the rest through the smooth fit.
    even = np.column_stack((np.ones(len(vertices)), vertices))
    whole = np.linalg.pinv(even)
    rough = np.zeros((len(part.nodes), len(part.nodes)))
    for nodes in part.cells:
        grid = nodes.reshape(3, 3, 3)
        for axis in range(3):
            lines = np.moveaxis(grid, axis, 0)
            for low, high in ((0, 1), (1, 2)):
                a, b = lines[low].ravel(), lines[high].ravel()
                rough[a, a] += 1.0
                rough[b, b] += 1.0
                rough[a, b] -= 1.0
                rough[b, a] -= 1.0
    matrix = weights.T @ weights + _SMOOTH * rough
    rest = np.linalg.solve(matrix, weights.T) @ (np.eye(len(vertices)) - even @ whole)
    return np.column_stack((np.ones(len(part.nodes)), part.nodes)) @ whole + rest
