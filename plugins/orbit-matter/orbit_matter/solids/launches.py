"""Launches on any device, of single solids, sites and particles."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportInvalidTypeForm=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_matter.bodies import Bodies
from orbit_matter.contact import held_back
from orbit_matter.kernels import FREE, Links, Particles
from orbit_matter.solids import inside
from orbit_matter.solids import kernels as k
from orbit_matter.solids.inside import NODES
from orbit_matter.solids.kernels import Sites, Solids


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
