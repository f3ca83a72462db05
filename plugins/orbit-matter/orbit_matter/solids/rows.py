"""Launches for a CPU: one thread takes all cells, sites and nodes of an environment in turn."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportInvalidTypeForm=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_matter.bodies import Bodies
from orbit_matter.contact import Felt
from orbit_matter.kernels import Links, Particles
from orbit_matter.solids import inside
from orbit_matter.solids import kernels as k
from orbit_matter.solids.inside import MIDDLE, NODES
from orbit_matter.solids.kernels import Column, Lanes, Sites, Solids, Solve
from orbit_matter.surfaces import Shapes


@wp.func
def pull(s: Solids, c: int, local: Column) -> Column:
    """Multiply the stiffness of a cell and what its nodes moved, in its axes."""
    # Whole columns at a time, which the compiler turns into vector instructions: 3.5 multiply-adds a nanosecond.
    found, kind = Column(), s.kind[c]
    for j in range(81):
        found += s.stiffness[kind, j] * local[j]
    return found


@wp.func
def scatter(s: Solids, to: wp.array2d[wp.vec3], env: int, c: int, axes: wp.mat33, local: Column, scale: float):
    """Add what a cell does to its nodes, given in its axes."""
    for i in range(NODES):
        node = s.cells[c, i]
        to[env, node] = to[env, node] + axes * wp.vec3(local[3 * i], local[3 * i + 1], local[3 * i + 2]) * scale


@wp.func
def scatter_site(s: Solids, t: Sites, to: wp.array2d[wp.vec3], env: int, site: int, force: wp.vec3):
    """Add a force at a site to its nodes."""
    c = t.cell[site]
    for i in range(NODES):
        node = s.cells[c, i]
        to[env, node] = to[env, node] + force * t.weights[site, i]


@wp.func
def scatter_mate(s: Solids, t: Sites, to: wp.array2d[wp.vec3], env: int, site: int, force: wp.vec3):
    """Add the reaction to a force at a site to the nodes of the solid that it presses on."""
    c = t.mate[env, site]
    if c != k.NONE:
        u = t.mate_at[env, site]
        x, y, z = inside.lines(u[0]), inside.lines(u[1]), inside.lines(u[2])
        for i in range(NODES):
            node = s.cells[c, i]
            to[env, node] = to[env, node] - force * inside.weight(x, y, z, i)


@wp.kernel(enable_backward=False)
def begin(s: Solids, solve: Solve, gravity: wp.array[wp.vec3], h: float):
    """Update rotations, and compute the residual at the point of linearisation without what sites add."""
    env = wp.tid()
    for b in range(s.owner.shape[0]):
        k.turn_body(s, env, b)
    for i in range(s.x.shape[1]):
        solve.r[env, i] = k.own_force(s, gravity, env, i, h)
        solve.delta[env, i] = wp.vec3()
        s.load[env, i] = wp.vec3()
    for c in range(s.cells.shape[0]):
        k.turn_cell(s, env, c)
        axes, local = wp.quat_to_matrix(s.turn[env, c]), Column()
        for i in range(NODES):
            strain = k.strain_node(s, env, c, i, axes, h)
            for axis in range(3):
                local[3 * i + axis] = strain[axis]
        scatter(s, solve.r, env, c, axes, pull(s, c, local), -k.stiffness_of(s, env, s.cell_body[c]))


@wp.kernel(enable_backward=False)
def meet(
    s: Solids, t: Sites, solve: Solve, held: Particles, links: Links, shapes: Shapes, felt: Felt, b: Bodies, h: float
):
    """Linearise contacts and attachments, and add their forces to the residual."""
    env = wp.tid()
    count = int(0)
    for site in range(t.x.shape[1]):
        found = bool(False)
        if site < t.contacts:
            found = k.touch(s, t, links, shapes, felt, s.parameters, env, site)
        else:
            found = k.grip(s, t, held, links, env, site)
        if found:
            t.active[env, count] = site
            count += 1
    t.count[env] = count
    # Shares of a body are known only when all sites on it are.
    for i in range(b.link.shape[1]):
        firm = float(0.0)
        for n in range(count):
            if t.link[env, t.active[env, n]] == b.link[env, i]:
                firm += t.whole[env, t.active[env, n]]
        for n in range(count):
            if t.link[env, t.active[env, n]] == b.link[env, i]:
                k.soften(t, b, links, env, i, t.active[env, n], firm, h)
    for n in range(count):
        scatter_site(s, t, solve.r, env, t.active[env, n], t.force[env, t.active[env, n]])
        scatter_mate(s, t, solve.r, env, t.active[env, n], t.force[env, t.active[env, n]])
    k.group_solids(s, t, solve, env)
    for solid in range(s.owner.shape[0]):
        solve.preset[env, solid] = k.is_preset(t, held, s, env, solid)


@wp.kernel(enable_backward=False)
def ready(s: Solids, solve: Solve):
    """Turn the first residual into the axes of meshes."""
    env = wp.tid()
    for i in range(s.x.shape[1]):
        k.to_rows(s, solve, env, i)


@wp.func
def block_times_residual(s: Solids, solve: Solve, env: int, at: int, first: int, count: int) -> Lanes:
    """Multiply LANES rows of a preconditioner and the residual of one environment."""
    found = Lanes()
    for j in range(count):
        found += s.inverse[at + j] * solve.rows[env, first + j]
    return found


@wp.kernel(enable_backward=False)
def precondition(s: Solids, solve: Solve):
    """Multiply LANES rows of the preconditioner and the residuals of FOUR environments."""
    # Each column is read once for all four and stays in registers: 11 multiply-adds a nanosecond, 5 with one. A row at
    # a time takes 15 times as long as LANES.
    block, group = wp.tid()
    row, b = block * k.LANES, int(0)
    while row >= s.first_row[b + 1]:
        b += 1
    first = s.first_row[b]
    count = 3 * (s.first_node[b + 1] - s.first_node[b])
    before = (row - first) / k.LANES * count
    # Beyond the last environment that one is computed again, by the same thread.
    last = s.x.shape[0] - 1
    e0, e1 = wp.min(k.FOUR * group, last), wp.min(k.FOUR * group + 1, last)
    e2, e3 = wp.min(k.FOUR * group + 2, last), wp.min(k.FOUR * group + 3, last)
    p0, p1, p2, p3 = solve.preset[e0, b], solve.preset[e1, b], solve.preset[e2, b], solve.preset[e3, b]
    if p0 == p1 and p0 == p2 and p0 == p3:
        f0, f1, f2, f3, at = Lanes(), Lanes(), Lanes(), Lanes(), s.inverse_at[b, p0] + before
        for j in range(count):
            column = s.inverse[at + j]
            f0 += column * solve.rows[e0, first + j]
            f1 += column * solve.rows[e1, first + j]
            f2 += column * solve.rows[e2, first + j]
            f3 += column * solve.rows[e3, first + j]
        solve.out_lanes[e0, block] = f0
        solve.out_lanes[e1, block] = f1
        solve.out_lanes[e2, block] = f2
        solve.out_lanes[e3, block] = f3
    else:
        for env in range(e0, e3 + 1):
            at = s.inverse_at[b, solve.preset[env, b]] + before
            solve.out_lanes[env, block] = block_times_residual(s, solve, env, at, first, count)


@wp.func
def in_group(s: Solids, solve: Solve, env: int, b: int) -> float:
    """Sum of residual times direction over the group of a solid."""
    found = float(0.0)
    for other in range(s.owner.shape[0]):
        if solve.group[env, other] == solve.group[env, b]:
            found += solve.rz[env, other]
    return found


@wp.func
def apply(s: Solids, t: Sites, solve: Solve, h: float, env: int):
    """Multiply the matrix and the direction p, as q."""
    for i in range(s.x.shape[1]):
        solve.q[env, i] = solve.p[env, i] * k.inertia_of(s, env, i, h)
    for c in range(s.cells.shape[0]):
        axes, local, middle = wp.quat_to_matrix(s.turn[env, c]), Column(), solve.p[env, s.cells[c, MIDDLE]]
        for i in range(NODES):
            moved = (solve.p[env, s.cells[c, i]] - middle) @ axes
            for axis in range(3):
                local[3 * i + axis] = moved[axis]
        b = s.cell_body[c]
        scatter(s, solve.q, env, c, axes, pull(s, c, local), k.stiffness_of(s, env, b) * k.damped(s, env, b, h))
    for n in range(t.count[env]):
        site = t.active[env, n]
        force = k.resist(t, env, site, k.relative(s, t, solve.p, env, site))
        scatter_site(s, t, solve.q, env, site, force)
        scatter_mate(s, t, solve.q, env, site, force)


@wp.kernel(enable_backward=False)
def iterate(s: Solids, t: Sites, solve: Solve, h: float, first: int):
    """Make an iteration of conjugate gradients from what the preconditioner makes of the residual."""
    env = wp.tid()
    solids = s.owner.shape[0]
    for b in range(solids):
        solve.turned[env, b] = in_group(s, solve, env, b)
    for b in range(solids):
        rz = float(0.0)
        for i in range(s.first_node[b], s.first_node[b + 1]):
            z = k.turned_back(s, solve, env, i)
            solve.z[env, i] = z
            rz += wp.dot(solve.r[env, i], z)
        solve.rz[env, b] = rz
    for b in range(solids):
        turned = k.quotient(in_group(s, solve, env, b), solve.turned[env, b])
        for i in range(s.first_node[b], s.first_node[b + 1]):
            z = solve.z[env, i]
            if first == 0:  # the first one takes nothing of the step before, not even if it was not finite
                z += solve.p[env, i] * turned
            solve.p[env, i] = z
    apply(s, t, solve, h, env)
    for b in range(solids):
        solve.step[env, b] = 0.0
    for b in range(solids):
        pq = float(0.0)
        for i in range(s.first_node[b], s.first_node[b + 1]):
            pq += wp.dot(solve.p[env, i], solve.q[env, i])
        group = solve.group[env, b]
        solve.step[env, group] = solve.step[env, group] + pq
    for b in range(solids):
        # The lowest number of a group is its own, and comes first: its sum is read before it is replaced.
        group = solve.group[env, b]
        if group == b:
            solve.step[env, b] = k.quotient(in_group(s, solve, env, b), solve.step[env, b])
        step = solve.step[env, group]
        for i in range(s.first_node[b], s.first_node[b + 1]):
            solve.delta[env, i] = solve.delta[env, i] + solve.p[env, i] * step
            solve.r[env, i] = solve.r[env, i] - solve.q[env, i] * step
            k.to_rows(s, solve, env, i)


@wp.kernel(enable_backward=False)
def conclude(s: Solids, t: Sites, solve: Solve, links: Links, felt: Felt, h: float, share: float):
    """Move nodes and sites to the end of the step, and add up the forces on links."""
    env = wp.tid()
    for n in range(t.count[env]):
        k.let_slip(s, t, links, solve, env, t.active[env, n])
    for i in range(s.x.shape[1]):
        k.conclude_node(s, solve, env, i, h)
    for b in range(s.owner.shape[0]):
        s.fresh[env, b] = 0
    for site in range(t.x.shape[1]):
        k.show(s, t, env, site)
    for n in range(t.count[env]):
        k.press(t, felt, links, env, t.active[env, n], share)
