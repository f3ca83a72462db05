"""The metrics of the conformance scenarios that MuJoCo misses, with a limit, which has a margin, and the reason."""

from __future__ import annotations

from orbit_core.interfaces import Gap
from orbit_mjmodel.gaps import CONTACT, MOTION

_IMPLICIT = (
    "the elasticity of cloth is integrated implicitly, which damps waves and turning in first order: half as much at "
    "half the step"
)
_EDGE = "it is of first order in the step, with contacts of two steps' time constant: half as much at half the step"
_CORNERS = "a piece that comes on the edge meets it as a chord, and is pushed out over four steps: 3 to 20 % off"
_SOFT = "a rope's edges are constraints that act over several steps: they give way under a swing, and damp it"

_MATTER = (
    Gap("cloth_free", "angular_momentum", 0.9, _IMPLICIT),
    Gap("cloth_free", "energy", 0.14, _IMPLICIT),
    Gap("cloth_edge", "slid", 0.5, _EDGE),
    Gap("rope_edge", "slid", 0.25, _CORNERS),
    Gap("rope_bobs", "energy", 0.07, _SOFT),
    Gap("rope_bobs", "length", 0.04, _SOFT),
    Gap("rope_bobs", "folding", 0.8, _SOFT),
)

_PRISMS = (
    "MuJoCo collides a height field prism by prism, and feels the sides between them; fields of up to eight planes in "
    "all are made of their flat faces and are as level as a plane"
)

_FIELDS = (
    Gap("level_height_field", "speed", 0.12, _PRISMS),
    Gap("level_height_field", "turn", 0.1, _PRISMS),
    Gap("level_height_field", "way", 0.8, _PRISMS),
    Gap("level_height_field", "aside", 0.25, _PRISMS),
    Gap("height_field_bowl", "amplitude", 0.3, _PRISMS),
)

GAPS: tuple[Gap, ...] = (*MOTION, *CONTACT, *_FIELDS, *_MATTER)
