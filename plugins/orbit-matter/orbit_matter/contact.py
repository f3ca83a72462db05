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

from orbit_matter.block import first_in_warp, sum_of_warp
from orbit_matter.kernels import FREE, Links, Particles, mass_of, pose_between, target
from orbit_matter.surfaces import HEIGHT_FIELD, MESH, PLANE, Shapes, distance

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
    """Forces and torques on links, mean over the substeps of a physics step, and the shapes near each particle."""

    forces: wp.array3d[wp.vec3]
    """(N, D, L) N on each link by each deformable."""
    torques: wp.array2d[wp.vec3]
    """(N, L) about the link frame's origin."""
    friction: wp.array2d[float]
    """(N, S) of each shape."""
    near: wp.array3d[int]
    """(N, P, NEAREST) shapes that a particle may meet in this physics step; -1 for none."""
    holds: wp.array3d[int]
    """(N, D, L) 1 where any particle of a deformable is attached to a link."""


@wp.kernel(enable_backward=False)
def bound(links: Links, shapes: Shapes):
    """Write each shape's reach, grown by what it moves and turns in the physics step, which ``links.way`` holds."""
    env, s = wp.tid()
    own, turn = shapes.reach[env % shapes.kind.shape[0], s], links.turn[env, s]
    turned = 2.0 * own * wp.length(wp.vec3(turn[0], turn[1], turn[2]))
    links.reach[env, s] = own + wp.length(links.way[env, s]) + turned


@wp.func
def range_of(p: Particles, step: float, env: int, i: int) -> float:
    """Metres from a particle within which it may meet a surface in this physics step."""
    return wp.length(p.v[env, i]) * step + p.radius[i] + MARGIN


@wp.func
def deepest(radius: float) -> float:
    """Metres from a mesh's surface within which a particle is looked for in it."""
    return 10.0 * radius + MARGIN


@wp.func
def is_near(
    shapes: Shapes, kind: int, s: int, pose: wp.transform, reach: float, x: wp.vec3, radius: float, moved: float
) -> bool:
    """Return True if a ball at x that moves up to ``moved`` metres may meet a shape, at its pose at the step's end."""
    reach += moved
    close = reach > 0.0 and wp.length_sq(x - wp.transform_get_translation(pose)) < reach * reach
    if close:
        local = wp.transform_point(wp.transform_inverse(pose), x)
        if shapes.kind[kind, s] == PLANE:
            close = local[2] < moved
        # A height field is near everything: its reach would have to be searched, and its distance costs little.
        elif shapes.kind[kind, s] != HEIGHT_FIELD:
            # Meshes are searched only within reach: the farther a query may look, the more of the tree it visits.
            gap = reach - shapes.reach[kind, s]  # what both move, and a margin
            if shapes.kind[kind, s] == MESH:
                out = wp.vec3(wp.abs(local[0]), wp.abs(local[1]), wp.abs(local[2])) - shapes.size[kind, s]
                close = wp.max(out[0], wp.max(out[1], out[2])) < gap
            if close:
                close = distance(shapes, kind, s, local, wp.max(gap, deepest(radius)))[3] < gap
    return close


@wp.kernel(enable_backward=False)
def find_holders(p: Particles, felt: Felt, chosen: wp.array[bool]):
    """Note which links deformables are attached to, in chosen environments."""
    env, d = wp.tid()
    if not chosen[env]:
        return
    # Deformables share no row, so that the threads of one environment do not write the same numbers.
    for link in range(felt.holds.shape[2]):
        felt.holds[env, d, link] = 0
    for i in range(p.x.shape[1]):
        if p.owner[i] == d and p.anchor[env, i] >= 0:
            felt.holds[env, d, p.anchor[env, i]] = 1


@wp.kernel(enable_backward=False)
def exempt_inside(p: Particles, links: Links, shapes: Shapes, felt: Felt, chosen: wp.array[bool]):
    """Let no particle collide with a link that its deformable is attached to and that it is inside of."""
    env, i = wp.tid()
    if not chosen[env]:
        return
    kind = env % shapes.kind.shape[0]
    p.exempt[env, i] = FREE
    for s in range(shapes.kind.shape[1]):
        link = shapes.link[kind, s]
        if link < felt.holds.shape[2]:  # noqa: SIM102 - Warp evaluates both sides of an `and`
            if felt.holds[env, p.owner[i], link] == 1:
                pose = pose_between(links.end, links.end, env, link, 0.0) * shapes.pose[kind, s]
                local = wp.transform_point(wp.transform_inverse(pose), p.x[env, i])
                if distance(shapes, kind, s, local, deepest(p.radius[i]))[3] < p.radius[i]:
                    p.exempt[env, i] = link


@wp.kernel(enable_backward=False)
def sound(p: Particles, links: Links, shapes: Shapes, count: int, farthest: float, found: wp.array2d[float]):
    """Write how deep (m) the particles of each deformable are in each shape of ``count`` links and terrain, (D, S)."""
    env, i = wp.tid()
    kind = env % shapes.kind.shape[0]
    for s in range(shapes.kind.shape[1]):
        if p.exempt[env, i] != shapes.link[kind, s]:
            pose = shapes.pose[kind, s]
            if shapes.link[kind, s] < count:  # terrain has the number after all links, and no pose of a link
                pose = pose_between(links.end, links.end, env, shapes.link[kind, s], 0.0) * pose
            local = wp.transform_point(wp.transform_inverse(pose), p.x[env, i])
            wp.atomic_max(found, p.owner[i], s, -distance(shapes, kind, s, local, farthest)[3])


@wp.kernel(enable_backward=False)
def find_near(p: Particles, links: Links, shapes: Shapes, felt: Felt, step: float):
    """List the shapes that each particle may meet."""
    env, i = wp.tid()
    count, kind, moved = int(0), env % shapes.kind.shape[0], range_of(p, step, env, i)
    for s in range(shapes.kind.shape[1]):
        own = p.exempt[env, i] == shapes.link[kind, s]
        if (
            count < NEAREST
            and not own
            and is_near(shapes, kind, s, links.shape[env, s], links.reach[env, s], p.x[env, i], p.radius[i], moved)
        ):
            felt.near[env, i, count] = s
            count += 1
    for k in range(count, NEAREST):
        felt.near[env, i, k] = -1


@wp.func
def feel(felt: Felt, links: Links, env: int, owner: int, link: int, force: wp.vec3, x: wp.vec3):
    """Add the force on a link at a point."""
    if link < felt.torques.shape[1]:
        wp.atomic_add(felt.forces, env, owner, link, force)
        arm = x - wp.transform_get_translation(links.link[env, link])
        wp.atomic_add(felt.torques, env, link, wp.cross(arm, force))


@wp.func
def feel_together(felt: Felt, links: Links, env: int, owner: int, link: int, force: wp.vec3, x: wp.vec3):
    """Add forces as :func:`feel` does, but summed over a warp first: its threads would wait for each other's atomics.

    All threads of a warp must call it, with the same environment; one without a force gives a link of -1.
    """
    count, key, wrench = felt.torques.shape[1], int(-1), wp.spatial_vector()
    if link >= 0 and link < count:
        arm = x - wp.transform_get_translation(links.link[env, link])
        wrench = wp.spatial_vector(force, wp.cross(arm, force))
        key = owner * count + link
    first = first_in_warp(key)
    while first[0] >= 0:
        mine = wp.spatial_vector()
        if key == first[0]:
            mine = wrench
            key = -1
        whole = sum_of_warp(mine)
        if first[1] == 1:
            wp.atomic_add(felt.forces, env, owner, link, wp.spatial_top(whole))
            wp.atomic_add(felt.torques, env, link, wp.spatial_bottom(whole))
        first = first_in_warp(key)


@wp.func
def end_substep(
    p: Particles, links: Links, shapes: Shapes, felt: Felt, gravity: wp.array[wp.vec3], stiffness: float, h: float,
    share: float, env: int, i: int,
) -> int:  # fmt: skip
    """Put held particles back, solve contact with one surface, and turn displacements into velocities.

    Returns:
        Number of surfaces that the particle is in; if several, nothing was done yet.
    """
    link, kind = p.anchor[env, i], env % shapes.kind.shape[0]
    count, k, depth = int(0), int(0), float(0.0)
    d, n, only = wp.vec3(p.d[env, i]), wp.vec3(), int(-1)
    if link != FREE:
        inertia = mass_of(p, env, i) / (h * h)
        goal = target(p, links, env, i)
        pulled = d - (goal - p.x[env, i])  # of which the rounding of positions cancels
        if link >= 0 and p.solved[env, i] == 0:
            force = (pulled * (inertia * p.held[i]) + gravity[env] * mass_of(p, env, i)) * share
            feel(felt, links, env, p.owner[i], link, force, goal)
        d = goal - p.x[env, i]
        k = NEAREST
    while k < NEAREST:
        s = felt.near[env, i, k]
        k += 1
        if s < 0:
            k = NEAREST
        else:
            found = surface(links, shapes, env, kind, s, p.x[env, i] + d, p.radius[i])
            if found[3] > 0.0:
                n = wp.vec3(found[0], found[1], found[2])
                only, depth = s, found[3]
                count += 1
    if count > 1:
        return count
    if count == 1:
        # In closed form.
        inertia = 1.0 / (p.w[env, i] * h * h)
        normal = stiffness * depth * inertia / (inertia + stiffness)
        d += n * (normal / inertia)
        if felt.near[env, i, 1] >= 0 and is_in_other(p, links, shapes, felt, env, i, only, p.x[env, i] + d):
            return 2
        here = p.x[env, i] + d
        most = wp.max(p.parameters[env, p.owner[i], 3], felt.friction[env, only]) * normal / inertia
        slid = held_back(d - carried(links, env, only, here), n, most)
        d -= slid
        feel(felt, links, env, p.owner[i], shapes.link[kind, only], (slid * inertia - n * normal) * share, here)
    settle(p, env, i, d, h)
    return count


@wp.func
def is_in_other(
    p: Particles, links: Links, shapes: Shapes, felt: Felt, env: int, i: int, only: int, x: wp.vec3
) -> bool:
    """Return True if a particle that one surface has pushed to x is in another, from which it would leap back."""
    inside, k = bool(False), int(0)
    while k < NEAREST and not inside:
        s = felt.near[env, i, k]
        k += 1
        if s < 0:
            k = NEAREST
        elif s != only:
            inside = surface(links, shapes, env, env % shapes.kind.shape[0], s, x, p.radius[i])[3] > 0.0
    return inside


@wp.func
def settle(p: Particles, env: int, i: int, d: wp.vec3, h: float):
    """Put a particle to the end of the substep, d metres from its beginning."""
    p.d[env, i] = d
    p.v[env, i] = d / h
    p.x[env, i] = p.x[env, i] + d


@wp.kernel(enable_backward=False)
def finish(
    p: Particles, links: Links, shapes: Shapes, felt: Felt, gravity: wp.array[wp.vec3], stiffness: float, h: float,
    share: float,
):  # fmt: skip
    env, i = wp.tid()
    if end_substep(p, links, shapes, felt, gravity, stiffness, h, share, env, i) > 1:
        end_between(p, links, shapes, felt, stiffness, h, share, env, i)


@wp.func
def surface(links: Links, shapes: Shapes, env: int, kind: int, shape: int, x: wp.vec3, radius: float) -> wp.vec4:
    """Normal of a shape near x, and how deep a ball around x is in it."""
    axes = links.axes[env, shape]
    local = (x - wp.transform_get_translation(links.shape[env, shape])) @ axes
    found = distance(shapes, kind, shape, local, deepest(radius))
    n = axes @ wp.vec3(found[0], found[1], found[2])
    return wp.vec4(n[0], n[1], n[2], radius - found[3])


@wp.func
def held_back(slid: wp.vec3, n: wp.vec3, most: float) -> wp.vec3:
    """Return the sliding displacement that friction undoes, at ``most`` metres, along a surface of normal n."""
    along = slid - n * wp.dot(n, slid)
    length = wp.length(along)
    if length > most:
        along = along * (most / length)
    return along


@wp.func
def end_between(
    p: Particles, links: Links, shapes: Shapes, felt: Felt, stiffness: float, h: float, share: float, env: int, i: int
):
    """The end of a substep for a particle that is in several surfaces at once."""
    kind = env % shapes.kind.shape[0]
    x, inertia = p.x[env, i] + p.d[env, i], 1.0 / (p.w[env, i] * h * h)
    normals, depths, looked = Normals(), Depths(), int(0)
    while looked < NEAREST and felt.near[env, i, wp.min(looked, NEAREST - 1)] >= 0:
        found = surface(links, shapes, env, kind, felt.near[env, i, looked], x, p.radius[i])
        depths[looked] = found[3]
        for axis in range(3):
            normals[looked, axis] = found[axis]
        looked += 1
    # Twice: the first pass finds surfaces at the place without contact, the second those that it is in then.
    moved = wp.vec3()
    for _attempt in range(2):
        before = moved
        # Inertia and the springs of all touched surfaces in one 3 x 3 system: solved one by one they would take turns.
        matrix = wp.identity(n=3, dtype=float) * inertia
        pushes = wp.vec3()
        for k in range(looked):
            n = normal_of(normals, k)
            if depths[k] - wp.dot(n, before) > 0.0:
                matrix += wp.outer(n, n) * stiffness
                pushes += n * (stiffness * depths[k])
        moved = wp.inverse(matrix) * pushes
    d = p.d[env, i] + moved
    here = p.x[env, i] + d
    # The surface that holds best: the particle goes with it where it can.
    limits, best = Depths(), int(-1)
    for k in range(looked):
        s = felt.near[env, i, k]
        normal = stiffness * (depths[k] - wp.dot(normal_of(normals, k), moved))
        depths[k] = wp.max(normal, 0.0)
        if normal > 0.0:
            limits[k] = wp.max(p.parameters[env, p.owner[i], 3], felt.friction[env, s]) * normal / inertia
            if best < 0 or limits[k] > limits[best]:
                best = k
    if best < 0:
        settle(p, env, i, d, h)
        return
    way = carried(links, env, felt.near[env, i, best], here)
    # Surfaces that move against it rub with all of their friction; the others hold with it.
    hold = float(0.0)
    for k in range(looked):
        if depths[k] > 0.0:
            n = normal_of(normals, k)
            s = felt.near[env, i, k]
            rubbed = way - carried(links, env, s, here)
            rubbed = rubbed - n * wp.dot(n, rubbed)
            length = wp.length(rubbed)
            if length > STILL * h:
                # Below this speed friction grows in proportion: full friction would reverse slow bodies within one
                # substep.
                still = wp.max(shapes.still[kind, s], shapes.still[kind, felt.near[env, i, best]])
                part = wp.min(1.0, length / (still * h))
                rub = rubbed * (limits[k] * part / length)
                limits[k] = limits[k] * (1.0 - part)
                d = d - rub
                feel(felt, links, env, p.owner[i], shapes.link[kind, s], rub * (inertia * share), here)
            hold += limits[k]
    n = normal_of(normals, best)
    slid = d - way
    slid = slid - n * wp.dot(n, slid)
    if wp.length(slid) > hold:
        slid = slid * (hold / wp.length(slid))
    d = d - slid
    for k in range(looked):
        if depths[k] > 0.0:
            s = felt.near[env, i, k]
            part = limits[k] / wp.max(hold, 1.0e-12)
            force = (slid * (inertia * part) - normal_of(normals, k) * depths[k]) * share
            feel(felt, links, env, p.owner[i], shapes.link[kind, s], force, here)
    settle(p, env, i, d, h)


@wp.func
def normal_of(normals: Normals, k: int) -> wp.vec3:
    """Return the normal of the k-th surface."""
    return wp.vec3(normals[k, 0], normals[k, 1], normals[k, 2])


@wp.func
def carried(links: Links, env: int, shape: int, x: wp.vec3) -> wp.vec3:
    """Return the displacement in this substep of the point of a shape that is now at x, m."""
    arm = x - wp.transform_get_translation(links.shape[env, shape])
    return carried_by(links.way[env, shape], links.turn[env, shape], arm)


@wp.func
def carried_by(way: wp.vec3, turn: wp.quat, arm: wp.vec3) -> wp.vec3:
    """Return the displacement of the point of a shape that is at ``arm`` from its origin after it went and turned."""
    v = wp.vec3(turn[0], turn[1], turn[2])
    across = wp.cross(v, arm) * 2.0
    return way + across * turn[3] - wp.cross(v, across)
