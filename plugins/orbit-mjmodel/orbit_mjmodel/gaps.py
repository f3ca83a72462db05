"""What MuJoCo's equations miss of the conformance scenarios, on any device: by how much, with a margin, and why."""

from __future__ import annotations

from orbit_core.interfaces import Gap

_ORIGIN = (
    "a free body's velocity is that of its origin and integrated in first order: a centre of mass aside leaves its "
    "path; integrator 'rk4' keeps it, where there is"
)
_GYROSCOPIC = "gyroscopic torques are taken at the beginning of the step, so that free bodies gain energy"
_REDUCED = (
    "joint velocities are integrated in first order, and the momenta that they add up to are then conserved in first "
    "order only; integrator 'rk4' keeps them to 2e-5"
)
_DRIVEN_LOOP = (
    "constraints are solved without the drives' damping, which integrator 'implicitfast' adds afterwards: a loop opens "
    "when a stiff drive starts it; integrator 'discrete' holds it to 0.4 mm, where there is"
)

MOTION = (
    Gap("projectile", "range", 7e-3, _ORIGIN),
    Gap("spinning_bodies", "energy", 0.02, _GYROSCOPIC),
    Gap("spinning_bodies", "path", 0.012, _ORIGIN),
    Gap("floating_chain", "linear_momentum", 0.012, _REDUCED),
    Gap("floating_chain", "angular_momentum", 0.025, _REDUCED),
    Gap("floating_chain", "path", 6e-3, _REDUCED),
    Gap("floating_chain", "energy", 0.03, _REDUCED),
    Gap("four_bar_linkage", "rocker", 0.05, _DRIVEN_LOOP),
    Gap("four_bar_linkage", "opening", 0.018, _DRIVEN_LOOP),
)
"""Of free motion and joints."""
