"""One substep of extended position-based dynamics, as launches over environments and particles or constraints.

Macklin et al., "XPBD: position-based simulation of compliant constrained dynamics" (2016) and "Small steps in physics
simulation" (2019): one sweep over all constraints in each of many substeps, and some more over those of membranes;
multipliers start from zero in each substep.
Positions stand still during a substep and displacements are summed apart from them, so that velocities keep their
digits however far from the origin a particle is.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false
# ruff: noqa: UP018 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_matter.surfaces import Shapes

HELD = wp.constant(100.0)
"""Times its mass that a held particle of cloth counts in constraints: it hardly moves, and what pulls it back is the
force that holds it. Particles of ropes, whose solve no ratio of masses disturbs, count its square: under a tension T
an edge gives way by ``T h^2`` over that mass."""
FREE = wp.constant(-2)
"""In the place of the link that holds a particle: none does."""
WORLD = wp.constant(-1)


TAUT = wp.constant(3.0)
"""``(w h)^2`` of the fastest wave across a rope up to which its edges pull along their directions at the beginning."""
LATE = wp.constant(0.52)
"""Part of a rope's elastic forces, of edges and of bending, that is taken from the end of the substep and not from its
beginning: a half keeps the energy of its vibrations, and what is more damps those that the substep cannot follow."""
ATTEMPTS = wp.constant(4)
"""Steps of Newton's method at most, for all edges of a rope in a substep."""
PRECISE = wp.constant(1.0e-5)
"""Part of its length that an edge may be off after them."""
ROUNDING = wp.constant(3.0e-7)
"""Part of a particle's position that single precision does not resolve in an edge."""
LOOSE = wp.constant(1.0e-2)
"""The same, above which they are taken for not to converge."""
SWEEPS = wp.constant(20)
"""Over the edges one by one, where they do not."""
TURNED = wp.constant(0.5)
"""Cosine of the angle that an edge may turn in a substep and still pull along the direction that it had before."""
BUCKLED = wp.constant(50.0)
"""Times as soft as in tension that cloth is along its axes in compression, where it buckles between particles."""


@wp.struct
class Particles:
    """State of (N, P) particles, and what does not differ between environments."""

    x: wp.array2d[wp.vec3]
    """(N, P) m at the beginning of the substep."""
    d: wp.array2d[wp.vec3]
    """Displacement in this substep."""
    v: wp.array2d[wp.vec3]
    """(N, P) m/s."""
    anchor: wp.array2d[int]
    """Link that holds it, WORLD or FREE."""
    place: wp.array2d[wp.vec3]
    """Where it is held, in the link's frame."""
    solved: wp.array2d[int]
    """(N, P) 1 where it is attached to a free body, which the solve moves together with it."""
    exempt: wp.array2d[int]
    """(N, P) link with which a particle does not collide: it was inside of it when its matter was attached there."""
    mass: wp.array[float]
    """(P,) kg, before the environment's scale in ``parameters``."""
    held: wp.array[float]
    """(P,) times its mass that it counts in constraints where a link holds it."""
    w: wp.array2d[float]
    """(N, P) inverse masses as constraints take them, of this physics step."""
    radius: wp.array[float]
    """(P,) m within which surfaces touch a particle."""
    kept: wp.array[float]
    """Part of its velocity that the air leaves it in a substep."""
    owner: wp.array[int]
    """(P,) index of the deformable in the scene."""
    parameters: wp.array3d[float]
    """(N, D, 4) scales of mass, stiffness and bending stiffness, and friction."""


@wp.struct
class Links:
    """Poses of links and shapes at both ends of the substep. Link L is the terrain."""

    start: wp.array3d[float]
    """(N, L, 7) at the beginning of the physics step."""
    end: wp.array3d[float]
    """(N, L, 7) at the end of the physics step; of free bodies, where they are expected then."""
    link: wp.array2d[wp.transform]
    """(N, L + 1) at the end of the substep."""
    shape: wp.array2d[wp.transform]
    """(N, S) at the end of the substep."""
    shape_before: wp.array2d[wp.transform]
    """(N, S) at the beginning of the substep."""
    axes: wp.array2d[wp.mat33]
    """(N, S) turn vectors of a shape's frame into the world's."""
    way: wp.array2d[wp.vec3]
    """(N, S) that a shape's origin goes in the substep."""
    turn: wp.array2d[wp.quat]
    """(N, S) by which it turns in the substep; zero but for its last number where it does not."""
    reach: wp.array2d[float]
    """(N, S) metres from a shape's origin within which it is or comes in this physics step."""


@wp.func
def mass_of(p: Particles, env: int, i: int) -> float:
    """Kilograms of a particle in its environment."""
    return p.mass[i] * p.parameters[env, p.owner[i], 0]


@wp.kernel(enable_backward=False)
def weigh(p: Particles):
    """Inverse masses for the physics step to come."""
    env, i = wp.tid()
    w = 1.0 / mass_of(p, env, i)
    if p.anchor[env, i] == WORLD:
        # Infinite mass: what is pinned to the world gives way to nothing.
        w = float(0.0)
    elif p.anchor[env, i] != FREE:
        w = w / p.held[i]
    p.w[env, i] = w


@wp.func
def pose_between(start: wp.array3d[float], end: wp.array3d[float], env: int, link: int, share: float) -> wp.transform:
    """Evenly on the way from one pose (w, x, y, z) to the other."""
    a, b = start, end
    p0 = wp.vec3(a[env, link, 0], a[env, link, 1], a[env, link, 2])
    p1 = wp.vec3(b[env, link, 0], b[env, link, 1], b[env, link, 2])
    q0 = wp.quat(a[env, link, 4], a[env, link, 5], a[env, link, 6], a[env, link, 3])
    q1 = wp.quat(b[env, link, 4], b[env, link, 5], b[env, link, 6], b[env, link, 3])
    # Both signs are the same orientation: the nearer one, or the link would turn the long way round.
    if wp.dot(q0, q1) < 0.0:
        q1 = -q1
    return wp.transform(p0 + (p1 - p0) * share, wp.normalize(q0 * (1.0 - share) + q1 * share))


@wp.kernel(enable_backward=False)
def place_links(links: Links, count: int, share: float):
    env, link = wp.tid()
    pose = wp.transform_identity()
    # The last row is the terrain, which no engine link carries.
    if link < count:
        pose = pose_between(links.start, links.end, env, link, share)
    links.link[env, link] = pose


@wp.func
def turn_between(before: wp.quat, after: wp.quat) -> wp.quat:
    """``after`` times the inverse of ``before``, exactly no turn where they are the same."""
    a, b = wp.vec3(after[0], after[1], after[2]), wp.vec3(before[0], before[1], before[2])
    v = (b * -after[3]) + a * before[3] - wp.cross(a, b)
    # Products of equal quaternions round to tiny turns, which would rub on what rests on a fixed shape.
    if after == before:
        v = wp.vec3()
    return wp.quat(v, after[3] * before[3] + wp.dot(a, b))


@wp.kernel(enable_backward=False)
def place_shapes(links: Links, shapes: Shapes, first: int):
    env, shape = wp.tid()
    kind = env % shapes.kind.shape[0]
    # On the first call of a step there is no earlier pose: shapes then count as unmoved. On a call with a 2 they are
    # placed anew in the substep, and what they moved in it is still from where the last one left them.
    if first == 0:
        links.shape_before[env, shape] = links.shape[env, shape]
    pose = links.link[env, shapes.link[kind, shape]] * shapes.pose[kind, shape]
    links.shape[env, shape] = pose
    if first == 1:
        links.shape_before[env, shape] = pose
    before = links.shape_before[env, shape]
    links.axes[env, shape] = wp.quat_to_matrix(wp.transform_get_rotation(pose))
    links.way[env, shape] = wp.transform_get_translation(pose) - wp.transform_get_translation(before)
    links.turn[env, shape] = turn_between(wp.transform_get_rotation(before), wp.transform_get_rotation(pose))


@wp.func
def go_on(p: Particles, links: Links, gravity: wp.array[wp.vec3], h: float, env: int, i: int):
    """Predict a particle's displacement without forces between particles; a held one goes with its link."""
    link = p.anchor[env, i]
    if link == FREE:
        v = (p.v[env, i] + gravity[env] * h) * p.kept[i]
        p.d[env, i] = v * h
    else:
        p.d[env, i] = target(p, links, env, i) - p.x[env, i]


@wp.kernel(enable_backward=False)
def predict(p: Particles, links: Links, gravity: wp.array[wp.vec3], h: float):
    env, i = wp.tid()
    go_on(p, links, gravity, h, env, i)


@wp.kernel(enable_backward=False)
def hold(p: Particles, links: Links, chosen: wp.array[bool]):
    """Note the places of held particles in the frames of the links that hold them, at their poses ``links.end``."""
    env, i = wp.tid()
    link = p.anchor[env, i]
    if chosen[env] and link != FREE:
        place = p.x[env, i]
        if link != WORLD:
            pose = pose_between(links.end, links.end, env, link, 0.0)
            place = wp.transform_point(wp.transform_inverse(pose), place)
        p.place[env, i] = place


@wp.func
def target(p: Particles, links: Links, env: int, i: int) -> wp.vec3:
    """Return the position that a held particle has at the end of the substep."""
    link = p.anchor[env, i]
    if link == WORLD:
        return p.place[env, i]
    return wp.transform_point(links.link[env, link], p.place[env, i])


@wp.func
def at(p: Particles, env: int, i: int) -> wp.vec3:
    """Return the position of a particle now: its displacement added."""
    return p.x[env, i] + p.d[env, i]


@wp.func
def push(p: Particles, env: int, i: int, by: wp.vec3):
    """Displace a particle, which no other constraint of the colour does."""
    p.d[env, i] = p.d[env, i] + by


# Triangles ---------------------------------------------------------------------------------------------------------


@wp.struct
class Triangles:
    """Saint Venant-Kirchhoff membranes: three strains of each triangle."""

    particles: wp.array2d[int]
    """(C, 3) corners."""
    weights: wp.array2d[float]
    """(C, 6) inverse of the 2 x 2 matrix of edges at rest, row by row; ``1 / (E t A)``, 1/J; Poisson's ratio."""
    owner: wp.array[int]
    """(C,) index of the deformable."""
    multiplier: wp.array2d[wp.vec3]
    """(N, C) of this substep's sweeps so far."""


@wp.struct
class Stretch:
    """Deformed axes of a triangle, and how its particles move them."""

    f0: wp.vec3
    """Image of the first material axis: the first column of the deformation gradient."""
    f1: wp.vec3
    """Image of the second material axis."""
    a0: float
    """1/m, share of the second particle in ``f0``; the first particle's is minus the sum of the others'."""
    a1: float
    """1/m, share of the second particle in ``f1``."""
    b0: float
    """1/m, share of the third particle in ``f0``."""
    b1: float
    """1/m, share of the third particle in ``f1``."""


@wp.func
def stretch_of(p: Particles, t: Triangles, env: int, c: int) -> Stretch:
    s = Stretch()
    base = at(p, env, t.particles[c, 0])
    e1, e2 = at(p, env, t.particles[c, 1]) - base, at(p, env, t.particles[c, 2]) - base
    s.a0 = t.weights[c, 0]
    s.a1 = t.weights[c, 1]
    s.b0 = t.weights[c, 2]
    s.b1 = t.weights[c, 3]
    s.f0 = e1 * s.a0 + e2 * s.b0
    s.f1 = e1 * s.a1 + e2 * s.b1
    return s


@wp.func
def pull_triangle(p: Particles, t: Triangles, env: int, c: int, s: Stretch, change: wp.vec3):
    """Move the particles by a change of multipliers."""
    # Gradients: of strains (f0.f0 - 1)/2, (f1.f1 - 1)/2 and f0.f1.
    g1 = s.f0 * (s.a0 * change[0] + s.a1 * change[2]) + s.f1 * (s.a1 * change[1] + s.a0 * change[2])
    g2 = s.f0 * (s.b0 * change[0] + s.b1 * change[2]) + s.f1 * (s.b1 * change[1] + s.b0 * change[2])
    i, j, k = t.particles[c, 0], t.particles[c, 1], t.particles[c, 2]
    push(p, env, i, -(g1 + g2) * p.w[env, i])
    push(p, env, j, g1 * p.w[env, j])
    push(p, env, k, g2 * p.w[env, k])


@wp.func
def solve_symmetric(a: float, b: float, c: float, d: float, e: float, f: float, r: wp.vec3) -> wp.vec3:
    """Solve the system of matrix rows (a, b, c), (b, d, e), (c, e, f) for the right side r, by cofactors."""
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
    x = wp.vec3(aa * r[0] + ab * r[1] + ac * r[2], ab * r[0] + bb * r[1] + bc * r[2], ac * r[0] + bc * r[1] + cc * r[2])
    return x / (a * aa + b * ab + c * ac)


@wp.func
def solve_triangle(p: Particles, t: Triangles, h: float, sweep: int, sweeps: int, env: int, c: int):
    s = stretch_of(p, t, env, c)
    w0 = p.w[env, t.particles[c, 0]]
    w1 = p.w[env, t.particles[c, 1]]
    w2 = p.w[env, t.particles[c, 2]]
    # f0 and f1 move by M times a force on them, where M = A W A^T; J W J^T follows from it.
    m00 = w0 * (s.a0 + s.b0) * (s.a0 + s.b0) + w1 * s.a0 * s.a0 + w2 * s.b0 * s.b0
    m01 = w0 * (s.a0 + s.b0) * (s.a1 + s.b1) + w1 * s.a0 * s.a1 + w2 * s.b0 * s.b1
    m11 = w0 * (s.a1 + s.b1) * (s.a1 + s.b1) + w1 * s.a1 * s.a1 + w2 * s.b1 * s.b1
    l0, l1, x = wp.dot(s.f0, s.f0), wp.dot(s.f1, s.f1), wp.dot(s.f0, s.f1)
    soft = t.weights[c, 4] / (h * h * p.parameters[env, t.owner[c], 1])
    nu = t.weights[c, 5]
    # Compliance matrix of plane stress, the multipliers' share of the strain.
    c00, c11 = soft * wp.where(l0 < 1.0, BUCKLED, 1.0), soft * wp.where(l1 < 1.0, BUCKLED, 1.0)
    c01, c22 = -nu * soft, 2.0 * (1.0 + nu) * soft
    k00, k11, k22 = m00 * l0 + c00, m11 * l1 + c11, m00 * l1 + 2.0 * m01 * x + m11 * l0 + c22
    k01, k02, k12 = m01 * x + c01, m00 * x + m01 * l0, m01 * l1 + m11 * x
    residual = wp.vec3(0.5 * (l0 - 1.0), 0.5 * (l1 - 1.0), x)
    # Only later sweeps have multipliers; in the first they are zero, and reading them would cost memory traffic.
    if sweep > 0:
        a = t.multiplier[env, c]
        residual += wp.vec3(c00 * a[0] + c01 * a[1], c01 * a[0] + c11 * a[1], c22 * a[2])
    change = -solve_symmetric(k00, k01, k02, k11, k12, k22, residual)
    pull_triangle(p, t, env, c, s, change)
    if sweep == 0 and sweeps > 1:
        t.multiplier[env, c] = change
    # The last sweep's multipliers are read by nobody.
    elif sweep + 1 < sweeps:
        t.multiplier[env, c] = t.multiplier[env, c] + change


@wp.kernel(enable_backward=False)
def solve_triangles(p: Particles, t: Triangles, first: int, h: float, sweep: int, sweeps: int):
    env, number = wp.tid()
    solve_triangle(p, t, h, sweep, sweeps, env, first + number)


# Edges of ropes ------------------------------------------------------------------------------------------------------


@wp.struct
class Edges:
    """Distances between a rope's particles, in a row."""

    particles: wp.array2d[int]
    """(E, 2) ends."""
    weights: wp.array2d[float]
    """(E, 2) length at rest, m; compliance ``l / (E A)``, m/N."""
    owner: wp.array[int]
    """(E,) index of the deformable."""
    ranges: wp.array2d[int]
    """(R, 2) first edge, and one past the last, of each rope."""
    upper: wp.array2d[float]
    """(N, E) scratch of the elimination, and the multipliers."""
    value: wp.array2d[float]
    """(N, E) right side of the elimination, then the change of each multiplier."""
    total: wp.array2d[float]
    """(N, E) multipliers of the substep."""
    spread: wp.array2d[float]
    """(N, P) scratch of the elimination for taut ropes."""
    moved: wp.array2d[wp.vec3]
    """(N, P) scratch for displacements: those without forces, then those of the elimination for taut ropes."""


@wp.struct
class Edge:
    """An edge in a substep: its direction at the beginning, with which it pulls, and the one that it has now."""

    n: wp.vec3
    """Unit direction at the beginning of the substep, unless the edge has turned too far since: then the one now."""
    now: wp.vec3
    """Unit direction now."""
    length: float
    """Metres, now."""
    was: float
    """Metres at the beginning of the substep."""


@wp.func
def edge_of(p: Particles, e: Edges, env: int, c: int) -> Edge:
    i, j = e.particles[c, 0], e.particles[c, 1]
    found, arm = Edge(), at(p, env, j) - at(p, env, i)
    found.length = wp.length(arm)
    found.now = arm / found.length
    arm = p.x[env, j] - p.x[env, i]
    found.was = wp.length(arm)
    found.n = arm / found.was
    # An edge that has turned further would be stretched by a pull along its old direction, and not shortened.
    if wp.dot(found.n, found.now) < TURNED:
        found.n = found.now
    return found


@wp.func
def lateness(p: Particles, e: Edges, env: int, c: int) -> float:
    """Return how far along an edge's turn of this substep its pull across must be taken: 0 unless it is too taut."""
    w = wp.max(p.w[env, e.particles[c, 0]], p.w[env, e.particles[c, 1]])
    return wp.max(0.0, 0.5 - 0.5 * TAUT * e.weights[c, 0] / wp.max(-4.0 * w * e.total[env, c], 1.0e-30))


@wp.func
def soften(p: Particles, e: Edges, env: int, first: int, stop: int):
    """Take the pull across edges that are too taut for the substep from their directions later in it.

    With ``(w h)^2`` of the fastest wave, 4 T h^2 / (m l), above 4 the directions at its beginning diverge; a part of
    ``(1 - 4 / (w h)^2) / 2`` of the turn is stable at any tension, and damps the waves that the substep cannot follow.
    """
    k_behind = float(0.0)
    for c in range(first, stop + 1):
        i, k = int(0), float(0.0)  # noqa: RUF046
        # Past the last edge stands the rope's last particle, with no edge ahead of it.
        if c < stop:
            i = int(e.particles[c, 0])
            k = lateness(p, e, env, c) * wp.max(-e.total[env, c], 0.0) / e.weights[c, 0]
        else:
            i = int(e.particles[c - 1, 1])
        w = p.w[env, i]
        pivot, value = 1.0 + w * (k + k_behind), p.d[env, i] * 1.0
        if c > first:
            before = e.particles[c - 1, 0]
            pivot -= w * k_behind * e.spread[env, before]
            value = value + e.moved[env, before] * (w * k_behind)
        e.spread[env, i] = w * k / pivot
        e.moved[env, i] = value / pivot
        k_behind = k
    following = wp.vec3()
    for k in range(stop + 1 - first):
        c = stop - k
        i = int(e.particles[wp.min(c, stop - 1), 0])
        if c == stop:
            i = int(e.particles[c - 1, 1])
        following = e.moved[env, i] + following * e.spread[env, i]
        p.d[env, i] = following


@wp.func
def unmet(p: Particles, e: Edges, env: int, c: int, length: float, was: float, soft: float) -> float:
    """Return the metres by which an edge is too short, by its length and its pull of the substep so far."""
    rest = e.weights[c, 0]
    return rest - length + (rest - was) * ((1.0 - LATE) / LATE) - soft * e.total[env, c]


@wp.func
def softness(p: Particles, e: Edges, env: int, c: int, h: float) -> float:
    return e.weights[c, 1] / (LATE * h * h * p.parameters[env, e.owner[c], 1])


@wp.func
def pull_edges(p: Particles, e: Edges, h: float, env: int, first: int, stop: int) -> float:
    """Solve for all edges of a rope by one step of Newton's method; return the largest part of a length left over."""
    edge, before = edge_of(p, e, env, first), wp.vec3()
    for c in range(first, stop):
        following = edge
        if c + 1 < stop:
            following = edge_of(p, e, env, c + 1)
        w0 = p.w[env, e.particles[c, 0]]
        w1 = p.w[env, e.particles[c, 1]]
        soft = softness(p, e, env, c, h)
        pivot = (w0 + w1) * wp.dot(edge.now, edge.n) + soft
        value, upper = unmet(p, e, env, c, edge.length, edge.was, soft), float(0.0)
        if c > first:
            coupling = -w0 * wp.dot(edge.now, before)
            pivot -= coupling * e.upper[env, c - 1]
            value -= coupling * e.value[env, c - 1]
        if c + 1 < stop:
            upper = -w1 * wp.dot(edge.now, following.n)
        e.upper[env, c] = upper / pivot
        e.value[env, c] = value / pivot
        before = edge.n
        edge = following
    multiplier = float(0.0)
    for k in range(stop - first):
        c = stop - 1 - k
        multiplier = e.value[env, c] - e.upper[env, c] * multiplier
        e.value[env, c] = multiplier
        e.total[env, c] = e.total[env, c] + multiplier
    # A particle moves only after both edges at it were looked at, so that directions are those of the matrix.
    behind, i = wp.vec3(), int(e.particles[first, 0])
    for c in range(first, stop):
        pull = edge_of(p, e, env, c)
        ahead = pull.n * e.value[env, c]
        push(p, env, i, (behind - ahead) * p.w[env, i])
        behind = ahead
        i = int(e.particles[c, 1])
    push(p, env, i, behind * p.w[env, i])
    left = float(0.0)
    for c in range(first, stop):
        edge = edge_of(p, e, env, c)
        found = unmet(p, e, env, c, edge.length, edge.was, softness(p, e, env, c, h))
        # A rope far from the origin cannot be solved more finely than its positions are stored.
        noise = ROUNDING * wp.length(p.x[env, e.particles[c, 0]])
        left = wp.max(left, (wp.abs(found) - noise) / e.weights[c, 0])
    return left


@wp.func
def project_edges(p: Particles, e: Edges, env: int, first: int, stop: int):
    """Take edges one by one to their lengths, where a rope folds so sharply that Newton's method does not converge."""
    for c in range(first, stop):
        e.total[env, c] = 0.0
        p.d[env, e.particles[c, 0]] = e.moved[env, e.particles[c, 0]]
    p.d[env, e.particles[stop - 1, 1]] = e.moved[env, e.particles[stop - 1, 1]]
    for sweep in range(SWEEPS):
        for k in range(first, stop):
            c = k
            # Forth and back: sweeps in one direction would push all slack to one end.
            if sweep % 2 == 1:
                c = first + stop - 1 - k
            i, j = e.particles[c, 0], e.particles[c, 1]
            arm = at(p, env, j) - at(p, env, i)
            length, w = wp.length(arm), p.w[env, i] + p.w[env, j]
            if w > 0.0 and length > 0.0:
                by = arm * ((e.weights[c, 0] / length - 1.0) / w)
                push(p, env, i, -by * p.w[env, i])
                push(p, env, j, by * p.w[env, j])


@wp.kernel(enable_backward=False)
def solve_edges(p: Particles, e: Edges, h: float):
    """All edges of a rope at once: their matrix is tridiagonal, and one elimination solves it (Thomas).

    Edges pull along the directions that they had when the substep began (SHAKE), which neither damps what swings under
    tension nor feeds it; along their new directions a swing of angular velocity w would lose ``2 w^2 h`` of its energy
    a second.
    """
    env, rope = wp.tid()
    first, stop = e.ranges[rope, 0], e.ranges[rope, 1]
    for c in range(first, stop):
        e.total[env, c] = 0.0
        e.moved[env, e.particles[c, 0]] = p.d[env, e.particles[c, 0]]
    e.moved[env, e.particles[stop - 1, 1]] = p.d[env, e.particles[stop - 1, 1]]
    attempt, left, tautest = int(0), float(1.0), float(0.0)  # noqa: RUF046
    while attempt < ATTEMPTS and left > PRECISE:
        left = pull_edges(p, e, h, env, first, stop)
        attempt += 1
    # Also where the rest is NaN, which no comparison holds for.
    if not left < LOOSE:
        project_edges(p, e, env, first, stop)
    for c in range(first, stop):
        tautest = wp.max(tautest, lateness(p, e, env, c))
    if tautest > 0.0:
        soften(p, e, env, first, stop)


# Bending -------------------------------------------------------------------------------------------------------------


@wp.struct
class Bends:
    """Curvatures, linear in the positions of four particles."""

    particles: wp.array2d[int]
    """(C, 4) particles; of a rope three, and the first again with a weight of 0."""
    weights: wp.array2d[float]
    """(C, 5) four coefficients of the curvature; compliance, which is proportional to 1 / stiffness."""
    owner: wp.array[int]
    """(C,) index of the deformable."""


@wp.func
def pull_bend(p: Particles, b: Bends, env: int, c: int, change: wp.vec3):
    for k in range(4):
        i = b.particles[c, k]
        # A rope's fourth particle only fills the row: it has no part in the curvature.
        if b.weights[c, k] != 0.0:
            push(p, env, i, change * (b.weights[c, k] * p.w[env, i]))


@wp.func
def solve_bend(p: Particles, b: Bends, h: float, env: int, c: int):
    curvature, was, w = wp.vec3(), wp.vec3(), float(0.0)
    for k in range(4):
        i = b.particles[c, k]
        weight = b.weights[c, k]
        curvature += at(p, env, i) * weight
        was += p.x[env, i] * weight
        w += p.w[env, i] * weight * weight
    soft = b.weights[c, 4] / (h * h * p.parameters[env, b.owner[c], 2])
    if b.weights[c, 3] == 0.0:  # of a rope
        soft = soft / LATE
        curvature += was * ((1.0 - LATE) / LATE)
    pull_bend(p, b, env, c, -curvature / (w + soft))


@wp.kernel(enable_backward=False)
def solve_bends(p: Particles, b: Bends, first: int, h: float):
    env, number = wp.tid()
    solve_bend(p, b, h, env, first + number)
