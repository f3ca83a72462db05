"""What Bullet misses of the conformance scenarios: by how much, with a margin, and why."""

from __future__ import annotations

from orbit_core.interfaces import Gap

_RAY = "Bullet's search for where a ray meets a convex shape ends some millimetres off the surface"

_RAYS = (
    Gap("rays_on_primitives", "distance", 6e-3, _RAY),
    Gap("rays_on_primitives", "normal", 0.02, f"{_RAY}, whose normal it takes there"),
    Gap("rays_on_convex_meshes", "distance", 4e-3, "a hull is met at its collision margin, 0.5 mm outside"),
)

GAPS: tuple[Gap, ...] = (*_RAYS,)
