"""Sentences on the parts of an articulation that a file format cannot hold."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from orbit_core.scene import Articulation, Geometry, Joint, Link, Mesh, MeshCollision
from orbit_core.scene.articulation import lacking_moment, principal_axes

JointTraits = tuple[tuple[str, Callable[[Joint], object]], ...]
"""Properties of joints that a format lacks, each with its test."""
LinkTraits = tuple[tuple[str, Callable[[Link], object]], ...]
"""Properties of links that a format lacks, each with its test."""
# Share of a link's inertia by which it may be rounded up without being reported.
_ROUNDING = 1e-6
# Names that a sentence lists; it counts the rest.
_MOST = 4


def missing_traits(
    file_format: str, articulation: Articulation, of_joints: JointTraits, of_links: LinkTraits
) -> Iterator[str]:
    """Yield a sentence for each property that some joints or links have and the format does not hold."""
    for what, joint_has in of_joints:
        if names := [joint.name for joint in articulation.joints if joint_has(joint)]:
            yield f"{file_format} does not hold {what}, which joints have: {listed(names)}"
    for what, link_has in of_links:
        if names := [link.name for link in articulation.links if link_has(link)]:
            yield f"{file_format} does not hold {what}, which links have: {listed(names)}"


def raised_inertias(articulation: Articulation) -> Iterator[str]:
    """Yield a sentence on the links whose inertia is written larger, as one that a solid can have."""
    # The writers raise these moments themselves; this only reports it.
    lacking = {link.name: lacking_moment(principal_axes(link.inertia)[0]) for link in articulation.links}
    largest = {link.name: float(np.abs(link.inertia).max()) for link in articulation.links}
    if names := [name for name, moment in lacking.items() if moment > _ROUNDING * largest[name]]:
        yield f"principal moments that no solid has are written larger, of links: {listed(names)}"


def has_geometry(link: Link, *kinds: type[Geometry]) -> bool:
    """Return True if the link collides as, or is drawn as, a geometry of one of these kinds."""
    return any(isinstance(shape.geometry, kinds) for shape in (*link.collisions, *link.visuals))


def collides_otherwise_than_by_hulls(link: Link) -> bool:
    """Return True if a mesh of the link collides otherwise than as its convex hull."""
    meshes = (shape.geometry for shape in link.collisions if isinstance(shape.geometry, Mesh))
    return any(mesh.collision is not MeshCollision.CONVEX_HULL for mesh in meshes)


def listed(names: Iterable[str]) -> str:
    """List some names, and count the rest."""
    every = list(names)
    rest = f" and {len(every) - _MOST} more" if len(every) > _MOST else ""
    return ", ".join(f"'{name}'" for name in every[:_MOST]) + rest
