"""Free bodies that cloth and rope are attached to, as nodes of the matter's own solve.

A body that feels its rope one physics step late gains energy, and diverges where the rope is heavier than it. So the
matter solves such a body together with what is attached to it, in every substep: constraints see the inverse mass of
the body at the point of attachment (Tonge et al., "Mass splitting for jitter-free parallel rigid body simulation",
2012: each of k attached particles moves a k-th of the body, which no number of them makes unstable), and its mass
includes that of the attached particles.

The engine follows. At the end of a step the matter gives it the wrench that takes its body, in one more step, to where
the matter expects its own. The other way round the matter takes over the acceleration that the engine's body had in
the step, less the wrench that it was given, plus the forces of this step: so gravity, wrenches that users set and what
other bodies do act on it as the engine has them.

A body that the engine holds, between fingers or on a floor, resists with more than its mass. How much is measured: the
part of the expected acceleration that did not happen. Where all of it is missing the matter takes the body as it takes
links of robots: it goes the way that the engine has taken it, and feels the matter one physics step late.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false
# ruff: noqa: UP018 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_matter.bodies import Bodies, quat_of, three, turn_by, write_pose
from orbit_matter.contact import Felt
from orbit_matter.kernels import HELD, Links, Particles, mass_of, target

NOISE = wp.constant(0.05)
"""Part of the expected acceleration that may be missing before a body counts as held by the engine."""
STILL = wp.constant(0.05)
"""m/s^2 that are not distinguished from zero where nothing pulls a body."""


@wp.struct
class Attached:
    """The B free bodies of each of N environments, as far as particles are attached to them."""

    body: wp.array[int]
    """(L,) index of the free body that a link is, or -1."""
    mates: wp.array2d[int]
    """(P, 2) particles before and after each along its rope, or -1."""
    first: wp.array2d[int]
    """(N, B) first of the particles that are attached to it, or -1."""
    following: wp.array2d[int]
    """(N, P) the next particle that is attached to the same body, or -1."""
    count: wp.array2d[int]
    """(N, B) of particles that are attached to it."""
    known: wp.array2d[int]
    """(N, B) 1 where the state below holds, 2 where it was taken over from the engine in this step, 0 where none is."""
    x: wp.array2d[wp.vec3]
    """(N, B) m of the centre of mass, its orientation, and their velocities: as the matter has solved them."""
    q: wp.array2d[wp.quat]
    """(N, B) orientation."""
    v: wp.array2d[wp.vec3]
    """(N, B) m/s of the centre of mass."""
    w: wp.array2d[wp.vec3]
    """(N, B) rad/s, in world axes."""
    seen: wp.array3d[float]
    """(N, B, 13) centre of mass, orientation and velocities that the engine had after its last step."""
    asked: wp.array3d[float]
    """(N, L, 6) wrenches about centres of mass that users have set."""
    given: wp.array3d[float]
    """(N, B, 6) wrench about the link frame's origin that the engine is given for its next step."""
    held: wp.array2d[float]
    """(N, B) from 0, free in the engine, to 1, held by it."""
    mobility: wp.array2d[float]
    """(N, B) 1/kg of the body with its particles, the less the more the engine holds it."""
    inertia: wp.array2d[wp.mat33]
    """(N, B) kg m^2 of the body with its particles, in the link's axes."""
    turning: wp.array2d[wp.mat33]
    """(N, B) its inverse in world axes, in proportion to the mobility."""
    pull: wp.array2d[wp.vec3]
    """(N, B) m/s^2 and rad/s^2 of all but this step's matter."""
    twist: wp.array2d[wp.vec3]
    """(N, B) rad/s^2: the angular part of ``pull``."""
    had_pull: wp.array2d[wp.vec3]
    """(N, B) m/s^2 and rad/s^2 of the engine's body in its last step."""
    had_twist: wp.array2d[wp.vec3]
    """(N, B) rad/s^2: the angular part of ``had_pull``."""
    odd_pull: wp.array2d[wp.vec3]
    """(N, B) the part of it that neither gravity nor a known wrench explains."""
    odd_twist: wp.array2d[wp.vec3]
    """(N, B) rad/s^2: the angular part of ``odd_pull``."""
    begin_v: wp.array2d[wp.vec3]
    """(N, B) velocities at the beginning of the physics step."""
    begin_w: wp.array2d[wp.vec3]
    """(N, B) rad/s at the beginning of the physics step."""
    drift: wp.array2d[wp.vec3]
    """(N, B) m/s and rad/s that take the body back to the engine's, where this holds it; no part of its momentum."""
    spin: wp.array2d[wp.vec3]
    """(N, B) rad/s: the angular part of ``drift``."""
    force: wp.array2d[wp.vec3]
    """(N, B) mean of the matter's wrench about the centre of mass so far."""
    torque: wp.array2d[wp.vec3]
    """(N, B) N m: the angular part of ``force``."""
    felt_force: wp.array2d[wp.vec3]
    """(N, B) what of :class:`Felt` is in it, torques about the link frame's origin."""
    felt_torque: wp.array2d[wp.vec3]
    """(N, B) N m: the angular part of ``felt_force``."""


@wp.kernel(enable_backward=False)
def find_attached(p: Particles, a: Attached):
    """List the particles of each free body."""
    env = wp.tid()
    for b in range(a.count.shape[1]):
        a.count[env, b] = 0
        a.first[env, b] = -1
    # Backwards, so that each list runs through particles in ascending order: sums are the same in every run.
    for k in range(p.x.shape[1]):
        i = p.x.shape[1] - 1 - k
        p.solved[env, i] = 0
        link = p.anchor[env, i]
        if link >= 0:
            b = a.body[link]
            if b >= 0:
                a.following[env, i] = a.first[env, b]
                a.first[env, b] = i
                a.count[env, b] = a.count[env, b] + 1
                p.solved[env, i] = 1


@wp.func
def turn_vector(q: wp.quat) -> wp.vec3:
    """Return the rotation vector of a quaternion, rad."""
    v = wp.vec3(q[0], q[1], q[2])
    s = wp.length(v)
    # Near no turn the ratio of angle and sine is 2; the quotient below would be 0 / 0.
    if s < 1.0e-9:
        return 2.0 * v * wp.sign(q[3])
    return v * (2.0 * wp.atan2(s * wp.sign(q[3]), wp.abs(q[3])) / s)


@wp.func
def outer_inertia(m: float, r: wp.vec3) -> wp.mat33:
    """Return the inertia of a point of mass m at r."""
    return (wp.identity(n=3, dtype=float) * wp.dot(r, r) - wp.outer(r, r)) * m


@wp.func
def missing(got: wp.vec3, expected: wp.vec3, floor: float) -> float:
    """Return the part of an acceleration that did not happen, 0 within noise and 1 at most."""
    part = wp.length(got - expected) / (wp.length(expected) + floor)
    return wp.clamp((part - NOISE) / (1.0 - 2.0 * NOISE), 0.0, 1.0)


@wp.func
def was_written(a: Attached, env: int, b: int, x: wp.vec3, q: wp.quat, v: wp.vec3, w: wp.vec3) -> bool:
    """Return True if someone set the engine's state since its last step."""
    s = a.seen
    turned = wp.quat(s[env, b, 3], s[env, b, 4], s[env, b, 5], s[env, b, 6]) - q
    moved = wp.length(three(s, env, b, 0) - x) + wp.length(turned)
    return moved > 1.0e-5 or wp.length(three(s, env, b, 7) - v) > 1.0e-4 or wp.length(three(s, env, b, 10) - w) > 1.0e-3


@wp.kernel(enable_backward=False)
def begin(a: Attached, b: Bodies, links: Links, p: Particles, gravity: wp.array[wp.vec3], dt: float):
    """Take over what the engine has done to its bodies in the physics step that the matter is to follow in."""
    env, i = wp.tid()
    if a.count[env, i] == 0:
        a.known[env, i] = 0
        return
    link, mass, center, g = b.link[env, i], b.mass[env, i], b.center[env, i], gravity[env]
    q0, q1 = quat_of(links.start, env, link), quat_of(links.end, env, link)
    arm0, arm1 = wp.quat_rotate(q0, center), wp.quat_rotate(q1, center)
    x0, x1 = three(links.start, env, link, 0) + arm0, three(links.end, env, link, 0) + arm1
    w0, w1 = three(b.before, env, i, 3), three(b.after, env, i, 3)
    v0, v1 = three(b.before, env, i, 0) + wp.cross(w0, arm0), three(b.after, env, i, 0) + wp.cross(w1, arm1)
    # A state that a user has set replaces the matter's own, which would else pull the body back to where it was.
    known = 1
    if a.known[env, i] == 0 or was_written(a, env, i, x0, q0, v0, w0):
        known = 2
        a.x[env, i] = x0
        a.q[env, i] = q0
        a.v[env, i] = v0
        a.w[env, i] = w0
    a.known[env, i] = known
    for k in range(3):
        a.seen[env, i, k] = x1[k]
        a.seen[env, i, 3 + k] = q1[k]
        a.seen[env, i, 7 + k] = v1[k]
        a.seen[env, i, 10 + k] = w1[k]
    a.seen[env, i, 6] = q1[3]
    # How much of what should have moved it the engine did not let happen.
    axes = wp.quat_to_matrix(q0)
    inertia = axes * b.inertia[env, i] * wp.transpose(axes)
    force = three(b.wrenches, env, link, 0)
    torque = three(b.wrenches, env, link, 3) - wp.cross(arm0, force)
    pull, twist = (v1 - v0) / dt, (w1 - w0) / dt
    expected = g + (force + three(a.asked, env, link, 0)) / mass
    turning = torque + three(a.asked, env, link, 3) - wp.cross(w0, inertia * w0)
    gyration = wp.sqrt(0.5 * wp.trace(inertia) / mass)
    expected_twist = wp.inverse(inertia) * turning
    a.odd_pull[env, i] = pull - expected
    a.odd_twist[env, i] = twist - expected_twist
    held = wp.max(missing(pull, expected, STILL), missing(twist, expected_twist, 10.0 * STILL / gyration))
    a.held[env, i] = held
    # A held body goes the engine's way, a free one the matter's; in between they are blended.
    x, q = a.x[env, i], a.q[env, i]
    v, w = a.v[env, i] * (1.0 - held) + v0 * held, a.w[env, i] * (1.0 - held) + w0 * held
    # The particles that are attached to it are a part of it, whose weight and inertia the engine does not know.
    combined, loose, own_force, own_torque = b.inertia[env, i] * 1.0, float(mass), -force, -torque
    c = int(a.first[env, i])
    while c >= 0:
        m, place = mass_of(p, env, c), p.place[env, c] - center
        r = wp.quat_rotate(q, place)
        combined = combined + outer_inertia(m, place)
        loose += m
        f = (g - pull - wp.cross(twist, r) - wp.cross(w, wp.cross(w, r))) * m
        own_force += f
        own_torque += wp.cross(r, f)
        c = a.following[env, c]
    # A held body resists with HELD times its mass, as a particle does that a link holds.
    share = 1.0 - held + held / HELD
    # Mass and inertia scale alike, so that the point of attachment gives way evenly in all directions.
    a.inertia[env, i] = combined / share
    a.mobility[env, i] = share / loose
    axes = wp.quat_to_matrix(q)
    turn = axes * wp.inverse(combined / share) * wp.transpose(axes)
    a.v[env, i] = v
    a.w[env, i] = w
    a.begin_v[env, i] = v
    a.begin_w[env, i] = w
    a.had_pull[env, i] = pull
    a.had_twist[env, i] = twist
    a.drift[env, i] = ((x1 - x) / dt - v - 0.5 * dt * pull) * held
    a.spin[env, i] = (turn_vector(q1 * wp.quat_inverse(q)) / dt - w - 0.5 * dt * twist) * held
    pull += own_force * a.mobility[env, i]
    twist += turn * own_torque
    a.pull[env, i] = pull
    a.twist[env, i] = twist
    a.force[env, i] = wp.vec3()
    a.torque[env, i] = wp.vec3()
    a.felt_force[env, i] = wp.vec3()
    a.felt_torque[env, i] = wp.vec3()
    write_pose(links.start, env, link, x, q, center)
    ahead = x + (v + a.drift[env, i] + 0.5 * dt * pull) * dt
    write_pose(links.end, env, link, ahead, turn_by((w + a.spin[env, i] + 0.5 * dt * twist) * dt) * q, center)


@wp.func
def absorb(a: Attached, b: Bodies, felt: Felt, dt: float, env: int, i: int):
    """Give a body the impulses of contacts with the matter since it was last looked at."""
    link = b.link[env, i]
    # Forces on links only grow within a step: what was felt before is taken off, and the difference is new.
    force = -a.felt_force[env, i]
    for d in range(felt.forces.shape[1]):
        force += felt.forces[env, d, link]
    torque = felt.torques[env, link] - a.felt_torque[env, i]
    a.felt_force[env, i] = a.felt_force[env, i] + force
    a.felt_torque[env, i] = a.felt_torque[env, i] + torque
    torque = torque - wp.cross(wp.quat_rotate(a.q[env, i], b.center[env, i]), force)
    a.force[env, i] = a.force[env, i] + force
    a.torque[env, i] = a.torque[env, i] + torque
    a.v[env, i] = a.v[env, i] + force * (a.mobility[env, i] * dt)
    a.w[env, i] = a.w[env, i] + a.turning[env, i] * torque * dt


@wp.func
def place(a: Attached, b: Bodies, links: Links, env: int, i: int):
    """Put the link where its body is."""
    q = a.q[env, i]
    links.link[env, b.link[env, i]] = wp.transform(a.x[env, i] - wp.quat_rotate(q, b.center[env, i]), q)


@wp.func
def weight(p: Particles, a: Attached, env: int, i: int, c: int, r: wp.vec3) -> float:
    """Return the 1/kg with which the body moves, at r from its centre, along the rope that is attached there.

    Across cloth, whose direction is not known, the most that it is in any.
    """
    found, turning = float(0.0), a.turning[env, i]
    # Only the pull along the rope matters; across it the body may turn as freely as it likes.
    for side in range(2):
        mate = a.mates[c, side]
        if mate >= 0 and p.anchor[env, mate] != p.anchor[env, c]:
            arm = wp.cross(r, wp.normalize(p.x[env, mate] - p.x[env, c]))
            found = wp.max(found, a.mobility[env, i] + wp.dot(arm, turning * arm))
    if found == 0.0:
        found = a.mobility[env, i]
        for axis in range(3):
            n = wp.vec3()
            n[axis] = 1.0
            arm = wp.cross(r, n)
            found += wp.dot(arm, turning * arm)
    return found * float(a.count[env, i])


@wp.kernel(enable_backward=False)
def predict(a: Attached, b: Bodies, links: Links, p: Particles, felt: Felt, dt: float, h: float):
    """Move bodies through a substep as if nothing were attached to them."""
    env, i = wp.tid()
    if a.count[env, i] == 0:
        return
    absorb(a, b, felt, dt, env, i)
    v, w = a.v[env, i] + a.pull[env, i] * h, a.w[env, i] + a.twist[env, i] * h
    a.v[env, i] = v
    a.w[env, i] = w
    a.x[env, i] = a.x[env, i] + (v + a.drift[env, i]) * h
    q = turn_by((w + a.spin[env, i]) * h) * a.q[env, i]
    a.q[env, i] = q
    axes = wp.quat_to_matrix(q)
    a.turning[env, i] = axes * wp.inverse(a.inertia[env, i]) * wp.transpose(axes)
    place(a, b, links, env, i)
    c = int(a.first[env, i])
    while c >= 0:
        p.w[env, c] = weight(p, a, env, i, c, wp.quat_rotate(q, p.place[env, c] - b.center[env, i]))
        c = a.following[env, c]


@wp.kernel(enable_backward=False)
def correct(
    a: Attached, b: Bodies, links: Links, p: Particles, felt: Felt, gravity: wp.array[wp.vec3], h: float, share: float
):
    """Move bodies by what constraints did to the particles that are attached to them."""
    env, i = wp.tid()
    if a.count[env, i] == 0:
        return
    link, x, q = b.link[env, i], a.x[env, i], a.q[env, i]
    impulse, turn = wp.vec3(), wp.vec3()
    arm = wp.quat_rotate(q, b.center[env, i])
    c = int(a.first[env, i])
    while c >= 0:
        r = wp.quat_rotate(q, p.place[env, c] - b.center[env, i])
        f = (p.d[env, c] - (target(p, links, env, c) - p.x[env, c])) / p.w[env, c]
        impulse += f
        turn += wp.cross(r, f)
        # The particles' own weight and inertia, which the engine's body lacks.
        own = (gravity[env] - a.had_pull[env, i] - wp.cross(a.had_twist[env, i], r)) * mass_of(p, env, c)
        f = (f / (h * h) + own) * share
        felt.forces[env, p.owner[c], link] = felt.forces[env, p.owner[c], link] + f
        felt.torques[env, link] = felt.torques[env, link] + wp.cross(r + arm, f)
        a.felt_force[env, i] = a.felt_force[env, i] + f
        a.felt_torque[env, i] = a.felt_torque[env, i] + wp.cross(r + arm, f)
        a.force[env, i] = a.force[env, i] + f
        a.torque[env, i] = a.torque[env, i] + wp.cross(r, f)
        c = a.following[env, c]
    moved, turned = impulse * a.mobility[env, i], a.turning[env, i] * turn
    a.x[env, i] = x + moved
    a.v[env, i] = a.v[env, i] + moved / h
    a.q[env, i] = turn_by(turned) * q
    a.w[env, i] = a.w[env, i] + turned / h
    place(a, b, links, env, i)


@wp.kernel(enable_backward=False)
def conclude(a: Attached, b: Bodies, felt: Felt, gravity: wp.array[wp.vec3], dt: float):
    """Give the engine the wrench with which its body follows, in its next step."""
    env, i = wp.tid()
    link, mass, center, g = b.link[env, i], b.mass[env, i], b.center[env, i], gravity[env]
    force, torque = wp.vec3(), felt.torques[env, link] * 1.0
    for d in range(felt.forces.shape[1]):
        force += felt.forces[env, d, link]
    if a.count[env, i] > 0:
        absorb(a, b, felt, dt, env, i)
        s = a.seen
        x1, q1 = three(s, env, i, 0), wp.quat(s[env, i, 3], s[env, i, 4], s[env, i, 5], s[env, i, 6])
        v1, w1 = three(s, env, i, 7), three(s, env, i, 10)
        axes = wp.quat_to_matrix(q1)
        inertia = axes * b.inertia[env, i] * wp.transpose(axes)
        asked, asked_turn = three(a.asked, env, link, 0), three(a.asked, env, link, 3)
        # As in this step it accelerates in the next, at whose end the engine is to be where it is then.
        pull, twist = (a.v[env, i] - a.begin_v[env, i]) / dt, (a.w[env, i] - a.begin_w[env, i]) / dt
        v = (a.x[env, i] - x1) / dt + a.v[env, i] + 0.5 * dt * pull
        w = turn_vector(a.q[env, i] * wp.quat_inverse(q1)) / dt + a.w[env, i] + 0.5 * dt * twist
        follow = ((v - v1) / dt - g - a.odd_pull[env, i]) * mass - asked
        turn = inertia * ((w - w1) / dt - a.odd_twist[env, i]) + wp.cross(w1, inertia * w1) - asked_turn
        held = a.held[env, i]
        if a.known[env, i] == 2:  # to follow a state that is written again and again would overshoot, ever further
            held = float(1.0)
        force = follow + (a.force[env, i] - follow) * held
        torque = turn + (a.torque[env, i] - turn) * held + wp.cross(wp.quat_rotate(q1, center), force)
    for k in range(3):
        a.given[env, i, k] = force[k]
        a.given[env, i, 3 + k] = torque[k]
