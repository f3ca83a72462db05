"""Links of one robot that touch each other at home.

A robot that collides with itself must not do so at home: contact would push its links apart from the first step on.
Files often have such pairs, for their collision shapes are wider than the parts (hulls of a wrist and the link before
the last), or for the real thing is built into a recess. These pairs are taken out of collision, and noted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations

from orbit_assets.convex import Convex, convex_shape, within
from orbit_core.interfaces.layout import home_positions
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import link_poses
from orbit_core.scene import Articulation, Entity

# Metres between links that count as touching: a drive that holds home lets them move by as much.
_CLEARANCE = 1e-3


def without_home_contacts(articulation: Articulation, home: Mapping[str, float]) -> Articulation:
    """Exclude collision of each pair of links that touch at home, with a note of them.

    Links touch where their collision shapes come within a millimetre of each other; meshes count as their convex
    hulls. Links that a joint connects never collide anyway. Whether the links collide with each other at all is left
    to ``self_collisions``.

    Args:
        articulation: the description.
        home: joint positions (rad, m) by regular expression over joint names (full match), zero or the nearest limit
            elsewhere.

    Raises:
        UnknownNameError: a key of ``home`` matches no joint.
        ConfigurationError: a position is outside its joint's limits.
    """
    merged = merge_fixed_links(articulation)  # links that fixed joints connect are one body
    at_home = home_positions(Entity(name=articulation.name, articulation=merged, home=home))
    positions = dict(zip(merged.joint_names, at_home.tolist(), strict=True))
    pairs = tuple(touching_links(merged, positions))
    if not pairs:
        return articulation
    told = ", ".join(f"{first} with {second}" for first, second in pairs)
    note = f"links that touch each other at home do not collide: {told}"
    return replace(
        articulation,
        collision_exclusions=(*articulation.collision_exclusions, *pairs),
        notes=(*articulation.notes, note),
    )


def touching_links(articulation: Articulation, positions: Mapping[str, float]) -> Iterator[tuple[str, str]]:
    """Yield pairs of links that touch at joint positions (rad, m), without joined and excluded ones.

    Links must be in topological order.
    """
    apart = {frozenset(pair) for pair in (*articulation.joined_links, *articulation.collision_exclusions)}
    shapes = _placed(articulation, positions)
    for first, second in combinations(shapes, 2):
        if frozenset((first, second)) not in apart and any(
            within(one, other, _CLEARANCE) for one in shapes[first] for other in shapes[second]
        ):
            yield first, second


def _placed(articulation: Articulation, positions: Mapping[str, float]) -> dict[str, list[Convex]]:
    """Return the collision shapes in the root's frame, of the links that have any."""
    poses = link_poses(articulation, positions)
    placed = {
        link.name: [convex_shape(shape, poses[link.name]) for shape in link.collisions] for link in articulation.links
    }
    return {name: found for name, shapes in placed.items() if (found := [shape for shape in shapes if shape])}
