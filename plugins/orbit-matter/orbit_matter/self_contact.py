"""Particles of matter against each other: cloth on itself, on other cloth, and ropes.

A hash of cells finds the pairs that may come near, again whenever a particle may have left the margin in which the last
search holds (the lists of Verlet, "Computer 'experiments' on classical fluids", 1967). In each substep two particles
nearer than the sum of their radii are moved apart, in shares that keep their momentum, and rub by Coulomb's law. A
particle gathers the moves of all its pairs, at half of their length, so that the order of pairs does not matter and
several at a time do not overshoot.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportInvalidTypeForm=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_matter.kernels import FREE, Particles, at, mass_of

NEIGHBOURS = wp.constant(16)
"""Most others that a particle is held against at a time; those met first count."""
FASTEST = wp.constant(0.25)
"""m/s at most with which two particles that were pressed together move apart, beside what stops them."""
RELAXED = wp.constant(0.5)
"""Part of the way out that a pair goes in one substep."""


@wp.struct
class Neighbours:
    """Cells of each environment as linked lists, and the pairs found in them."""

    head: wp.array2d[int]
    """(N, B) first particle of each bucket; -1 for none."""
    following: wp.array2d[int]
    """(N, P) the next in the bucket."""
    found: wp.array3d[int]
    """(N, P, NEIGHBOURS); -1 behind the last."""
    searched: wp.array2d[wp.vec3]
    """(N, P) where particles were at the last search."""
    stale: wp.array[int]
    """(N,) 1 where a search is due."""
    rest: wp.array[wp.vec3]
    """(P,) where particles are when nothing is bent."""
    radius: wp.array[float]
    """(P,) m"""
    touches: wp.array[int]
    """(P,) 1 for particles of what collides with itself."""
    moves: wp.array2d[wp.vec3]
    """(N, P) of this substep."""
    cell: float
    """Metres."""


@wp.func
def bucket_of(x: int, y: int, z: int, count: int) -> int:
    """Return the bucket of a cell, one of ``count``, a power of two.

    Teschner et al., "Optimized spatial hashing for collision detection of deformable objects" (2003).
    """
    return ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & (count - 1)


@wp.func
def cell_of(x: wp.vec3, cell: float) -> wp.vec3i:
    return wp.vec3i(int(wp.floor(x[0] / cell)), int(wp.floor(x[1] / cell)), int(wp.floor(x[2] / cell)))


@wp.kernel(enable_backward=False)
def doubt(p: Particles, n: Neighbours, margin: float, step: float):
    """Search again where a particle may go further than half the margin from where it was, until the step's end."""
    env, i = wp.tid()
    if wp.length(p.x[env, i] - n.searched[env, i]) + wp.length(p.v[env, i]) * step > 0.5 * margin:
        n.stale[env] = 1


@wp.kernel(enable_backward=False)
def clear(n: Neighbours):
    env, bucket = wp.tid()
    if n.stale[env] == 1:
        n.head[env, bucket] = -1


@wp.kernel(enable_backward=False)
def insert(p: Particles, n: Neighbours, renewed: int):
    """Into cells, by where particles are or, if not ``renewed``, by where they were at the last search."""
    env, i = wp.tid()
    if n.stale[env] == 0:
        return
    if renewed == 1:
        n.searched[env, i] = p.x[env, i]
    c = cell_of(n.searched[env, i], n.cell)
    bucket = bucket_of(c[0], c[1], c[2], n.head.shape[1])
    n.following[env, i] = wp.atomic_exch(n.head, env, bucket, i)


@wp.func
def noted(p: Particles, n: Neighbours, env: int, i: int, j: int, count: int) -> int:
    """Note particle j as a neighbour unless it is near in the own body or noted already; return the new count."""
    if count == NEIGHBOURS:
        return count
    if p.owner[i] == p.owner[j]:
        # Particles that overlap at rest, such as neighbours in a mesh, would be pushed apart for ever.
        apart = 1.01 * (n.radius[i] + n.radius[j])
        if n.touches[i] == 0 or wp.length_sq(n.rest[i] - n.rest[j]) <= apart * apart:
            return count
    for k in range(count):  # two cells may share a bucket
        if n.found[env, i, k] == j:
            return count
    n.found[env, i, count] = j
    return count + 1


@wp.kernel(enable_backward=False)
def find(p: Particles, n: Neighbours, margin: float):
    """Find the particles within the sum of radii and a margin that were further apart at rest."""
    env, i = wp.tid()
    if n.stale[env] == 0:
        return
    count, x = int(0), n.searched[env, i]
    c = cell_of(x, n.cell)
    buckets = n.head.shape[1]
    cell = int(0)
    while cell < 27:  # no unrolled loop: its body would be there 27 times
        dx, dy, dz = cell % 3 - 1, (cell // 3) % 3 - 1, cell // 9 - 1
        j = n.head[env, bucket_of(c[0] + dx, c[1] + dy, c[2] + dz, buckets)]
        while j >= 0:
            if j != i:
                reach = n.radius[i] + n.radius[j] + margin
                if wp.length_sq(n.searched[env, j] - x) < reach * reach:
                    count = noted(p, n, env, i, j, count)
            j = n.following[env, j]
        cell += 1
    if count < NEIGHBOURS:
        n.found[env, i, count] = -1


@wp.func
def gather(p: Particles, n: Neighbours, step: float, env: int, i: int):
    """Sum the moves that a particle's pairs request."""
    total = wp.vec3()
    x = at(p, env, i)
    k = int(0)
    while k < NEIGHBOURS:
        j = n.found[env, i, k]
        if j < 0:
            k = NEIGHBOURS
        else:
            arm = x - at(p, env, j)
            away = wp.length(arm)
            depth = n.radius[i] + n.radius[j] - away
            if depth > 0.0 and away > 1.0e-9:
                normal = arm / away
                # The lighter one moves more, so that the pair keeps its momentum.
                share = mass_of(p, env, j) / (mass_of(p, env, i) + mass_of(p, env, j))
                if p.anchor[env, j] != FREE:
                    share = float(1.0)
                slid = p.d[env, i] - p.d[env, j]
                met = wp.max(-wp.dot(normal, slid), 0.0)  # how far they came together in this substep
                slid = slid - normal * wp.dot(normal, slid)
                friction = wp.max(p.parameters[env, p.owner[i], 3], p.parameters[env, p.owner[j], 3])
                way = wp.length(slid)
                if way > friction * depth:
                    slid = slid * (friction * depth / way)
                total += (normal * wp.min(depth, met + FASTEST * step) - slid) * share
        k += 1
    # What a link holds gives way to no particle; the other one takes the whole move.
    if p.anchor[env, i] != FREE:
        total = wp.vec3()
    n.moves[env, i] = total * RELAXED


@wp.kernel(enable_backward=False)
def separate(p: Particles, n: Neighbours, step: float):
    env, i = wp.tid()
    gather(p, n, step, env, i)


@wp.kernel(enable_backward=False)
def move(p: Particles, n: Neighbours):
    env, i = wp.tid()
    p.d[env, i] = p.d[env, i] + n.moves[env, i]
