"""The metrics of the conformance scenarios that MuJoCo misses, with a limit, which has a margin, and the reason."""

from __future__ import annotations

from orbit_core.interfaces import Gap
from orbit_mjmodel.gaps import CONTACT, CREEP, MOTION

_IMPLICIT = (
    "the elasticity of cloth is integrated implicitly, which damps waves and turning in first order: half as much at "
    "half the step"
)
_SLIDING = (
    "the convex friction cone pushes what slides off the surface, and particles that are off it for a moment rub less"
)
_BRIDGE = (
    "where table and rounded edge meet, triangles touch both at many points, and the cloth comes over the edge later"
)
_CORNERS = "stiff pieces of 10 mm touch a round edge of 30 mm at some points only, and rub less there"

_MATTER = (
    Gap("cloth_free", "angular_momentum", 0.9, _IMPLICIT),
    Gap("cloth_free", "energy", 0.14, _IMPLICIT),
    Gap("cloth_slope", "creep", 2.5e-4, CREEP),
    Gap("cloth_slope", "acceleration", 8e-3, _SLIDING),
    Gap("cloth_edge", "slid", 0.5, _BRIDGE),
    Gap("cloth_grasp", "slip", 6e-4, CREEP),
    Gap("rope_edge", "limit", 0.2, _CORNERS),
    Gap("rope_edge", "slid", 0.25, _CORNERS),
    Gap("rope_grasp", "slip", 9e-4, CREEP),
)

GAPS: tuple[Gap, ...] = (*MOTION, *CONTACT, *_MATTER)
