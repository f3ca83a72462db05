"""What of an articulation MJCF has no word for."""

from __future__ import annotations

import math
from collections.abc import Iterable

from orbit_assets.losses import (
    JointTraits,
    LinkTraits,
    collides_otherwise_than_by_hulls,
    has_geometry,
    listed,
    missing_traits,
    raised_inertias,
)
from orbit_core.scene import Articulation, HeightField, JointType, Plane, Shape

_OF_JOINTS: JointTraits = (("velocity limits", lambda joint: joint.movable and math.isfinite(joint.velocity_limit)),)
_OF_LINKS: LinkTraits = (
    ("height fields without a file", lambda link: has_geometry(link, HeightField)),
    ("collision with a mesh's own triangles or convex pieces", collides_otherwise_than_by_hulls),
    ("restitution and compliance", lambda link: any(_bounces(shape) for shape in link.collisions)),
    ("friction that differs at rest and sliding", lambda link: any(_two_frictions(shape) for shape in link.collisions)),
    ("semantic labels", lambda link: link.semantic_label),
)


def losses(articulation: Articulation) -> tuple[str, ...]:
    """What an MJCF file of the articulation does not say; a sentence each."""
    traits = missing_traits("MJCF", articulation, _OF_JOINTS, _OF_LINKS)
    return (*traits, *raised_inertias(articulation), *_of_the_whole(articulation))


def _of_the_whole(articulation: Articulation) -> Iterable[str]:
    if any(has_geometry(link, Plane) for link in articulation.links[1:]):
        yield "MJCF does not hold planes that move"
    endless = [
        joint.name
        for joint in articulation.joints
        if joint.type is JointType.REVOLUTE and (joint.lower_limit, joint.upper_limit) == (-math.inf, math.inf)
    ]
    if endless:
        yield f"joints without limits become continuous: {listed(endless)}"


def _bounces(shape: Shape) -> bool:
    return bool(shape.material.restitution or shape.material.compliance)


def _two_frictions(shape: Shape) -> bool:
    return shape.material.static_friction != shape.material.dynamic_friction
