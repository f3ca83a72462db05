"""Friction and blows between liquids of different densities and viscosities: what one gains the other loses.

Sums over neighbours take a particle's own viscosity and density for all of them, which is right within one liquid.
Where two meet, either would feel another friction and another blow than it gives. Both have the harmonic mean here, as
layers in a row do (Cleary, "Modelling confined multi-material heat and mass flows using SPH", 1998).
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportInvalidTypeForm=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_matter.fluid.kernels import RUBBING, SHOCK, STRUCK, Fluid, velocity_of


@wp.kernel(enable_backward=False)
def mix(f: Fluid, h: float, lanes: int):
    """Correct the velocities of a push near other liquids, by ``lanes`` threads for each environment."""
    env, lane = wp.tid()
    for i in range(lane, f.x.shape[1], lanes):
        mix_one(f, h, env, i)


@wp.func
def mix_one(f: Fluid, h: float, env: int, i: int):
    x, v, owner = f.x[env, i], velocity_of(f.motion[env, i]), f.owner[i]
    density = density_of(f, env, i)
    rubbing, half = wp.max(f.rough * density, f.viscosity[i]), 0.5 / f.length
    blow, fastest = SHOCK * f.length * f.length, STRUCK * f.spacing / (h * f.length)
    given = wp.vec3()
    for k in range(f.count[env, i]):
        j = f.neighbours[env, i, k]
        # Lists are filled up with a row beyond the last particle.
        if j < f.x.shape[1]:  # noqa: SIM102 - Warp evaluates both sides of an `and`
            if f.owner[j] != owner:
                place = f.place[env, j]
                arm = x - velocity_of(place)
                square = wp.length_sq(arm) + 1.0e-16
                t = wp.max(1.0 - half * wp.sqrt(square), 0.0)
                part, passed = t * t * t * place[3], velocity_of(f.motion[env, j]) - v
                closing, other = wp.dot(passed, arm) / square, density_of(f, env, j)
                struck = wp.min(wp.max(closing, 0.0), fastest)
                harder = blow * struck * struck * (mean_of(density, other) - density)
                rougher = mean_of(rubbing, wp.max(f.rough * other, f.viscosity[j])) - rubbing
                given += arm * (part * (harder + RUBBING * closing * rougher))
    ahead = f.pushed[env, i]
    ahead_v = velocity_of(ahead) + given * (f.slope / density * h)
    f.pushed[env, i] = wp.vec4(ahead_v[0], ahead_v[1], ahead_v[2], ahead[3])


@wp.func
def density_of(f: Fluid, env: int, i: int) -> float:
    """Return the density of a particle in kg/m^3."""
    return f.rest_density[i] * f.parameters[env, f.owner[i], 0] * f.s[env, i]


@wp.func
def mean_of(a: float, b: float) -> float:
    """Return the harmonic mean of two numbers above zero."""
    return 2.0 * a * b / (a + b)
