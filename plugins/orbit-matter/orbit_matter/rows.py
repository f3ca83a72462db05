"""Kernels for a CPU, where one launch thread goes over all particles or constraints of an environment.

They do what the kernels of the same names do, in the order of the colours: the bits are the same. An environment's
particles stay in the core's cache, and no index is taken apart for each constraint: cloth of 441 particles takes half
the time.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_matter.contact import NEAREST, Felt, end_between, end_substep, is_near, range_of
from orbit_matter.kernels import Bends, Links, Particles, Triangles, go_on, push, solve_bend, solve_triangle
from orbit_matter.self_contact import Neighbours, gather
from orbit_matter.surfaces import Shapes


@wp.kernel(enable_backward=False)
def find_near(p: Particles, links: Links, shapes: Shapes, felt: Felt, step: float):
    """Shapes that no particle can be near are passed over: those far from a box around all of them."""
    env = wp.tid()
    low, high, farthest, count = p.x[env, 0] + wp.vec3(), p.x[env, 0] + wp.vec3(), float(0.0), p.x.shape[1]
    for i in range(count):
        low, high = wp.min(low, p.x[env, i]), wp.max(high, p.x[env, i])
        farthest = wp.max(farthest, range_of(p, step, env, i))
        for k in range(NEAREST):
            felt.near[env, i, k] = -1
    kind = env % shapes.kind.shape[0]
    for s in range(shapes.kind.shape[1]):
        pose, reach = links.shape[env, s], links.reach[env, s]
        middle = wp.transform_get_translation(pose)
        apart = wp.length(middle - wp.max(low, wp.min(high, middle)))
        if apart < reach + farthest:
            for i in range(count):
                k = int(0)
                own = p.exempt[env, i] == shapes.link[kind, s]
                if not own and is_near(
                    shapes, kind, s, pose, reach, p.x[env, i], p.radius[i], range_of(p, step, env, i)
                ):
                    while k < NEAREST and felt.near[env, i, wp.min(k, NEAREST - 1)] >= 0:
                        k += 1
                    if k < NEAREST:
                        felt.near[env, i, k] = s


@wp.kernel(enable_backward=False)
def predict(p: Particles, links: Links, gravity: wp.array[wp.vec3], h: float):
    env = wp.tid()
    for i in range(p.x.shape[1]):
        go_on(p, links, gravity, h, env, i)


@wp.kernel(enable_backward=False)
def solve_triangles(p: Particles, t: Triangles, h: float, sweeps: int):
    env = wp.tid()
    for sweep in range(sweeps):
        for c in range(t.particles.shape[0]):
            solve_triangle(p, t, h, sweep, sweeps, env, c)


@wp.kernel(enable_backward=False)
def solve_bends(p: Particles, b: Bends, h: float):
    env = wp.tid()
    for c in range(b.particles.shape[0]):
        solve_bend(p, b, h, env, c)


@wp.kernel(enable_backward=False)
def separate(p: Particles, n: Neighbours, step: float):
    env = wp.tid()
    for i in range(p.x.shape[1]):
        gather(p, n, step, env, i)
    for i in range(p.x.shape[1]):
        push(p, env, i, n.moves[env, i])


@wp.kernel(enable_backward=False)
def finish(
    p: Particles, links: Links, shapes: Shapes, felt: Felt, gravity: wp.array[wp.vec3], stiffness: float, h: float,
    share: float,
):  # fmt: skip
    env = wp.tid()
    for i in range(p.x.shape[1]):
        if end_substep(p, links, shapes, felt, gravity, stiffness, h, share, env, i) > 1:
            end_between(p, links, shapes, felt, stiffness, h, share, env, i)
