"""One implicit step of elastic solids, as functions of single cells, nodes and sites; launches are in ``launches``.

With x0 the nodes at its beginning and d what they move, a step of h seconds solves ``s M (d - d') = f(x0 + d)`` with
BDF2: ``s = 9 / (4 h^2)``, ``d' = dp / 3 + (2 h / 3) (4 v0 - v_1) / 3``, where dp is what the step before moved and v_1
the velocity before it; the new velocity is ``3 (d - dp / 3) / (2 h)``. Forces are linearised once, at d = dp, where a
solid that rests or moves evenly is when the step ends, so that its contacts are known. Euler's method, which is of
first order, would take 90 % of a beam's swing in 1.5 s at 2 ms; this takes 1 %. The first step after a state was
written is Euler's, ``s = 1 / h^2``, for it has no step before it.

Elasticity is corotational: each cell has one rotation R, from its deformation at the middle (Muller et al., "A robust
method to extract the rotational part of deformations", 2016), and pulls its nodes with ``-R K (R^T y - X)``. With R
held fixed in its derivative the matrix is symmetric and never indefinite, and regains its shape from any positions.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportInvalidTypeForm=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_matter.bodies import Bodies, turn_by
from orbit_matter.contact import NEAREST, Felt, surface
from orbit_matter.kernels import FREE, Links, Particles, target
from orbit_matter.solids import inside
from orbit_matter.solids.inside import MIDDLE, NODES, Insides
from orbit_matter.surfaces import Shapes

TURNS = wp.constant(4)
"""Iterations of a cell's rotation in a step, from that of the step before."""
FIRST_TURNS = wp.constant(30)
"""The same, from scratch."""
NONE = wp.constant(-1)
LANES = 32
"""Rows of the preconditioner that a CPU computes at a time; solids begin at multiples of it."""
FOUR = wp.constant(4)
"""Environments that share a pass over the preconditioner."""

Column = wp.types.vector(length=81, dtype=float)
Lanes = wp.types.vector(length=LANES, dtype=float)


@wp.struct
class Solids:
    """State of (N, n) nodes, and what does not differ between environments."""

    x: wp.array2d[wp.vec3]
    """(N, n) m at the beginning of the step."""
    v: wp.array2d[wp.vec3]
    """(N, n) m/s."""
    before: wp.array2d[wp.vec3]
    """Velocity before the last step."""
    d: wp.array2d[wp.vec3]
    """What the last step moved."""
    fresh: wp.array2d[int]
    """(N, B) 1 where no step came before the next one."""
    turn: wp.array2d[wp.quat]
    """(N, C) rotation of each cell, from the axes of its mesh."""
    body_turn: wp.array2d[wp.quat]
    """(N, B) mean rotation of each solid, by which its preconditioner is turned."""
    parameters: wp.array3d[float]
    """(N, D, 4) scales of mass, stiffness and bending stiffness, and friction, of each deformable."""
    mass: wp.array[float]
    """(n,) kg, before the environment's scale."""
    body: wp.array[int]
    """(n,) solid of each node."""
    owner: wp.array[int]
    """(B,) deformable of each solid."""
    damping: wp.array[float]
    """(B,) s"""
    cells: wp.array2d[int]
    """(C, 27) nodes."""
    cell_body: wp.array[int]
    """(C,) solid of each cell."""
    kind: wp.array[int]
    """(C,) row of each cell in ``stiffness``."""
    size: wp.array[wp.vec3]
    """(B,) edges of a cell."""
    stiffness: wp.array2d[Column]
    """(K, 81) columns of each kind of cell."""
    first_cell: wp.array[int]
    """(B + 1,)"""
    first_node: wp.array[int]
    """(B + 1,)"""
    first_row: wp.array[int]
    """(B + 1,) of each solid in ``rows``, which begin at multiples of LANES."""
    inverse: wp.array[Lanes]
    """Preconditioners of free solids and of those that the scene attaches: blocks of LANES rows, column by column."""
    flat_inverse: wp.array2d[float]
    """The same memory, LANES to a row."""
    inverse_at: wp.array2d[int]
    """(B, 2) where each begins."""
    inside: Insides
    """Search structure for points of matter within solids."""
    load: wp.array2d[wp.vec3]
    """(N, n) newtons of cloth and ropes on nodes, summed over the substeps since the last step."""


@wp.struct
class Solve:
    """Memory of conjugate gradients."""

    delta: wp.array2d[wp.vec3]
    """(N, n) m, correction of the displacements: the solution."""
    r: wp.array2d[wp.vec3]
    """(N, n) N, residual."""
    z: wp.array2d[wp.vec3]
    """(N, n) m, preconditioned residual."""
    p: wp.array2d[wp.vec3]
    """(N, n) m, direction of search."""
    q: wp.array2d[wp.vec3]
    """(N, n) N, matrix times the direction of search."""
    rows: wp.array2d[float]
    """(N, D) a vector in the axes of the mesh of each solid, and what the preconditioner makes of it."""
    out: wp.array2d[float]
    """(N, D) product of the preconditioner and ``rows``."""
    out_lanes: wp.array2d[Lanes]
    """The same memory as ``out``."""
    rz: wp.array2d[float]
    """(N, B) product of each solid's residual and what the preconditioner makes of it."""
    step: wp.array2d[float]
    """(N, B) along the direction of search: each group has its own, so that no other's contacts slow it down."""
    turned: wp.array2d[float]
    """(N, B) ``rz`` of another iteration: on a CPU of the one before, of each solid; on a GPU of this one."""
    group: wp.array2d[int]
    """(N, B) lowest number of the solids that touch each other in this step: they are solved as one."""
    preset: wp.array2d[int]
    """(N, B) 1 where a solid is attached as its scene says, which its second preconditioner is for."""


@wp.struct
class Sites:
    """Points that follow nodes: those of contact first, then the vertices of meshes."""

    x: wp.array2d[wp.vec3]
    """(N, S) m."""
    v: wp.array2d[wp.vec3]
    """(N, S) m/s."""
    cell: wp.array[int]
    """(S,) cell that each point is in."""
    weights: wp.array2d[float]
    """(S, 27) shares of the cell's nodes."""
    stiffness: wp.array[wp.mat33]
    """(contacts,) N/m: ``n^T stiffness n`` along a normal n, in the axes of the mesh."""
    hold: wp.array[float]
    """(V,) N/m of what holds vertices."""
    whole: wp.array2d[float]
    """(N, S) N/m of its contact or hold in this step, before anything gives way."""
    owner: wp.array[int]
    """(S,) index of the deformable."""
    contacts: int
    """Number of points of contact; vertices come after them."""
    link: wp.array2d[int]
    """(N, S) link that it presses on or is held by, or NONE; of the last step until it is found again. Solids have the
    numbers after all links and the terrain."""
    mate: wp.array2d[int]
    """(N, S) cell of a solid that it presses on, or NONE."""
    mate_at: wp.array2d[wp.vec3]
    """(N, S) local coordinates in that cell."""
    rest: wp.array[wp.vec3]
    """(contacts,) m at rest, in the frame of the mesh."""
    normal: wp.array2d[wp.vec3]
    """(N, S) outward unit normal of the surface that it presses on."""
    firm: wp.array2d[wp.vec2]
    """N/m along the normal and across it, in this step."""
    force: wp.array2d[wp.vec3]
    """On the solid: where the step is linearised, and at its end."""
    last: wp.array2d[wp.vec3]
    """On the solid in the step before, from the same link."""
    pull: wp.array2d[wp.vec3]
    """Against a direction of search."""
    limit: wp.array2d[float]
    """Coefficient of friction of what it presses on."""
    stuck: wp.array2d[int]
    """(N, contacts) link on which a point sticks, from step to step, or NONE."""
    place: wp.array2d[wp.vec3]
    """Where it sticks, in the frame of that link; of a solid, in that of its mesh."""
    press: wp.array2d[wp.vec2]
    """(N, contacts) N along the normal at the end of the step, and m^2 that it acts on; 0 where a point touches
    nothing."""
    per_area: wp.array[float]
    """(B,) N/m of contacts on a square metre of each solid."""
    blocked: wp.array2d[float]
    """(N, F) part in which the engine holds each free body, between fingers or on a floor."""
    set: wp.array[int]
    """(S,) 1 for vertices that the scene attaches."""
    active: wp.array2d[int]
    """(N, S) sites with a link; ``count`` of them, on a GPU one cell after another."""
    count: wp.array[int]
    """(N,) number of sites in ``active``."""


# Rotations ---------------------------------------------------------------------------------------------------------


@wp.func
def across(s: Solids, env: int, c: int, stride: int, ahead: float) -> wp.vec3:
    """Way between the middles of two faces of a cell, the nodes moved by a part of what the last step moved them."""
    i, j = s.cells[c, MIDDLE + stride], s.cells[c, MIDDLE - stride]
    return s.x[env, i] - s.x[env, j] + (s.d[env, i] - s.d[env, j]) * ahead


@wp.func
def stretched(s: Solids, env: int, c: int, ahead: float) -> wp.mat33:
    """Return the deformation at the middle of a cell."""
    size = s.size[s.cell_body[c]]
    x, y, z = across(s, env, c, 1, ahead), across(s, env, c, 3, ahead), across(s, env, c, 9, ahead)
    return wp.matrix_from_cols(x / size[0], y / size[1], z / size[2])


@wp.func
def rotation(f: wp.mat33, q: wp.quat, turns: int) -> wp.quat:
    """Return q turned towards the rotation in f."""
    # The step of each turn shrinks as it nears the rotation: four from the last step's are exact to 1e-6.
    for _turn in range(turns):
        r = wp.quat_to_matrix(q)
        spin, scale = wp.vec3(), float(0.0)
        for axis in range(3):
            a, b = wp.vec3(r[0, axis], r[1, axis], r[2, axis]), wp.vec3(f[0, axis], f[1, axis], f[2, axis])
            spin += wp.cross(a, b)
            scale += wp.dot(a, b)
        # Where the cell is flat the scale is nearly zero, and the small number keeps the turn finite.
        spin = spin / (wp.abs(scale) + 1.0e-9)
        angle = wp.length(spin)
        if angle > 1.0e-9:
            q = wp.normalize(wp.quat_from_axis_angle(spin / angle, angle) * q)
    return q


@wp.func
def first_rotation(f: wp.mat33) -> wp.quat:
    """The rotation in f from scratch, near that of two of its axes."""
    a, b = wp.vec3(f[0, 0], f[1, 0], f[2, 0]), wp.vec3(f[0, 1], f[1, 1], f[2, 1])
    c = wp.cross(a, b)
    q = wp.quat_identity()
    if wp.length(c) > 1.0e-6:
        a = wp.normalize(a)
        c = wp.normalize(c)
        q = wp.quat_from_matrix(wp.matrix_from_cols(a, wp.cross(c, a), c))
    return rotation(f, q, FIRST_TURNS)


@wp.func
def mean_stretch(s: Solids, env: int, b: int, ahead: float) -> wp.mat33:
    """Mean deformation of a solid's cells."""
    f = wp.mat33()
    for c in range(s.first_cell[b], s.first_cell[b + 1]):
        f += stretched(s, env, c, ahead)
    return f / float(s.first_cell[b + 1] - s.first_cell[b])


@wp.func
def turn_cell(s: Solids, env: int, c: int):
    f = stretched(s, env, c, 1.0)
    s.turn[env, c] = rotation(f, s.turn[env, c], TURNS)
    if s.inside.meets == 1:
        inside.prepare_cell(s.inside, env, c, f)


@wp.func
def turn_body(s: Solids, env: int, b: int):
    s.body_turn[env, b] = rotation(mean_stretch(s, env, b, 1.0), s.body_turn[env, b], TURNS)
    if s.inside.meets == 1:
        inside.prepare_body(s.inside, env, b)


# Forces ------------------------------------------------------------------------------------------------------------


@wp.func
def stiffness_of(s: Solids, env: int, b: int) -> float:
    """Scale of a solid's stiffness."""
    return s.parameters[env, s.owner[b], 1]


@wp.func
def rate(s: Solids, env: int, b: int, h: float) -> float:
    """Velocity at the end of a step by the displacement in it, 1/s."""
    return wp.where(s.fresh[env, b] == 1, 1.0, 1.5) / h


@wp.func
def damped(s: Solids, env: int, b: int, h: float) -> float:
    """Times its stiffness that a solid resists a displacement in a step with, by its damping too."""
    return 1.0 + rate(s, env, b, h) * s.damping[b]


@wp.func
def strain_node(s: Solids, env: int, c: int, i: int, axes: wp.mat33, h: float) -> wp.vec3:
    """Displacement of a node in its cell's axes where the step is linearised, with what damping adds."""
    # Differences to the cell's middle keep their digits however far from the origin the solid is.
    node, middle, b = s.cells[c, i], s.cells[c, MIDDLE], s.cell_body[c]
    moved = s.d[env, node] - s.d[env, middle]
    arm = s.x[env, node] - s.x[env, middle] + moved
    size = s.size[b] * 0.5
    rest = wp.vec3(size[0] * float(i % 3 - 1), size[1] * float(i / 3 % 3 - 1), size[2] * float(i / 9 - 1))
    return arm @ axes - rest + (moved @ axes) * (s.damping[b] / h)


@wp.func
def inertia_of(s: Solids, env: int, i: int, h: float) -> float:
    """s M of a node."""
    by = rate(s, env, s.body[i], h)
    return by * by * s.mass[i] * s.parameters[env, s.owner[s.body[i]], 0]


@wp.func
def own_force(s: Solids, gravity: wp.array[wp.vec3], env: int, i: int, h: float) -> wp.vec3:
    """Inertia and gravity of a node at the point of linearisation."""
    # By the rate's square the inertia is the mass again, scaled in this environment.
    inertia, by = inertia_of(s, env, i, h), rate(s, env, s.body[i], h)
    free = s.v[env, i] * h
    if s.fresh[env, s.body[i]] == 0:
        free = s.d[env, i] / 3.0 + (s.v[env, i] * 4.0 - s.before[env, i]) * (2.0 * h / 9.0)
    return (free - s.d[env, i]) * inertia + gravity[env] * (inertia / (by * by)) + s.load[env, i]


# Sites -------------------------------------------------------------------------------------------------------------


@wp.func
def of_nodes(s: Solids, t: Sites, field: wp.array2d[wp.vec3], env: int, k: int) -> wp.vec3:
    """A field of nodes at a site."""
    found, c = wp.vec3(), t.cell[k]
    for i in range(NODES):
        found += field[env, s.cells[c, i]] * t.weights[k, i]
    return found


@wp.func
def relative(s: Solids, t: Sites, field: wp.array2d[wp.vec3], env: int, k: int) -> wp.vec3:
    """A field of nodes at a site, less that of the solid that it presses on."""
    found, c = of_nodes(s, t, field, env, k), t.mate[env, k]
    if c != NONE:
        found -= inside.blended(s.cells, field, env, c, t.mate_at[env, k])
    return found


@wp.func
def resist(t: Sites, env: int, k: int, moved: wp.vec3) -> wp.vec3:
    """Force against a displacement of a site."""
    return parted(t.normal[env, k], moved, t.firm[env, k])


@wp.func
def parted(n: wp.vec3, v: wp.vec3, by: wp.vec2) -> wp.vec3:
    """A vector times one number along n, and times another across it."""
    return v * by[1] + n * ((by[0] - by[1]) * wp.dot(n, v))


@wp.func
def remembered(t: Sites, env: int, k: int, link: int) -> wp.vec3:
    """Force of the last step at a site, if it was from the same link."""
    if t.link[env, k] == link:
        return t.force[env, k]
    return wp.vec3()


@wp.func
def yielding(b: Bodies, env: int, i: int, x: wp.vec3, h: float) -> float:
    """Metres that a free body gives way at x, at most, to 1 N in a step of h seconds."""
    axes = b.turning[env, i]
    most = wp.max(axes[0, 0], wp.max(axes[1, 1], axes[2, 2]))
    return h * h * (1.0 / b.mass[env, i] + wp.length_sq(x) * most)


@wp.func
def soften(t: Sites, b: Bodies, links: Links, env: int, i: int, k: int, firm: float, h: float):
    """Let a free body give way to what presses on it, at a site of it.

    Each site has a share of the body to itself, as large as its share of all firmness (Tonge et al. 2012): where all
    press alike this is exact, and elsewhere it is softer than the body, which is stable for bodies however light. What
    sites did in the last step the body has followed already.
    """
    link = b.link[env, i]
    origin = wp.transform_point(links.link[env, link], b.center[env, i])
    off = (
        yielding(b, env, i, t.x[env, k] - origin, h)
        * firm
        / wp.max(t.whole[env, k], 1.0e-9)
        * (1.0 - t.blocked[env, i])
    )
    way = t.firm[env, k]
    by = wp.vec2(1.0 / (1.0 + way[0] * off), 1.0 / (1.0 + way[1] * off))
    last = t.last[env, k]
    t.force[env, k] = last + parted(t.normal[env, k], t.force[env, k] - last, by)
    t.firm[env, k] = wp.vec2(way[0] * by[0], way[1] * by[1])


@wp.func
def moved_by(b: Bodies, links: Links, env: int, i: int, shift: wp.vec3, turn: wp.vec3):
    """Move the link of a free body by metres and a rotation vector about its centre of mass."""
    link = b.link[env, i]
    pose = links.link[env, link]
    q = wp.transform_get_rotation(pose)
    center = wp.transform_point(pose, b.center[env, i]) + shift
    q = turn_by(turn) * q
    links.link[env, link] = wp.transform(center - wp.quat_rotate(q, b.center[env, i]), q)


@wp.func
def blocked(b: Bodies, gravity: wp.vec3, env: int, i: int) -> float:
    """Part of what gravity and matter would have given a free body in the engine's last step that did not happen."""
    link = b.link[env, i]
    asked = wp.vec3(b.wrenches[env, link, 0], b.wrenches[env, link, 1], b.wrenches[env, link, 2]) / b.mass[env, i]
    asked += gravity
    # A body that floats on matter is asked for nothing, and noise over nothing would look like a hold.
    least = 0.1 * wp.length_sq(gravity)
    missing = wp.dot(gravity - b.pull[env, i], asked) / (wp.length_sq(asked) + least + 1.0e-9)
    return wp.clamp(missing * 1.1, 0.0, 1.0)


@wp.func
def mated(s: Solids, t: Sites, env: int, k: int) -> inside.Place:
    """Return where a point of contact is deepest in another solid, or in one that may touch itself."""
    own, x = s.cell_body[t.cell[k]], t.x[env, k] + of_nodes(s, t, s.d, env, k)
    best = inside.Place()
    best.cell = NONE
    for b in range(s.owner.shape[0]):
        if b != own or s.inside.touches[b] == 1:
            found = inside.found_in(s.inside, env, b, x, 0.0, 1.0)
            # What is near at rest touches already.
            near = b == own and wp.length(found.rest - t.rest[k]) < s.inside.reach[b]
            if found.cell != NONE and not near and (best.cell == NONE or found.depth > best.depth):
                best = found
    return best


@wp.func
def at_rest(s: Solids, t: Sites, links: Links, env: int, k: int, x: wp.vec3, link: int) -> wp.vec3:
    """Return where a point that touches is, in the frame of the link, or of the mesh of the solid, that it touches."""
    c = t.mate[env, k]
    if c == NONE:
        return wp.transform_point(wp.transform_inverse(links.link[env, link]), x)
    return s.inside.middle[c] + wp.cw_mul(t.mate_at[env, k], s.size[s.cell_body[c]] * 0.5)


@wp.func
def stuck_at(s: Solids, t: Sites, links: Links, moved: wp.array2d[wp.vec3], env: int, k: int, link: int) -> wp.vec3:
    """Return where the place that a point sticks to is, with what the nodes of a solid moved."""
    c = t.mate[env, k]
    if c == NONE:
        return wp.transform_point(links.link[env, link], t.place[env, k])
    # By the cell that is touched now, also where the place is a little outside of it.
    u = wp.cw_div(t.place[env, k] - s.inside.middle[c], s.size[s.cell_body[c]] * 0.5)
    return inside.blended(s.cells, s.x, env, c, u) + inside.blended(s.cells, moved, env, c, u)


@wp.func
def touch(
    s: Solids, t: Sites, links: Links, shapes: Shapes, felt: Felt, parameters: wp.array3d[float], env: int, k: int
) -> bool:
    """Linearise the contact of a point, with the shape that it is deepest in; True if it is in any.

    Friction is a bristle: it sticks to a place on the link, as firm as the contact, up to Coulomb's limit, and the
    place is dragged along beyond it. A point that holds does not creep.
    """
    # One surface only: what two fingers hold has its two sides at other points.
    deepest, shape, n, x = float(0.0), int(-1), wp.vec3(), wp.vec3()
    t.mate[env, k] = NONE
    if s.inside.meets == 1:
        met = mated(s, t, env, k)
        if met.cell != NONE:
            deepest = met.depth
            t.mate[env, k] = met.cell
            t.mate_at[env, k] = met.local
            n = met.normal
            x = t.x[env, k] + of_nodes(s, t, s.d, env, k)
    near = int(0)
    kind = env % shapes.kind.shape[0]
    while near < NEAREST:
        found = felt.near[env, k, near]
        near += 1
        if found < 0:
            near = NEAREST
        else:
            # Only where there is a shape near: the position of a site costs a sum over 27 nodes.
            if near == 1:
                x = t.x[env, k] + of_nodes(s, t, s.d, env, k)
            way = surface(links, shapes, env, kind, found, x, 0.0)
            if way[3] > deepest:
                deepest = way[3]
                shape = found
                n = wp.vec3(way[0], way[1], way[2])
                t.mate[env, k] = NONE
    if deepest <= 0.0:
        t.link[env, k] = NONE
        t.stuck[env, k] = NONE
        t.press[env, k] = wp.vec2()
        return False
    link, pressed_on = int(0), t.mate[env, k]
    other, friction = s.cell_body[wp.max(pressed_on, 0)], float(0.0)
    if pressed_on != NONE:
        link = links.link.shape[1] + other
        friction = parameters[env, s.owner[other], 3]
    else:
        link = shapes.link[kind, shape]
        friction = felt.friction[env, shape]
    t.last[env, k] = remembered(t, env, k, link)
    # Firmness is that of the area that faces the surface: a point at an edge also has the area of its other side.
    facing = wp.quat_rotate_inv(s.turn[env, t.cell[k]], n)
    firm = wp.dot(facing, t.stiffness[k] * facing)
    if pressed_on != NONE:
        firm = firm * s.inside.share[s.cell_body[t.cell[k]], other]
    t.whole[env, k] = firm
    if t.stuck[env, k] != link:
        t.stuck[env, k] = link
        t.place[env, k] = at_rest(s, t, links, env, k, x, link)
    slip = x - stuck_at(s, t, links, s.d, env, k, link)
    slip = slip - n * wp.dot(n, slip)
    friction = wp.max(parameters[env, t.owner[k], 3], friction)
    # What presses now is not known before the solution, where points at an edge may let go; it is as in the last step.
    most, across = friction * wp.max(wp.dot(n, t.last[env, k]), 0.0), float(firm)
    if firm * wp.length(slip) >= most:
        # Beyond Coulomb's limit the bristle has the secant's firmness, which keeps the matrix symmetric.
        across = most / wp.max(wp.length(slip), 1.0e-12)
    t.link[env, k] = link
    t.normal[env, k] = n
    t.firm[env, k] = wp.vec2(firm, across)
    t.force[env, k] = n * (firm * deepest) - slip * across
    t.limit[env, k] = friction
    return True


@wp.func
def grip(s: Solids, t: Sites, held: Particles, links: Links, env: int, k: int) -> bool:
    """Linearise what holds a vertex; True if it is held."""
    # Vertices come after all points of contact.
    vertex = k - t.contacts
    link = held.anchor[env, vertex]
    if link == FREE:
        t.link[env, k] = NONE
        return False
    x, firm = t.x[env, k] + of_nodes(s, t, s.d, env, k), t.hold[vertex]
    t.whole[env, k] = firm
    felt = int(link)
    if link < 0:
        felt = links.link.shape[1] - 1  # the world stands still, as terrain does
    t.last[env, k] = remembered(t, env, k, felt)
    t.link[env, k] = felt
    t.normal[env, k] = wp.vec3(0.0, 0.0, 1.0)
    t.firm[env, k] = wp.vec2(firm, firm)
    t.force[env, k] = (target(held, links, env, vertex) - x) * firm
    return True


@wp.func
def let_slip(s: Solids, t: Sites, links: Links, solve: Solve, env: int, k: int):
    """Forces of a site at the end of the step, and where a point that slid sticks from now on."""
    force = t.force[env, k] - resist(t, env, k, relative(s, t, solve.delta, env, k))
    t.force[env, k] = force
    # Held vertices neither slide nor let go.
    if k >= t.contacts:
        return
    n, firm = t.normal[env, k], wp.max(t.whole[env, k], 1.0e-9)
    link, c = t.link[env, k], t.mate[env, k]
    # Firmness over that of a square metre is the area that faces the surface.
    area = firm / t.per_area[s.cell_body[t.cell[k]]]
    t.press[env, k] = wp.vec2(wp.max(wp.dot(n, force), 0.0), area)
    x = t.x[env, k] + of_nodes(s, t, s.d, env, k) + of_nodes(s, t, solve.delta, env, k)
    slip = x - stuck_at(s, t, links, s.d, env, k, link)
    if c != NONE:
        u = wp.cw_div(t.place[env, k] - s.inside.middle[c], s.size[s.cell_body[c]] * 0.5)
        slip -= inside.blended(s.cells, solve.delta, env, c, u)
    slip = slip - n * wp.dot(n, slip)
    most, length = t.limit[env, k] * wp.max(wp.dot(n, force), 0.0) / firm, wp.length(slip)
    if c != NONE:
        # What is beyond the limit drags the place along, in the axes of the cell.
        if length > most:
            way = s.inside.inner[env, c] * (slip * (1.0 - most / length))
            t.place[env, k] = t.place[env, k] + wp.cw_mul(way, s.size[s.cell_body[c]] * 0.5)
        return
    if length > most:
        slip = slip * (most / length)
    t.place[env, k] = wp.transform_point(wp.transform_inverse(links.link[env, link]), x - slip)


@wp.func
def press(t: Sites, felt: Felt, links: Links, env: int, k: int, share: float):
    """Add what a site does to its link, which one thread adds to at a time."""
    link = t.link[env, k]
    # Terrain has the number after all links, and feels nothing.
    if link < felt.torques.shape[1]:
        force, x = t.force[env, k] * -share, t.x[env, k]
        felt.forces[env, t.owner[k], link] = felt.forces[env, t.owner[k], link] + force
        arm = x - wp.transform_get_translation(links.link[env, link])
        felt.torques[env, link] = felt.torques[env, link] + wp.cross(arm, force)


@wp.func
def show(s: Solids, t: Sites, env: int, k: int):
    """Put a site where its nodes are."""
    # One pass for both: nodes and weights are looked up once.
    x, v, c = wp.vec3(), wp.vec3(), t.cell[k]
    for i in range(NODES):
        node, weight = s.cells[c, i], t.weights[k, i]
        x += s.x[env, node] * weight
        v += s.v[env, node] * weight
    t.x[env, k] = x
    t.v[env, k] = v


# Solve -------------------------------------------------------------------------------------------------------------


@wp.func
def to_rows(s: Solids, solve: Solve, env: int, i: int):
    """Turn a node's residual into the axes of its solid's mesh."""
    b = s.body[i]
    local = wp.quat_rotate_inv(s.body_turn[env, b], solve.r[env, i])
    first = s.first_row[b] + 3 * (i - s.first_node[b])
    for axis in range(3):
        solve.rows[env, first + axis] = local[axis]


@wp.func
def turned_back(s: Solids, solve: Solve, env: int, i: int) -> wp.vec3:
    """Return the preconditioned residual of a node, in the axes of the world."""
    b = s.body[i]
    first = s.first_row[b] + 3 * (i - s.first_node[b])
    local = wp.vec3(solve.out[env, first], solve.out[env, first + 1], solve.out[env, first + 2])
    return wp.quat_rotate(s.body_turn[env, b], local)


@wp.func
def quotient(a: float, b: float) -> float:
    """Return a / b, or 0 where b is not above it: what has converged stays."""
    if b > 0.0:
        return a / b
    return 0.0


@wp.func
def conclude_node(s: Solids, solve: Solve, env: int, i: int, h: float):
    """Take a node to the end of the step."""
    d, before = s.d[env, i] + solve.delta[env, i], s.d[env, i] / 3.0
    if s.fresh[env, s.body[i]] == 1:
        before = wp.vec3()
    s.before[env, i] = s.v[env, i]
    s.v[env, i] = (d - before) * rate(s, env, s.body[i], h)
    s.d[env, i] = d
    s.x[env, i] = s.x[env, i] + d


@wp.func
def group_solids(s: Solids, t: Sites, solve: Solve, env: int):
    """Number the groups of solids that touch each other."""
    count = s.owner.shape[0]
    for b in range(count):
        solve.group[env, b] = b
    if s.inside.meets == 1:
        for k in range(t.contacts):
            if t.mate[env, k] != NONE:
                join(s, t, solve, env, k)


@wp.func
def join(s: Solids, t: Sites, solve: Solve, env: int, k: int):
    """Join the groups of two solids that touch each other at a site."""
    one = int(solve.group[env, s.cell_body[t.cell[k]]])
    other = int(solve.group[env, s.cell_body[t.mate[env, k]]])
    if one != other:
        for i in range(s.owner.shape[0]):
            if solve.group[env, i] == wp.max(one, other):
                solve.group[env, i] = wp.min(one, other)


@wp.func
def is_preset(t: Sites, held: Particles, s: Solids, env: int, b: int) -> int:
    """1 if all vertices of a solid that the scene attaches are held, and there are any."""
    found, missing = int(0), int(0)
    for vertex in range(held.x.shape[1]):
        k = t.contacts + vertex
        if t.set[k] == 1 and t.owner[k] == s.owner[b]:
            if held.anchor[env, vertex] == FREE:
                missing = 1
            else:
                found = 1
    return wp.where(missing == 1, 0, found)
