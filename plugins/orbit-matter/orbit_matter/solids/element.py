"""The 27-node hexahedron: shape functions, stiffness and lumped mass of one cell of a grid.

Nodes are numbered ``i + 3 j + 9 k`` along x, y and z, at -1, 0 and 1 of the local coordinates.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
NODES = 27
CENTER = 13
"""Node at the cell's middle."""
FULL_SHARE = 0.05
"""Weight of the rule of 14 points in the stiffness. The rule of 2 x 2 x 2 alone leaves 57 modes without energy and is
too soft; a full rule locks. This share leaves exactly the six rigid modes, and bends a beam within 1 %."""
_PLACES = np.array([(i, j, k) for k in (-1, 0, 1) for j in (-1, 0, 1) for i in (-1, 0, 1)], dtype=np.float64)


def places() -> FloatArray:
    """Return the local coordinates of the nodes, (27, 3)."""
    return _PLACES.copy()


def shape_functions(points: FloatArray) -> FloatArray:
    """Return the weight of each node at local coordinates (P, 3), as (P, 27)."""
    lines = _lagrange(points)
    return np.einsum("pi,pj,pk->pkji", lines[:, 0], lines[:, 1], lines[:, 2]).reshape(len(points), NODES)


def gradients(points: FloatArray) -> FloatArray:
    """Return the derivatives of the shape functions by the local coordinates (P, 3), as (P, 27, 3)."""
    lines, slopes = _lagrange(points), _slopes(points)
    found = np.empty((len(points), NODES, 3))
    for axis in range(3):
        x, y, z = (slopes[:, a] if a == axis else lines[:, a] for a in range(3))
        found[..., axis] = np.einsum("pi,pj,pk->pkji", x, y, z).reshape(len(points), NODES)
    return found


def _lagrange(points: FloatArray) -> FloatArray:
    return np.stack((0.5 * points * (points - 1.0), 1.0 - points**2, 0.5 * points * (points + 1.0)), axis=-1)


def _slopes(points: FloatArray) -> FloatArray:
    return np.stack((points - 0.5, -2.0 * points, points + 0.5), axis=-1)


def quadrature(fills: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Return the points (22, 3) and weights (22,) of the blended rule; weights of a whole cell sum to 8.

    Args:
        fills: (8,) part of each octant that is inside of the solid, x fastest; None for a whole cell.
    """
    signs = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=np.float64)
    fills = np.ones(8) if fills is None else fills
    axes = np.concatenate((np.eye(3), -np.eye(3)))
    # A point on an axis is in the middle of four octants.
    near = np.array([fills[(signs @ axis) > 0.0].mean() for axis in axes])
    points = np.concatenate((signs / math.sqrt(3.0), math.sqrt(19.0 / 30.0) * axes, math.sqrt(19.0 / 33.0) * signs))
    full = np.concatenate((320.0 / 361.0 * near, 121.0 / 361.0 * fills))
    return points, np.concatenate(((1.0 - FULL_SHARE) * fills, FULL_SHARE * full))


def elasticity(youngs_modulus: float, poissons_ratio: float) -> FloatArray:
    """Return the 6 x 6 matrix of isotropic linear elasticity, in Pa; shear strains are engineering ones."""
    shear = youngs_modulus / (2.0 * (1.0 + poissons_ratio))
    lame = youngs_modulus * poissons_ratio / ((1.0 + poissons_ratio) * (1.0 - 2.0 * poissons_ratio))
    matrix = np.diag([2.0 * shear] * 3 + [shear] * 3)
    matrix[:3, :3] += lame
    return matrix


def stiffness(size: FloatArray, material: FloatArray, points: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the 81 x 81 stiffness matrix of a cell at rest, N/m.

    Args:
        size: edges of the cell (3,), m.
        material: matrix of :func:`elasticity`.
        points: local coordinates of the quadrature, (Q, 3).
        weights: of the points, which sum to 8 for a whole cell.
    """
    by_metre = gradients(points) * (2.0 / size)
    strains = np.zeros((len(points), 6, NODES, 3))
    for axis in range(3):
        strains[:, axis, :, axis] = by_metre[..., axis]
    for row, (a, b) in enumerate(itertools.combinations(range(3), 2), start=3):
        strains[:, row, :, a], strains[:, row, :, b] = by_metre[..., b], by_metre[..., a]
    flat = strains.reshape(len(points), 6, 3 * NODES)
    volume = float(np.prod(size)) / 8.0
    return np.einsum("q,qai,ab,qbj->ij", volume * weights, flat, material, flat, optimize=True)


def mass_shares(samples: FloatArray) -> FloatArray:
    """Return the part of a cell's mass that each node has, (27,): the diagonal of the mass matrix, scaled to 1.

    Of a whole cell it is the sum of each row of that matrix; where a cell is cut these sums may be negative, and the
    diagonal never is (Hinton, Rock and Zienkiewicz 1976).

    Args:
        samples: local coordinates of points spread evenly over what is inside, (Q, 3).
    """
    squares = (shape_functions(samples) ** 2).sum(axis=0)
    return squares / squares.sum()
