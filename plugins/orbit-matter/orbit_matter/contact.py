"""Particles against the surfaces of links and terrain: compliant, with Coulomb friction, felt by the links.

All surfaces that a particle is in are solved together, so that a particle between two fingers rests where their forces
cancel: it minimises ``m |x - x'|^2 / (2 h^2) + sum k depth^2 / 2``. Friction then undoes what a particle moved along
the surface that holds it best, as far as Coulomb's cone lets it, against all that surfaces which move otherwise rub; a
particle that holds does not creep.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportInvalidTypeForm=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_matter.kernels import FREE, HELD, Links, Particles, mass_of, target
from orbit_matter.surfaces import PLANE, Shapes, distance

NEAREST = wp.constant(6)
"""Shapes that one particle may be near at a time; those met first count."""
MARGIN = wp.constant(0.005)
"""Metres, beside what particle and shape move, within which a shape is looked at in a physics step."""

STILL = wp.constant(0.001)
"""m/s between two surfaces at most, for both to hold what is between them."""

Normals = wp.types.matrix(shape=(6, 3), dtype=float)
Depths = wp.types.vector(length=6, dtype=float)


@wp.struct
class Felt:
    """What links feel, mean over the substeps of a physics step."""

    forces: wp.array3d[wp.vec3]
    """(N, D, L)"""
    torques: wp.array2d[wp.vec3]
    """(N, L) about the link frame's origin."""
    friction: wp.array2d[float]
    """(N, S) of each shape."""
    near: wp.array3d[int]
    """(N, P, NEAREST) shapes that a particle may meet in this physics step; -1 for none."""


@wp.kernel(enable_backward=False)
def bound(links: Links, shapes: Shapes):
    """How far each shape reaches. ``links.shape`` are at the step's end, ``shape_before`` at its beginning."""
    env, s = wp.tid()
    way = wp.transform_get_translation(links.shape[env, s]) - wp.transform_get_translation(links.shape_before[env, s])
    links.reach[env, s] = shapes.reach[env % shapes.kind.shape[0], s] + wp.length(way)


@wp.kernel(enable_backward=False)
def find_near(p: Particles, links: Links, shapes: Shapes, felt: Felt, step: float):
    """Which shapes each particle may meet, with ``links.shape`` at the step's end."""
    env, i = wp.tid()
    kind = env % shapes.kind.shape[0]
    x, count = p.x[env, i], int(0)
    moved = wp.length(p.v[env, i]) * step + p.radius[i] + MARGIN
    for s in range(shapes.kind.shape[1]):
        after, reach = links.shape[env, s], links.reach[env, s] + moved
        close = reach > 0.0 and wp.length_sq(x - wp.transform_get_translation(after)) < reach * reach
        if close:
            local = wp.transform_point(wp.transform_inverse(after), x)
            if shapes.kind[kind, s] == PLANE:
                close = local[2] < moved
            elif shapes.kind[kind, s] < PLANE:
                close = distance(shapes, kind, s, local, reach)[3] < reach - shapes.reach[kind, s]
        if close and count < NEAREST:
            felt.near[env, i, count] = s
            count += 1
    for k in range(count, NEAREST):
        felt.near[env, i, k] = -1


@wp.func
def feel(felt: Felt, links: Links, shapes: Shapes, env: int, owner: int, link: int, x: wp.vec3, force: wp.vec3):
    """Add the force on a link at a point."""
    if link < felt.torques.shape[1]:
        wp.atomic_add(felt.forces, env, owner, link, force)
        arm = x - wp.transform_get_translation(links.link[env, link])
        wp.atomic_add(felt.torques, env, link, wp.cross(arm, force))


@wp.kernel(enable_backward=False)
def finish(
    p: Particles,
    links: Links,
    shapes: Shapes,
    felt: Felt,
    gravity: wp.array[wp.vec3],
    stiffness: float,
    h: float,
    share: float,
):
    """The end of a substep: what is held goes back, contacts are solved, displacements become velocities."""
    env, i = wp.tid()
    link = p.anchor[env, i]
    if link != FREE:
        inertia = mass_of(p, env, i) / (h * h)
        goal = target(p, links, env, i)
        pulled = p.x[env, i] + p.d[env, i] - goal
        if link >= 0:
            force = (pulled * (inertia * HELD) + gravity[env] * mass_of(p, env, i)) * share
            feel(felt, links, shapes, env, p.owner[i], link, goal, force)
        p.d[env, i] = goal - p.x[env, i]
    elif felt.near[env, i, 0] >= 0:
        meet(p, links, shapes, felt, env, i, stiffness, share, h)
    p.v[env, i] = p.d[env, i] / h
    p.x[env, i] = p.x[env, i] + p.d[env, i]


@wp.func
def meet(
    p: Particles, links: Links, shapes: Shapes, felt: Felt, env: int, i: int, stiffness: float, share: float, h: float
):
    """Push a particle out of what it is in: most are in one surface at most."""
    kind = env % shapes.kind.shape[0]
    x, inertia = p.x[env, i] + p.d[env, i], 1.0 / (p.w[env, i] * h * h)
    normals, depths, in_one, count, k = Normals(), Depths(), int(0), int(0), int(0)
    while k < NEAREST:
        s = felt.near[env, i, k]
        if s < 0:
            k = NEAREST
        else:
            pose = links.shape[env, s]
            local = wp.transform_point(wp.transform_inverse(pose), x)
            found = distance(shapes, kind, s, local, 10.0 * p.radius[i] + MARGIN)
            depth = p.radius[i] - found[3]
            if depth > 0.0:
                n = wp.transform_vector(pose, wp.vec3(found[0], found[1], found[2]))
                depths[k] = depth
                normals[k, 0] = n[0]
                normals[k, 1] = n[1]
                normals[k, 2] = n[2]
                in_one = k
                count += 1
            k += 1
    if count == 1:
        n = normal_of(normals, in_one)
        press(p, links, shapes, felt, env, i, felt.near[env, i, in_one], n, depths[in_one], inertia, stiffness, share)
    if count > 1:
        press_all(p, links, shapes, felt, env, i, normals, depths, inertia, stiffness, share, h)


@wp.func
def press(
    p: Particles, links: Links, shapes: Shapes, felt: Felt, env: int, i: int, shape: int, n: wp.vec3, depth: float,
    inertia: float, stiffness: float, share: float,
):  # fmt: skip
    """Contact with one surface, in closed form."""
    normal = stiffness * depth * inertia / (inertia + stiffness)
    d = p.d[env, i] + n * (normal / inertia)
    here = p.x[env, i] + d
    slid = d - carried(links, env, shape, here)
    slid = slid - n * wp.dot(n, slid)
    hold = wp.max(p.parameters[env, p.owner[i], 3], felt.friction[env, shape]) * normal / inertia
    length = wp.length(slid)
    if length > hold:
        slid = slid * (hold / length)
    p.d[env, i] = d - slid
    force = (slid * inertia - n * normal) * share
    feel(felt, links, shapes, env, p.owner[i], shapes.link[env % shapes.kind.shape[0], shape], here, force)


@wp.func
def press_all(
    p: Particles, links: Links, shapes: Shapes, felt: Felt, env: int, i: int, normals: Normals, depths: Depths,
    inertia: float, stiffness: float, share: float, step: float,
):  # fmt: skip
    """Contact with several surfaces at once; ``depths`` are positive for those that the particle is in."""
    kind = env % shapes.kind.shape[0]
    # Twice: the first pass finds surfaces at the place without contact, the second those that then still push.
    moved = wp.vec3()
    for _attempt in range(2):
        matrix = wp.identity(n=3, dtype=float) * inertia
        pushes = wp.vec3()
        for k in range(NEAREST):
            n = normal_of(normals, k)
            if depths[k] > 0.0 and depths[k] - wp.dot(n, moved) > 0.0:
                matrix += wp.outer(n, n) * stiffness
                pushes += n * (stiffness * depths[k])
        moved = wp.inverse(matrix) * pushes
    d = p.d[env, i] + moved
    here = p.x[env, i] + d
    # The surface that holds best: the particle goes with it where it can.
    limits, best = Depths(), int(-1)
    for k in range(NEAREST):
        s = felt.near[env, i, k]
        normal = stiffness * (depths[k] - wp.dot(normal_of(normals, k), moved))
        if s < 0 or depths[k] <= 0.0:
            normal = float(0.0)
        depths[k] = wp.max(normal, 0.0)
        if normal > 0.0:
            limits[k] = wp.max(p.parameters[env, p.owner[i], 3], felt.friction[env, s]) * normal / inertia
            if best < 0 or limits[k] > limits[best]:
                best = k
    if best < 0:
        p.d[env, i] = d
        return
    way = carried(links, env, felt.near[env, i, best], here)
    # Surfaces that move against it rub with all of their friction; the others hold with it.
    hold = float(0.0)
    for k in range(NEAREST):
        if depths[k] > 0.0:
            n = normal_of(normals, k)
            s = felt.near[env, i, k]
            rubbed = way - carried(links, env, s, here)
            rubbed = rubbed - n * wp.dot(n, rubbed)
            length = wp.length(rubbed)
            if length > STILL * step:
                rub = rubbed * (limits[k] / length)
                limits[k] = float(0.0)
                d = d - rub
                felt_at = (rub * inertia - n * depths[k]) * share
                feel(felt, links, shapes, env, p.owner[i], shapes.link[kind, s], here, felt_at)
            else:
                hold += limits[k]
    n = normal_of(normals, best)
    slid = d - way
    slid = slid - n * wp.dot(n, slid)
    if wp.length(slid) > hold:
        slid = slid * (hold / wp.length(slid))
    d = d - slid
    for k in range(NEAREST):
        if limits[k] > 0.0:
            s = felt.near[env, i, k]
            force = (slid * (inertia * limits[k] / hold) - normal_of(normals, k) * depths[k]) * share
            feel(felt, links, shapes, env, p.owner[i], shapes.link[kind, s], here, force)
    p.d[env, i] = d


@wp.func
def normal_of(normals: Normals, k: int) -> wp.vec3:
    """Of the k-th surface."""
    return wp.vec3(normals[k, 0], normals[k, 1], normals[k, 2])


@wp.func
def carried(links: Links, env: int, shape: int, x: wp.vec3) -> wp.vec3:
    """How far a shape's point that is now at x went in the substep."""
    local = wp.transform_point(wp.transform_inverse(links.shape[env, shape]), x)
    return x - wp.transform_point(links.shape_before[env, shape], local)
