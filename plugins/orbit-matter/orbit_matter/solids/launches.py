"""Launches on any device: of single cells, sites and nodes, each gathering what the others have done to it."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportInvalidTypeForm=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_matter.bodies import Bodies
from orbit_matter.contact import Felt, held_back
from orbit_matter.kernels import FREE, Links, Particles
from orbit_matter.solids import inside
from orbit_matter.solids import kernels as k
from orbit_matter.solids.inside import MIDDLE, NODES
from orbit_matter.solids.kernels import PARTS, Sites, Solids, Solve
from orbit_matter.surfaces import Shapes

EIGHT = wp.constant(8)
"""Environments that share a pass over the preconditioner."""


@wp.struct
class Gather:
    """Cells that act on each node, the number of the node in each, and the sites in each cell."""

    first: wp.array[int]
    """(n + 1,) of each node in ``cell`` and ``local``."""
    cell: wp.array[int]
    """Cells of all nodes, one node after another."""
    local: wp.array[int]
    """Number of the node in each of these cells, 0 to 26."""
    first_site: wp.array[int]
    """(C + 1,) of each cell in ``site``."""
    site: wp.array[int]
    """Sites of all cells, one cell after another."""
    pull: wp.array2d[wp.vec3]
    """(N, 27 C) what each cell does to each of its nodes."""
    busy: wp.array2d[int]
    """(N, C) 1 where a site of the cell touches or is held in this step."""


@wp.func
def whole(parts: wp.array3d[float], env: int, i: int) -> float:
    """Return the sum of all parts."""
    found = float(0.0)
    for part in range(PARTS):
        found += parts[env, i, part]
    return found


@wp.kernel(enable_backward=False)
def orient(s: Solids, b: int, chosen: wp.array[bool]):
    """Find the rotations of a solid from scratch, in chosen environments."""
    env = wp.tid()
    if chosen[env]:
        s.body_turn[env, b] = k.first_rotation(k.mean_stretch(s, env, b, 0.0))
        for c in range(s.first_cell[b], s.first_cell[b + 1]):
            s.turn[env, c] = k.first_rotation(k.stretched(s, env, c, 0.0))


@wp.kernel(enable_backward=False)
def show(s: Solids, t: Sites):
    """Put sites where their nodes are."""
    env, site = wp.tid()
    k.show(s, t, env, site)


@wp.kernel(enable_backward=False)
def turn(s: Solids, g: Gather):
    """Update the rotations of cells, whose sites may let go."""
    env, c = wp.tid()
    g.busy[env, c] = 0
    k.turn_cell(s, env, c)


@wp.kernel(enable_backward=False)
def turn_bodies(s: Solids):
    """Update the mean rotations of solids."""
    env, b = wp.tid()
    k.turn_body(s, env, b)


@wp.kernel(enable_backward=False)
def strain(s: Solids, g: Gather, h: float):
    """Compute the forces of cells on their nodes at the point of linearisation."""
    env, number = wp.tid()
    c, i = number / NODES, number % NODES
    axes, found, kind = wp.quat_to_matrix(s.turn[env, c]), wp.vec3(), s.kind[c]
    for j in range(NODES):
        off = k.strain_node(s, env, c, j, axes, h)
        for row in range(3):
            for column in range(3):
                found[row] = found[row] + s.flat[kind, 3 * j + column, 3 * i + row] * off[column]
    g.pull[env, number] = axes * found * -k.stiffness_of(s, env, s.cell_body[c])


@wp.kernel(enable_backward=False)
def bend(s: Solids, solve: Solve, g: Gather, h: float):
    """Multiply the stiffness of cells and the direction p."""
    env, number = wp.tid()
    c, i = number / NODES, number % NODES
    axes, found, kind = wp.quat_to_matrix(s.turn[env, c]), wp.vec3(), s.kind[c]
    middle, b = solve.p[env, s.cells[c, MIDDLE]], s.cell_body[c]
    for j in range(NODES):
        # Relative to the middle, so that rigid motion cancels exactly and not to rounding.
        moved = (solve.p[env, s.cells[c, j]] - middle) @ axes
        for row in range(3):
            for column in range(3):
                found[row] = found[row] + s.flat[kind, 3 * j + column, 3 * i + row] * moved[column]
    g.pull[env, number] = axes * found * (k.stiffness_of(s, env, b) * k.damped(s, env, b, h))


@wp.func
def push_mate(t: Sites, g: Gather, env: int, site: int, force: wp.vec3):
    """Add the reaction to a force at a site to what the cell that it presses on does to its nodes."""
    c = t.mate[env, site]
    if c != k.NONE:
        u = t.mate_at[env, site]
        x, y, z = inside.lines(u[0]), inside.lines(u[1]), inside.lines(u[2])
        for i in range(NODES):
            # The only sum whose order is left to the device; on a CPU it is that of the sites.
            wp.atomic_sub(g.pull, env, c * NODES + i, force * inside.weight(x, y, z, i))


@wp.kernel(enable_backward=False)
def meet(s: Solids, t: Sites, g: Gather, held: Particles, links: Links, shapes: Shapes, felt: Felt):
    """Linearise contacts and attachments."""
    env, site = wp.tid()
    if site < t.contacts:
        if k.touch(s, t, links, shapes, felt, s.parameters, env, site):
            g.busy[env, t.cell[site]] = 1
            push_mate(t, g, env, site, t.force[env, site])
    elif k.grip(s, t, held, links, env, site):
        g.busy[env, t.cell[site]] = 1


@wp.kernel(enable_backward=False)
def block(t: Sites, b: Bodies, gravity: wp.array[wp.vec3]):
    """Find how far the engine holds free bodies."""
    env, i = wp.tid()
    t.blocked[env, i] = k.blocked(b, gravity[env], env, i)


@wp.kernel(enable_backward=False)
def push(t: Sites, b: Bodies, links: Links, way: float, lasting: int):
    """Move free bodies by what solids did to them, in ``way`` s^2: ``lasting`` beyond this substep or not."""
    env, i = wp.tid()
    # All sites are searched: no list of those on a body is kept, for bodies are few and lists would need sorting.
    link = b.link[env, i]
    origin = wp.transform_point(links.link[env, link], b.center[env, i])
    force, torque = wp.vec3(), wp.vec3()
    for site in range(t.x.shape[1]):
        if t.link[env, site] == link:
            force -= t.force[env, site]
            torque -= wp.cross(t.x[env, site] - origin, t.force[env, site])
    if lasting == 1:
        b.shift[env, i] = b.shift[env, i] + force * (way / b.mass[env, i])
        b.turned[env, i] = b.turned[env, i] + b.turning[env, i] * torque * way
    else:
        # What the engine holds stays where the engine has it: what held it in the last step is not known beforehand.
        free = 1.0 - t.blocked[env, i]
        shift = force * (way * free / b.mass[env, i]) - b.shift[env, i] * (1.0 - free)
        turn = b.turning[env, i] * torque * (way * free) - b.turned[env, i] * (1.0 - free)
        k.moved_by(b, links, env, i, shift, turn)


@wp.kernel(enable_backward=False)
def firmness(t: Sites, b: Bodies):
    """Add up the firmness of what presses on free bodies, in PARTS."""
    env, i, part = wp.tid()
    firm = float(0.0)
    for site in range(part, t.x.shape[1], PARTS):
        if t.link[env, site] == b.link[env, i]:
            firm += t.whole[env, site]
    t.firm_parts[env, i, part] = firm


@wp.kernel(enable_backward=False)
def soften(t: Sites, b: Bodies, links: Links, h: float):
    """Let free bodies give way to what presses on them."""
    env, site = wp.tid()
    for i in range(b.link.shape[1]):
        if t.link[env, site] == b.link[env, i]:
            k.soften(t, b, links, env, i, site, whole(t.firm_parts, env, i), h)


@wp.kernel(enable_backward=False)
def choose(s: Solids, t: Sites, solve: Solve, held: Particles):
    """Choose the preconditioner of each solid."""
    env, b = wp.tid()
    solve.preset[env, b] = k.is_preset(t, held, s, env, b)
    if b == 0:
        k.group_solids(s, t, solve, env)


@wp.kernel(enable_backward=False)
def resist(s: Solids, t: Sites, solve: Solve, g: Gather):
    """Compute the forces of sites against the direction p."""
    env, site = wp.tid()
    if t.link[env, site] != k.NONE:
        force = k.resist(t, env, site, k.relative(s, t, solve.p, env, site))
        t.pull[env, site] = force
        push_mate(t, g, env, site, force)


@wp.func
def gathered(g: Gather, t: Sites, forces: wp.array2d[wp.vec3], env: int, node: int) -> wp.vec3:
    """Return the force of cells and sites on a node."""
    found = wp.vec3()
    for n in range(g.first[node], g.first[node + 1]):
        c, i = g.cell[n], g.local[n]
        found += g.pull[env, c * NODES + i]
    return found + of_sites(g, t, forces, env, node)


@wp.func
def of_sites(g: Gather, t: Sites, forces: wp.array2d[wp.vec3], env: int, node: int) -> wp.vec3:
    """Return the force of sites on a node."""
    found = wp.vec3()
    # A site is in one cell, of which the node is one corner at most: none is counted twice.
    for n in range(g.first[node], g.first[node + 1]):
        c, i = g.cell[n], g.local[n]
        if g.busy[env, c] == 1:
            for m in range(g.first_site[c], g.first_site[c + 1]):
                site = g.site[m]
                if t.link[env, site] != k.NONE:
                    found += forces[env, site] * t.weights[site, i]
    return found


@wp.kernel(enable_backward=False)
def begin(s: Solids, t: Sites, solve: Solve, g: Gather, gravity: wp.array[wp.vec3], h: float):
    """Compute the residual at the point of linearisation."""
    env, i = wp.tid()
    solve.r[env, i] = k.own_force(s, gravity, env, i, h) + gathered(g, t, t.force, env, i)
    solve.delta[env, i] = wp.vec3()
    s.load[env, i] = wp.vec3()
    to_fours(s, solve, env, i)


@wp.kernel(enable_backward=False)
def apply(s: Solids, t: Sites, solve: Solve, g: Gather, h: float):
    """Multiply the matrix and the direction p, as q."""
    env, i = wp.tid()
    solve.q[env, i] = solve.p[env, i] * k.inertia_of(s, env, i, h) + gathered(g, t, t.pull, env, i)


@wp.kernel(enable_backward=False)
def precondition(s: Solids, solve: Solve):
    """Apply one row of the preconditioner in EIGHT environments."""
    group, row = wp.tid()
    b, begin, end = int(0), EIGHT * group, wp.min(EIGHT * (group + 1), s.x.shape[0])
    while row >= s.first_row[b + 1]:
        b += 1
    first = s.first_row[b]
    # Neighbouring threads read neighbouring numbers: those of a block of rows in one column.
    count = 3 * (s.first_node[b + 1] - s.first_node[b])
    lane, before = (row - first) % k.LANES, (row - first) / k.LANES * count
    preset, alike = solve.preset[begin, b], int(1)
    for env in range(begin + 1, end):
        if solve.preset[env, b] != preset:
            alike = 0
    if alike == 1:
        # Each number is read once for all eight, and theirs four at a time: reading is most of what this takes.
        low, high, at = wp.vec4(), wp.vec4(), s.inverse_at[b, preset] + before
        for j in range(count):
            number = s.flat_inverse[at + j, lane]
            low += number * solve.fours[2 * group, first + j]
            high += number * solve.fours[2 * group + 1, first + j]
        for env in range(begin, end):
            solve.out[env, row] = wp.where(env < begin + 4, low[env % 4], high[env % 4])
    else:
        for env in range(begin, end):
            found, own = float(0.0), s.inverse_at[b, solve.preset[env, b]] + before
            for j in range(count):
                found += s.flat_inverse[own + j, lane] * solve.flat_fours[env / 4, first + j, env % 4]
            solve.out[env, row] = found


@wp.func
def to_fours(s: Solids, solve: Solve, env: int, i: int):
    """Turn a node's residual into the axes of its solid's mesh, next to those of other environments."""
    b = s.body[i]
    local = wp.quat_rotate_inv(s.body_turn[env, b], solve.r[env, i])
    first = s.first_row[b] + 3 * (i - s.first_node[b])
    for axis in range(3):
        solve.flat_fours[env / 4, first + axis, env % 4] = local[axis]


@wp.func
def of_group(s: Solids, solve: Solve, parts: wp.array3d[float], env: int, b: int) -> float:
    """Return the sum over the solids that touch each other: in the same order for each of them."""
    found = float(0.0)
    for other in range(s.owner.shape[0]):
        if solve.group[env, other] == solve.group[env, b]:
            found += whole(parts, env, other)
    return found


@wp.kernel(enable_backward=False)
def aim(s: Solids, solve: Solve):
    """Turn the preconditioned residual back, and compute parts of its product with the residual."""
    env, b, part = wp.tid()
    rz = float(0.0)
    for i in range(s.first_node[b] + part, s.first_node[b + 1], PARTS):
        z = k.turned_back(s, solve, env, i)
        solve.z[env, i] = z
        rz += wp.dot(solve.r[env, i], z)
    solve.rz_parts[env, b, part] = rz


@wp.kernel(enable_backward=False)
def direct(s: Solids, solve: Solve, first: int):
    """Compute the new direction of search."""
    env, i = wp.tid()
    found, b = wp.vec3(solve.z[env, i]), s.body[i]
    if first == 0:  # the first one takes nothing of the step before, not even if it was not finite
        found += solve.p[env, i] * k.quotient(of_group(s, solve, solve.rz_parts, env, b), solve.rz[env, b])
    solve.p[env, i] = found


@wp.kernel(enable_backward=False)
def measure(s: Solids, solve: Solve):
    """Compute parts of the product of the direction and what the matrix makes of it."""
    env, b, part = wp.tid()
    pq = float(0.0)
    for i in range(s.first_node[b] + part, s.first_node[b + 1], PARTS):
        pq += wp.dot(solve.p[env, i], solve.q[env, i])
    solve.pq_parts[env, b, part] = pq
    if part == 0:  # which the next direction is compared with
        solve.rz[env, b] = of_group(s, solve, solve.rz_parts, env, b)


@wp.kernel(enable_backward=False)
def advance(s: Solids, solve: Solve):
    """Step along the direction."""
    env, i = wp.tid()
    b = s.body[i]
    step = k.quotient(solve.rz[env, b], of_group(s, solve, solve.pq_parts, env, b))
    solve.delta[env, i] = solve.delta[env, i] + solve.p[env, i] * step
    solve.r[env, i] = solve.r[env, i] - solve.q[env, i] * step
    to_fours(s, solve, env, i)


@wp.kernel(enable_backward=False)
def let_slip(s: Solids, t: Sites, links: Links, solve: Solve):
    """Compute the forces at the end of the step."""
    env, site = wp.tid()
    if t.link[env, site] != k.NONE:
        k.let_slip(s, t, links, solve, env, site)


@wp.kernel(enable_backward=False)
def conclude(s: Solids, solve: Solve, h: float):
    """Take nodes to the end of the step."""
    env, i = wp.tid()
    k.conclude_node(s, solve, env, i, h)


@wp.kernel(enable_backward=False)
def age(s: Solids):
    """Note that a step has been made."""
    env, b = wp.tid()
    s.fresh[env, b] = 0


@wp.kernel(enable_backward=False)
def press(t: Sites, felt: Felt, links: Links, share: float):
    """Add up the forces on each link, one site after another, so that sums repeat."""
    env, link = wp.tid()
    # Each thread owns a link, so that no two add to one sum at a time and its order is that of the sites.
    for site in range(t.x.shape[1]):
        if t.link[env, site] == link:
            k.press(t, felt, links, env, site, share)


@wp.kernel(enable_backward=False)
def lay(p: Particles, s: Solids, stiffness: float, h: float, share: float):
    """Move particles out of solids at the end of a substep, which is a ``share`` of a step of the solids."""
    env, i = wp.tid()
    if p.anchor[env, i] != FREE:
        return
    x, best, body = p.x[env, i], inside.Place(), int(0)
    best.cell = inside.NOWHERE
    for b in range(s.owner.shape[0]):
        found = inside.found_in(s.inside, env, b, x, p.radius[i], 0.0)
        if found.cell != inside.NOWHERE and (best.cell == inside.NOWHERE or found.depth > best.depth):
            best = found
            body = b
    if best.cell == inside.NOWHERE:
        return
    # As on links: what a spring moves the particle's inertia in a substep, in closed form.
    inertia = 1.0 / (p.w[env, i] * h * h)
    out = stiffness * best.depth / (inertia + stiffness)
    change = best.normal * out
    surface = inside.blended(s.cells, s.v, env, best.cell, best.local) * h
    friction = wp.max(p.parameters[env, p.owner[i], 3], s.parameters[env, s.owner[body], 3])
    change -= held_back(p.d[env, i] + change - surface, best.normal, friction * out)
    p.x[env, i] = x + change
    p.d[env, i] = p.d[env, i] + change
    p.v[env, i] = p.d[env, i] / h
    # Momentum is kept: the solid gets what the particle lost, as a mean over its step.
    force = change * (inertia * -share)
    u = best.local
    a, b1, c = inside.lines(u[0]), inside.lines(u[1]), inside.lines(u[2])
    for node in range(NODES):
        # On a CPU particles are taken in turn, so that sums repeat.
        wp.atomic_add(s.load, env, s.cells[best.cell, node], force * inside.weight(a, b1, c, node))
