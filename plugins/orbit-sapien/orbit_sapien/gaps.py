"""What SAPIEN misses of the conformance scenarios: by how much, with a margin, and why."""

from __future__ import annotations

from orbit_core.interfaces import Gap

_PRISM = "PhysX has no cylinders: SAPIEN's are prisms of 32 sides"

_RAYS = (
    Gap("rays_on_primitives", "distance", 6e-3, _PRISM),
    Gap("rays_on_primitives", "normal", 0.11, _PRISM),
)

GAPS: tuple[Gap, ...] = (*_RAYS,)
