"""Points of matter within solids: which cell each is in, where it would be at rest, and the way out of the surface.

A point is mapped into a cell by Newton's method on its shape functions, and what is known of the surface at rest is
turned with the cell: a solid is met as it is bent, by points of other solids, of cloth and ropes, and its own
(McAdams et al., "Efficient elasticity for character skinning with contact and collisions", 2011).
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportInvalidTypeForm=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

NODES = wp.constant(27)
MIDDLE = wp.constant(13)
NOWHERE = wp.constant(-1)
_ATTEMPTS = wp.constant(3)
"""Steps of Newton's method; the first guess is exact in cells that are sheared evenly."""
_NEAR = wp.constant(1.6)
"""Local coordinates up to which a first guess is followed: bent cells bulge beyond 1."""
_EDGE = wp.constant(1.0005)
"""Local coordinates up to which a point counts as in a cell: none is lost between two."""
_FLAT = wp.constant(0.05)
"""Volume of a cell, as part of that at rest, below which it is met by nothing: its inside has no direction."""


@wp.struct
class Insides:
    """Cells of N environments as the inside of solids."""

    meets: int
    """1 if anything is to be found in them."""
    x: wp.array2d[wp.vec3]
    """(N, n) m, nodes at the beginning of the step."""
    d: wp.array2d[wp.vec3]
    """(N, n) m that nodes moved in the last step."""
    cells: wp.array2d[int]
    """(C, 27) nodes."""
    cell_body: wp.array[int]
    """(C,) solid of each cell."""
    first_cell: wp.array[int]
    """(B + 1,) first cell of each solid."""
    first_node: wp.array[int]
    """(B + 1,) first node of each solid."""
    size: wp.array[wp.vec3]
    """(B,) m, edges of a cell."""
    middle: wp.array[wp.vec3]
    """(C,) m of each cell at rest, in the frame of its mesh."""
    touches: wp.array[int]
    """(B,) 1 for solids that may touch themselves."""
    reach: wp.array[float]
    """(B,) m at rest, within which points of a solid are too near to each other to touch."""
    share: wp.array2d[float]
    """(B, B) part of its firmness with which a point of the first presses on the second."""
    low: wp.array2d[wp.vec3]
    """(N, B) corners of a box around each solid where the step is linearised."""
    high: wp.array2d[wp.vec3]
    """(N, B) the opposite corners."""
    inner: wp.array2d[wp.mat33]
    """(N, C) local coordinates for metres from the middle of each cell; zero where it is flat."""
    begin: wp.array[wp.vec3]
    """(B,) m, first point of its lattice of distances, in the frame of its mesh."""
    spacing: wp.array[wp.vec3]
    """(B,) m between points of the lattice, along each axis."""
    count: wp.array[wp.vec3i]
    """(B,) points of the lattice along each axis."""
    at: wp.array[int]
    """(B,) where its distances begin."""
    distance: wp.array[float]
    """Signed distances of all solids at rest, m, negative inside; the last axis varies fastest."""


@wp.struct
class Place:
    """Place of a point in a solid."""

    cell: int
    """Or NOWHERE."""
    local: wp.vec3
    """Coordinates in the cell, -1 to 1 along each axis."""
    rest: wp.vec3
    """Metres, in the frame of the mesh."""
    normal: wp.vec3
    """Outward unit normal of the surface as it is deformed."""
    depth: float
    """m below the surface."""


@wp.func
def lines(u: float) -> wp.vec3:
    """Values of the three quadratics along an edge."""
    return wp.vec3(0.5 * u * (u - 1.0), 1.0 - u * u, 0.5 * u * (u + 1.0))


@wp.func
def slopes(u: float) -> wp.vec3:
    return wp.vec3(u - 0.5, -2.0 * u, u + 0.5)


@wp.func
def weight(x: wp.vec3, y: wp.vec3, z: wp.vec3, i: int) -> float:
    """Weight of a node, by the quadratics along each axis."""
    return x[i % 3] * y[i / 3 % 3] * z[i / 9]


@wp.func
def blended(cells: wp.array2d[int], field: wp.array2d[wp.vec3], env: int, c: int, u: wp.vec3) -> wp.vec3:
    """A field of nodes at local coordinates of a cell."""
    found, x, y, z = wp.vec3(), lines(u[0]), lines(u[1]), lines(u[2])
    for i in range(NODES):
        found += field[env, cells[c, i]] * weight(x, y, z, i)
    return found


@wp.func
def ahead(s: Insides, env: int, c: int, u: wp.vec3, lead: float) -> wp.vec3:
    """Return the position of a point of a cell: now, or with a lead of 1 where the step is linearised."""
    return blended(s.cells, s.x, env, c, u) + blended(s.cells, s.d, env, c, u) * lead


@wp.func
def prepare_cell(s: Insides, env: int, c: int, f: wp.mat33):
    """Note how a cell with deformation f is entered."""
    half = s.size[s.cell_body[c]] * 0.5
    found = wp.mat33()
    if wp.determinant(f) > _FLAT:
        found = wp.inverse(f)
        for row in range(3):
            for column in range(3):
                found[row, column] = found[row, column] / half[row]
    s.inner[env, c] = found


@wp.func
def prepare_body(s: Insides, env: int, b: int):
    """Put a box around a solid."""
    first = s.first_node[b]
    low = s.x[env, first] + s.d[env, first]
    high = wp.vec3(low)
    for i in range(first + 1, s.first_node[b + 1]):
        x = s.x[env, i] + s.d[env, i]
        low, high = wp.min(low, x), wp.max(high, x)
    s.low[env, b] = low
    s.high[env, b] = high


@wp.func
def local_of(s: Insides, env: int, c: int, x: wp.vec3, lead: float) -> wp.vec3:
    """Local coordinates of a point in a cell, which are beyond 1 where it is not in it."""
    node = s.cells[c, MIDDLE]
    middle = s.x[env, node] + s.d[env, node] * lead
    inner = s.inner[env, c]
    u = inner * (x - middle)
    # A cell that is crushed flat has no inside: coordinates beyond any reach.
    if wp.determinant(inner) == 0.0:
        return wp.vec3(9.0, 9.0, 9.0)
    attempt = int(0)
    while attempt < _ATTEMPTS:
        if wp.max(wp.max(wp.abs(u[0]), wp.abs(u[1])), wp.abs(u[2])) > _NEAR:
            attempt = _ATTEMPTS
        else:
            # The slope is that of the cell's middle: exact where it is sheared evenly, and near enough elsewhere.
            u = u + inner * (x - ahead(s, env, c, u, lead))
            attempt += 1
    return u


@wp.func
def distance_at(s: Insides, b: int, rest: wp.vec3) -> wp.vec4:
    """Gradient and value of the distance to a surface at rest."""
    count, spacing = s.count[b], s.spacing[b]
    p = wp.cw_div(rest - s.begin[b], spacing)
    i = wp.clamp(int(p[0]), 0, count[0] - 2)
    j = wp.clamp(int(p[1]), 0, count[1] - 2)
    k = wp.clamp(int(p[2]), 0, count[2] - 2)
    u, v, w = p[0] - float(i), p[1] - float(j), p[2] - float(k)
    value, g = float(0.0), wp.vec3()
    corner = int(0)
    while corner < 8:  # no unrolled loop
        a, b1, c = corner % 2, corner / 2 % 2, corner / 4
        corner += 1
        found = s.distance[s.at[b] + ((i + a) * count[1] + j + b1) * count[2] + k + c]
        x, y, z = wp.where(a == 1, u, 1.0 - u), wp.where(b1 == 1, v, 1.0 - v), wp.where(c == 1, w, 1.0 - w)
        sx, sy, sz = float(2 * a - 1), float(2 * b1 - 1), float(2 * c - 1)
        value += found * x * y * z
        g += wp.vec3(found * sx * y * z, found * x * sy * z, found * x * y * sz)
    g = wp.cw_div(g, spacing)
    return wp.vec4(g[0], g[1], g[2], value)


@wp.func
def found_in(s: Insides, env: int, b: int, x: wp.vec3, radius: float, lead: float) -> Place:
    """Find the place of a ball in a solid, and its depth: now, or with a lead of 1 when the step ends."""
    place = Place()
    place.cell = NOWHERE
    margin = wp.vec3(radius, radius, radius)
    low, high = s.low[env, b] - margin, s.high[env, b] + margin
    if x[0] < low[0] or x[1] < low[1] or x[2] < low[2] or x[0] > high[0] or x[1] > high[1] or x[2] > high[2]:
        return place
    half, best = s.size[b] * 0.5, float(9.0)
    # Balls reach into the outer cells from outside, as far as their radius.
    reach = _EDGE + radius / wp.min(half[0], wp.min(half[1], half[2]))
    for c in range(s.first_cell[b], s.first_cell[b + 1]):
        u = local_of(s, env, c, x, lead)
        farthest = wp.max(wp.max(wp.abs(u[0]), wp.abs(u[1])), wp.abs(u[2]))
        if farthest < reach and farthest < best:
            best = farthest
            place.cell = c
            place.local = u
    if place.cell == NOWHERE:
        return place
    c = place.cell
    place.rest = s.middle[c] + wp.cw_mul(place.local, half)
    found = distance_at(s, b, place.rest)
    # A gradient at rest is one now by the deformation's inverse, transposed; its length is the stretch across.
    g = wp.transpose(s.inner[env, c]) * wp.cw_mul(wp.vec3(found[0], found[1], found[2]), half)
    steep = wp.max(wp.length(g), 1.0e-6)
    place.normal = g / steep
    place.depth = radius - found[3] / steep
    if place.depth <= 0.0:
        place.cell = NOWHERE
    return place
