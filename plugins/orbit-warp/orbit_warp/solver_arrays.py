"""Arrays of the solver in one launch: MuJoCo-Warp's own, by what they are to the solver, and memory to work in."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportPrivateUsage=false, reportReturnType=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp
from mujoco_warp._src import types

vec5 = types.vec5


@wp.struct
class Limits:
    """When the solver ends."""

    iterations: int
    """Most rounds."""
    tolerance: wp.array[float]
    """(K,) of the gradient and the improvement."""
    line_tolerance: wp.array[float]
    """(K,) of the slope along a line, relative to the former."""
    narrowing: wp.array[float]
    """(K,) inverse square root of the ratio of frictional to normal impedance."""


@wp.struct
class Inertia:
    """Inertia matrices: the lower triangle's entries that can differ from zero."""

    values: wp.array2d[float]
    """(N, entries)."""
    rows: wp.array[int]
    """(entries,) row of each."""
    columns: wp.array[int]
    """(entries,) column of each, at most its row."""
    starts: wp.array[int]
    """(nv + 1,) offsets of the whole matrix's rows in the following two."""
    row_entries: wp.array[int]
    """Entry of each."""
    row_columns: wp.array[int]
    """Column of each."""
    diagonal_starts: wp.array[int]
    """(nv,) first entry of each row of the triangle."""
    diagonal_counts: wp.array[int]
    """(nv,) entries of each row of the triangle, of which the last is on the diagonal."""


@wp.struct
class Rows:
    """Constraint rows: of equalities, of dry friction, then limits and contacts."""

    most: int
    """Rows that there is room for."""
    equalities: wp.array[int]
    """(N,) number of the former."""
    frictions: wp.array[int]
    """(N,) number of the second."""
    counts: wp.array[int]
    """(N,) number of all."""
    kinds: wp.array2d[int]
    """(N, rows) MuJoCo-Warp's ``ConstraintType``."""
    ids: wp.array2d[int]
    """(N, rows) contact of each."""
    jacobian: wp.array3d[float]
    """(N, rows, nv padded to a multiple of 4)."""
    stiffness: wp.array2d[float]
    """(N, rows) inverse of the regularised mass."""
    reference: wp.array2d[float]
    """(N, rows) acceleration aimed at."""
    friction_bounds: wp.array2d[float]
    """(N, rows) dry friction."""


@wp.struct
class Contacts:
    """Contacts of all worlds."""

    count: wp.array[int]
    """(1,)."""
    friction: wp.array[vec5]
    """(C,) coefficients."""
    dimensions: wp.array[int]
    """(C,) rows of each."""
    addresses: wp.array2d[int]
    """(C, 10) rows, -1 where there was no room."""
    distances: wp.array[float]
    """(C,) m."""
    margins: wp.array[float]
    """(C,) m."""


@wp.struct
class Work:
    """Memory of one launch."""

    vector: wp.array2d[float]
    """(N, padded nv) of what all lanes read."""
    hessian: wp.array3d[float]
    """(N, padded nv, padded nv), then its factor in both triangles."""
    residual: wp.array2d[float]
    """(N, rows) acceleration less the one aimed at."""
    slope: wp.array2d[float]
    """(N, rows) change of the former along the search direction."""
    quad: wp.array2d[wp.vec3]
    """(N, rows) of elliptic contacts in their first three rows: their cost along the line."""


@wp.struct
class Found:
    """Solution: accelerations, and the forces and states of rows."""

    force: wp.array2d[float]
    """(N, rows)."""
    state: wp.array2d[int]
    """(N, rows) MuJoCo-Warp's ``ConstraintState``."""
    acceleration: wp.array2d[float]
    """(N, nv)."""
    momentum: wp.array2d[float]
    """(N, nv) inertia times acceleration."""
    constraint_force: wp.array2d[float]
    """(N, nv) of all rows."""
    rounds: wp.array[int]
    """(N,)."""
    overflow: wp.array[int]
    """(N,) bits of MuJoCo-Warp's ``OverflowType``."""
