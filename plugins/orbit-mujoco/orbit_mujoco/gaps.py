"""The metrics of the conformance scenarios that MuJoCo misses, with a limit, which has a margin, and the reason."""

from __future__ import annotations

from orbit_core.interfaces import Gap
from orbit_mjmodel.gaps import CONTACT, MOTION

_IMPLICIT = (
    "the elasticity of cloth is integrated implicitly, which damps waves and turning in first order: half as much at "
    "half the step"
)
_BRIDGE = (
    "where table and rounded edge meet, triangles touch both at many points, and the cloth comes over the edge later"
)
_CORNERS = "stiff pieces of 10 mm touch a round edge of 30 mm at some points only, and rub less there"

_MATTER = (
    Gap("cloth_free", "angular_momentum", 0.9, _IMPLICIT),
    Gap("cloth_free", "energy", 0.14, _IMPLICIT),
    Gap("cloth_edge", "slid", 0.5, _BRIDGE),
    Gap("rope_edge", "slid", 0.25, _CORNERS),
)

GAPS: tuple[Gap, ...] = (*MOTION, *CONTACT, *_MATTER)
