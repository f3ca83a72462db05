"""What Bullet misses of the conformance scenarios: by how much, with a margin, and why."""

from __future__ import annotations

from orbit_core.interfaces import Gap

_RAY = "Bullet's search for where a ray meets a convex shape ends some millimetres off the surface"

_RAYS = (
    Gap("rays_on_primitives", "distance", 6e-3, _RAY),
    Gap("rays_on_primitives", "normal", 0.02, f"{_RAY}, whose normal it takes there"),
    Gap("rays_on_convex_meshes", "distance", 4e-3, "a hull is met at its collision margin, 0.5 mm outside"),
)

_GYROSCOPIC = "gyroscopic torques are taken at the beginning of the step, so that free bodies gain energy"
_REDUCED = (
    "joint velocities are integrated in first order, and the momenta that they add up to are then conserved in first "
    "order only"
)
_BACKWARD = (
    "drives take both spring and damper at the end of the step (backward Euler), which is stable at any gain and damps "
    "in first order"
)

_MOTION = (
    Gap("spinning_bodies", "energy", 0.025, _GYROSCOPIC),
    Gap("floating_chain", "linear_momentum", 0.012, _REDUCED),
    Gap("floating_chain", "angular_momentum", 0.025, _REDUCED),
    Gap("floating_chain", "path", 6e-3, _REDUCED),
    Gap("floating_chain", "energy", 0.03, _REDUCED),
    Gap("implicit_drive", "under", 0.06, _BACKWARD),
    Gap("implicit_drive", "damped", 0.03, _BACKWARD),
    Gap("implicit_drive", "final", 0.015, _BACKWARD),
)

GAPS: tuple[Gap, ...] = (
    *_RAYS,
    *_MOTION,
)
