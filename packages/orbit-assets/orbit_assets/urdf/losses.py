"""What of an articulation URDF has no word for."""

from __future__ import annotations

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
from orbit_core.scene import (
    Articulation,
    Capsule,
    HeightField,
    Link,
    PhysicsMaterial,
    Plane,
    Pose,
)

_OF_JOINTS: JointTraits = (
    ("armature", lambda joint: joint.movable and joint.armature),
    ("the stiffness of springs", lambda joint: joint.movable and joint.stiffness),
    ("higher powers of couplings", lambda joint: joint.mimic is not None and not joint.mimic.linear),
)
_OF_LINKS: LinkTraits = (
    ("planes and height fields", lambda link: has_geometry(link, Plane, HeightField)),
    ("collision with a mesh's own triangles or convex pieces", collides_otherwise_than_by_hulls),
    ("friction, restitution and compliance", lambda link: _has_material(link)),
    ("semantic labels", lambda link: link.semantic_label),
)


def losses(articulation: Articulation) -> tuple[str, ...]:
    """What a URDF file of the articulation does not say, or says in words that few read; a sentence each."""
    traits = missing_traits("URDF", articulation, _OF_JOINTS, _OF_LINKS)
    return (*traits, *raised_inertias(articulation), *_of_the_whole(articulation))


def _of_the_whole(articulation: Articulation) -> Iterable[str]:
    if articulation.loops:
        yield f"URDF does not hold joints that close loops: {listed(loop.name for loop in articulation.loops)}"
    if articulation.drives:
        yield f"URDF does not hold drives' gains: {listed(drive.joint for drive in articulation.drives)}"
    if articulation.home:
        yield "URDF does not hold a home pose"
    if articulation.self_collisions:
        yield "URDF does not say that the links collide with each other"
    if articulation.collision_exclusions:
        yield f"URDF does not hold {len(articulation.collision_exclusions)} pairs of links that never collide"
    if any(has_geometry(link, Capsule) for link in articulation.links):
        yield "capsules are written as <capsule>, which physics engines read and ROS does not"
    moved = [joint.child for joint in articulation.joints if joint.child_pose != Pose()]
    if moved:
        yield f"frames of links are written at their joints' frames: {listed(moved)}"


def _has_material(link: Link) -> bool:
    return any(shape.material != PhysicsMaterial() for shape in link.collisions)
