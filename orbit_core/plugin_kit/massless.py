"""Links without mass, for engines that move nothing without: what carries them along, and what little may stand in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from orbit_core.interfaces.built import Approximation
from orbit_core.interfaces.layout import EntityLayout
from orbit_core.scene import Articulation, Link

STAND_IN = 1e-9
"""Of the mass, and of the smallest moments of inertia, that a link without mass carries: an engine's stand-in for none,
below what single precision resolves of the sum. A joint's acceleration is off by up to some forty times as much."""


def is_massless(articulation: Articulation, link: Link) -> bool:
    """Whether the link moves without mass. A root without mass is that of a fixed base."""
    return link.mass == 0 and link is not articulation.root


def carried(articulation: Articulation, link: Link) -> list[Link]:
    """The links with mass that hang on a link without, no other link with mass between."""
    by_name = {other.name: other for other in articulation.links}
    found: list[Link] = []
    pending = [link.name]
    while pending:
        parent = pending.pop()
        children = [by_name[joint.child] for joint in articulation.joints if joint.parent == parent]
        found += [child for child in children if child.mass > 0]
        pending += [child.name for child in children if child.mass == 0]
    return found


def with_stand_in(articulation: Articulation, link: Link) -> Link:
    """The link, with a share (:data:`STAND_IN`) of what it carries as mass and inertia if it moves without mass."""
    if not is_massless(articulation, link):
        return link
    held = carried(articulation, link)
    moment = sum(float(np.linalg.eigvalsh(each.inertia)[0]) for each in held)
    return replace(link, mass=STAND_IN * sum(each.mass for each in held), inertia=STAND_IN * moment * np.eye(3))


def stand_in_approximations(entity: EntityLayout, engine: str) -> Iterator[Approximation]:
    """A line of the build report for each link of the entity that has a stand-in for no mass."""
    articulation = entity.spec.articulation
    for link in articulation.links:
        if is_massless(articulation, link):
            got = f"{STAND_IN:g} of the mass and of the smallest moment of inertia that it carries"
            why = f"{engine} moves nothing without mass"
            yield Approximation(f"link '{link.name}' of '{entity.name}'", "no mass", got, why)
