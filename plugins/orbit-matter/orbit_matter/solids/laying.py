"""Particles of cloth and ropes on solids: compliant, with Coulomb friction, felt by the solid in its next step."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportInvalidTypeForm=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_matter.contact import held_back
from orbit_matter.kernels import FREE, Particles
from orbit_matter.solids import inside
from orbit_matter.solids.inside import NODES
from orbit_matter.solids.kernels import Solids


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
