"""Launches for a GPU: a block of threads takes an environment, and its threads share the cells, sites and nodes.

An iteration of conjugate gradients is two launches: the preconditioner, which is a product of two matrices over all
environments, and the rest. All sums have one order, so that steps repeat to the bit.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportInvalidTypeForm=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_matter.block import BOUNDS, rank_in_block, sum_of_block, wait
from orbit_matter.bodies import Bodies
from orbit_matter.contact import Felt
from orbit_matter.kernels import FREE, Links, Particles
from orbit_matter.solids import inside
from orbit_matter.solids import kernels as k
from orbit_matter.solids.inside import MIDDLE, NODES
from orbit_matter.solids.kernels import Sites, Solids, Solve
from orbit_matter.solids.product import ENVS, multiply
from orbit_matter.surfaces import Shapes

WARP = wp.constant(32)
"""Threads that share a cell, one for each of its nodes: neighbours read neighbouring numbers of its matrix."""


@wp.struct
class Gather:
    """Cells that act on each node, sites that act on each cell, and tiles of the preconditioners."""

    first: wp.array[int]
    """(n + 1,) of each node in ``cell`` and ``local``."""
    cell: wp.array[int]
    """Cells of all nodes, one node after another."""
    local: wp.array[int]
    """Number of the node in each of these cells, 0 to 26."""
    site: wp.array[int]
    """(S,) sites of all cells, one cell after another."""
    first_active: wp.array2d[int]
    """(N, C + 1) of each cell in the list of sites that touch or are held in this step."""
    mated: wp.array2d[int]
    """(N, S) sites that press on solids in this step."""
    met: wp.array[int]
    """(N,) number of sites in ``mated``."""
    moved: wp.array2d[wp.vec3]
    """(N, 27 C) displacements of nodes in the axes of each cell."""
    pull: wp.array2d[wp.vec3]
    """(N, 27 C) forces of each cell, with its sites, on its nodes."""
    columns: wp.array3d[float]
    """(27 K, 9, 32) stiffness of each kind of cell: by node that moves, its axis and that of the force, and node that
    is pulled."""
    tile_body: wp.array[int]
    """(T,) solid of each tile of the preconditioners."""
    tile_row: wp.array[int]
    """(T,) first row of each tile, counted within its solid."""


@wp.kernel(enable_backward=False)
def turn(s: Solids):
    """Update the rotations of solids and of their cells."""
    env, number = wp.tid()
    solids = s.owner.shape[0]
    if number < solids:
        k.turn_body(s, env, number)
    else:
        k.turn_cell(s, env, number - solids)


@wp.kernel(enable_backward=False)
def meet(s: Solids, t: Sites, held: Particles, links: Links, shapes: Shapes, felt: Felt):
    """Linearise contacts and attachments."""
    env, site = wp.tid()
    # By a thread for each site and not by blocks: contacts need many registers.
    if site < t.contacts:
        k.touch(s, t, links, shapes, felt, s.parameters, env, site)
    else:
        k.grip(s, t, held, links, env, site)


@wp.func
def list_active(s: Solids, t: Sites, g: Gather, env: int, lane: int):
    """List the sites that touch or are held, one cell after another, and those that press on solids."""
    count, met, base, sites = int(0), int(0), int(0), t.x.shape[1]
    while base < sites:
        active, mated, site = int(0), int(0), int(0)
        if base + lane < sites:
            site = g.site[base + lane]
            if t.link[env, site] != k.NONE:
                active = 1
                if t.mate[env, site] != k.NONE:
                    mated = 1
        rank = rank_in_block(active)
        if active == 1:
            t.active[env, count + rank[0]] = site
        count += rank[1]
        if s.inside.meets == 1:
            rank = rank_in_block(mated)
            if mated == 1:
                g.mated[env, met + rank[0]] = site
            met += rank[1]
        base += wp.block_dim()
    if lane == 0:
        t.count[env] = count
        g.met[env] = met
    wait()
    # Where the list goes on to another cell, that one begins, and all without sites before it.
    for n in range(lane, count + 1, wp.block_dim()):
        before, c = int(-1), s.cells.shape[0]
        if n > 0:
            before = t.cell[t.active[env, n - 1]]
        if n < count:
            c = t.cell[t.active[env, n]]
        for cell in range(before + 1, c + 1):
            g.first_active[env, cell] = n


@wp.func
def soften(t: Sites, b: Bodies, links: Links, env: int, lane: int, h: float):
    """Let free bodies give way to what presses on them."""
    for i in range(b.link.shape[1]):
        firm = float(0.0)
        for n in range(lane, t.count[env], wp.block_dim()):
            if t.link[env, t.active[env, n]] == b.link[env, i]:
                firm += t.whole[env, t.active[env, n]]
        firm = sum_of_block(firm)
        for n in range(lane, t.count[env], wp.block_dim()):
            if t.link[env, t.active[env, n]] == b.link[env, i]:
                k.soften(t, b, links, env, i, t.active[env, n], firm, h)


@wp.func
def choose(s: Solids, t: Sites, solve: Solve, held: Particles, env: int, lane: int):
    """Choose the preconditioner of each solid."""
    for b in range(s.owner.shape[0]):
        anchored, missing = float(0.0), float(0.0)
        for vertex in range(lane, held.x.shape[1], wp.block_dim()):
            site = t.contacts + vertex
            if t.set[site] == 1 and t.owner[site] == s.owner[b]:
                if held.anchor[env, vertex] == FREE:
                    missing += 1.0
                else:
                    anchored += 1.0
        anchored = sum_of_block(anchored)
        missing = sum_of_block(missing)
        if lane == 0:
            solve.preset[env, b] = wp.where(anchored > 0.0 and missing == 0.0, 1, 0)


@wp.func
def of_cell(s: Solids, g: Gather, env: int, c: int, i: int) -> wp.vec3:
    """Return the stiffness of a cell times what its nodes moved, at one of them."""
    found, first = wp.vec3(), s.kind[c] * NODES
    for j in range(NODES):
        moved = g.moved[env, c * NODES + j]
        for axis in range(3):
            row = wp.vec3(
                g.columns[first + j, 3 * axis, i],
                g.columns[first + j, 3 * axis + 1, i],
                g.columns[first + j, 3 * axis + 2, i],
            )
            found += row * moved[axis]
    return wp.quat_rotate(s.turn[env, c], found) * k.stiffness_of(s, env, s.cell_body[c])


@wp.func
def of_sites(t: Sites, g: Gather, forces: wp.array2d[wp.vec3], env: int, c: int, i: int) -> wp.vec3:
    """Return what forces at sites do to a node of a cell: at its own sites, and at those that press on it."""
    found = wp.vec3()
    for n in range(g.first_active[env, c], g.first_active[env, c + 1]):
        site = t.active[env, n]
        found += forces[env, site] * t.weights[site, i]
    for n in range(g.met[env]):
        site = g.mated[env, n]
        if t.mate[env, site] == c:
            u = t.mate_at[env, site]
            x, y, z = inside.lines(u[0]), inside.lines(u[1]), inside.lines(u[2])
            found -= forces[env, site] * inside.weight(x, y, z, i)
    return found


@wp.func
def gathered(g: Gather, env: int, node: int) -> wp.vec3:
    """Return the force of all cells on a node."""
    found = wp.vec3()
    for n in range(g.first[node], g.first[node + 1]):
        found += g.pull[env, g.cell[n] * NODES + g.local[n]]
    return found


@wp.func
def of_group(s: Solids, solve: Solve, each: wp.array2d[float], env: int, b: int) -> float:
    """Return the sum over the solids that touch each other: in the same order for each of them."""
    found = float(0.0)
    for other in range(s.owner.shape[0]):
        if solve.group[env, other] == solve.group[env, b]:
            found += each[env, other]
    return found


@wp.kernel(enable_backward=False, launch_bounds=BOUNDS)
def begin(
    s: Solids, t: Sites, solve: Solve, g: Gather, held: Particles, links: Links, b: Bodies,
    gravity: wp.array[wp.vec3], h: float,
):  # fmt: skip
    """List what touches, and compute the residual at the point of linearisation."""
    env, lane = wp.tid()
    list_active(s, t, g, env, lane)
    wait()
    soften(t, b, links, env, lane, h)
    choose(s, t, solve, held, env, lane)
    if lane == 0:
        for solid in range(s.owner.shape[0]):
            solve.group[env, solid] = solid
        for n in range(g.met[env]):
            k.join(s, t, solve, env, g.mated[env, n])
    cells = s.cells.shape[0]
    for number in range(lane, NODES * cells, wp.block_dim()):
        c = number / NODES
        axes = wp.quat_to_matrix(s.turn[env, c])
        g.moved[env, number] = k.strain_node(s, env, c, number % NODES, axes, h)
    wait()
    for number in range(lane, WARP * cells, wp.block_dim()):
        c, i = number / WARP, number % WARP
        if i < NODES:
            g.pull[env, c * NODES + i] = of_sites(t, g, t.force, env, c, i) - of_cell(s, g, env, c, i)
    wait()
    for i in range(lane, s.x.shape[1], wp.block_dim()):
        solve.r[env, i] = k.own_force(s, gravity, env, i, h) + gathered(g, env, i)
        solve.delta[env, i] = wp.vec3()
        s.load[env, i] = wp.vec3()
        k.to_rows(s, solve, env, i)


@wp.kernel(enable_backward=False)
def precondition(s: Solids, solve: Solve, g: Gather):
    """Multiply a tile of a preconditioner and the residuals of ENVS environments."""
    group, tile, _lane = wp.tid()
    b = g.tile_body[tile]
    first, nodes = s.first_row[b], s.first_node[b + 1] - s.first_node[b]
    padded, free, attached = s.first_row[b + 1] - first, s.inverse_at[b, 0], s.inverse_at[b, 1]
    row = g.tile_row[tile]
    multiply(
        solve.rows, s.flat_inverse, solve.preset, solve.out, ENVS * group, b, first, row, padded, 3 * nodes, free,
        attached,
    )  # fmt: skip


@wp.kernel(enable_backward=False, launch_bounds=BOUNDS)
def iterate(s: Solids, t: Sites, solve: Solve, g: Gather, h: float, first: int):
    """Make an iteration of conjugate gradients from what the preconditioner makes of the residual."""
    env, lane = wp.tid()
    solids, cells, nodes = s.owner.shape[0], s.cells.shape[0], s.x.shape[1]
    for b in range(solids):
        rz = float(0.0)
        for i in range(s.first_node[b] + lane, s.first_node[b + 1], wp.block_dim()):
            z = k.turned_back(s, solve, env, i)
            solve.z[env, i] = z
            rz += wp.dot(solve.r[env, i], z)
        rz = sum_of_block(rz)
        if lane == 0:
            solve.turned[env, b] = rz
    wait()
    for i in range(lane, nodes, wp.block_dim()):
        p, own = wp.vec3(solve.z[env, i]), int(s.body[i])
        if first == 0:  # the first one takes nothing of the step before, not even if it was not finite
            p += solve.p[env, i] * k.quotient(of_group(s, solve, solve.turned, env, own), solve.rz[env, own])
        solve.p[env, i] = p
    wait()
    for b in range(lane, solids, wp.block_dim()):  # which the next direction is compared with
        solve.rz[env, b] = of_group(s, solve, solve.turned, env, b)
    for number in range(lane, NODES * cells, wp.block_dim()):
        c = number / NODES
        # Relative to the middle, so that rigid motion cancels exactly and not to rounding.
        moved = solve.p[env, s.cells[c, number % NODES]] - solve.p[env, s.cells[c, MIDDLE]]
        g.moved[env, number] = wp.quat_rotate_inv(s.turn[env, c], moved)
    for n in range(lane, t.count[env], wp.block_dim()):
        site = t.active[env, n]
        t.pull[env, site] = k.resist(t, env, site, k.relative(s, t, solve.p, env, site))
    wait()
    for number in range(lane, WARP * cells, wp.block_dim()):
        c, i = number / WARP, number % WARP
        if i < NODES:
            strain = of_cell(s, g, env, c, i) * k.damped(s, env, s.cell_body[c], h)
            g.pull[env, c * NODES + i] = strain + of_sites(t, g, t.pull, env, c, i)
    wait()
    for b in range(solids):
        pq = float(0.0)
        for i in range(s.first_node[b] + lane, s.first_node[b + 1], wp.block_dim()):
            q = solve.p[env, i] * k.inertia_of(s, env, i, h) + gathered(g, env, i)
            solve.q[env, i] = q
            pq += wp.dot(solve.p[env, i], q)
        pq = sum_of_block(pq)
        if lane == 0:
            solve.step[env, b] = pq
    wait()
    for i in range(lane, nodes, wp.block_dim()):
        own = int(s.body[i])
        step = k.quotient(solve.rz[env, own], of_group(s, solve, solve.step, env, own))
        solve.delta[env, i] = solve.delta[env, i] + solve.p[env, i] * step
        solve.r[env, i] = solve.r[env, i] - solve.q[env, i] * step
        k.to_rows(s, solve, env, i)


@wp.kernel(enable_backward=False, launch_bounds=BOUNDS)
def conclude(s: Solids, t: Sites, solve: Solve, links: Links, felt: Felt, h: float, share: float):
    """Move nodes and sites to the end of the step, and add up the forces on links."""
    env, lane = wp.tid()
    for n in range(lane, t.count[env], wp.block_dim()):
        k.let_slip(s, t, links, solve, env, t.active[env, n])
    wait()
    for i in range(lane, s.x.shape[1], wp.block_dim()):
        k.conclude_node(s, solve, env, i, h)
    wait()
    for b in range(lane, s.owner.shape[0], wp.block_dim()):
        s.fresh[env, b] = 0
    for site in range(lane, t.x.shape[1], wp.block_dim()):
        k.show(s, t, env, site)
    wait()
    # A thread owns a link, so that no two add to one sum at a time.
    for link in range(lane, felt.torques.shape[1], wp.block_dim()):
        for n in range(t.count[env]):
            if t.link[env, t.active[env, n]] == link:
                k.press(t, felt, links, env, t.active[env, n], share)
