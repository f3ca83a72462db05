"""Fixed joints removed: every link that cannot move against its parent becomes part of it, exactly."""

from __future__ import annotations

from dataclasses import replace

from orbit_core.preparation.inertia import MassProperties, combine
from orbit_core.scene import Articulation, Frame, Joint, Link, LoopJoint, Pose, Shape


def merge_fixed_links(articulation: Articulation) -> Articulation:
    """The same mechanism without fixed joints.

    Masses, centres of mass and inertias add up exactly (parallel-axis theorem). Each merged link leaves a
    :class:`Frame` of its name; shapes, frames, joints and collision exclusions move to the link that took it in, which
    keeps its own semantic label. Links must be in topological order.
    """
    if all(joint.movable for joint in articulation.joints):
        return articulation
    hosts = link_hosts(articulation)
    groups: dict[str, list[tuple[Link, Pose]]] = {}
    for link in articulation.links:
        host, pose = hosts[link.name]
        groups.setdefault(host, []).append((link, pose))
    merged = [Frame(link.name, *hosts[link.name]) for link in articulation.links if hosts[link.name][0] != link.name]
    return replace(
        articulation,
        links=tuple(_combine(members) for members in groups.values()),
        joints=tuple(_rebase_joint(joint, hosts) for joint in articulation.joints if joint.movable),
        frames=(*(_rebase_frame(frame, hosts) for frame in articulation.frames), *merged),
        collision_exclusions=_rename_pairs(articulation.collision_exclusions, hosts),
        loops=tuple(_rebase_loop(loop, hosts) for loop in articulation.loops),
    )


def link_hosts(articulation: Articulation) -> dict[str, tuple[str, Pose]]:
    """For each link the link that it ends up in when fixed joints are taken out, and its pose there."""
    hosts: dict[str, tuple[str, Pose]] = {}
    joint_of = {joint.child: joint for joint in articulation.joints}
    for link in articulation.links:
        joint = joint_of.get(link.name)
        if joint is None or joint.movable:
            hosts[link.name] = (link.name, Pose())
        else:
            host, pose = hosts[joint.parent]
            hosts[link.name] = (host, pose @ joint.parent_pose @ joint.child_pose.inverse())
    return hosts


def _combine(members: list[tuple[Link, Pose]]) -> Link:
    host = members[0][0]
    if len(members) == 1:
        return host
    bodies = [MassProperties(link.mass, link.center_of_mass, link.inertia).placed(pose) for link, pose in members]
    body = combine(bodies) if any(part.mass for part in bodies) else bodies[0]
    return replace(
        host,
        mass=body.mass,
        center_of_mass=body.center_of_mass,
        inertia=body.inertia,
        collisions=tuple(_moved(shape, pose) for link, pose in members for shape in link.collisions),
        visuals=tuple(_moved(shape, pose) for link, pose in members for shape in link.visuals),
    )


def _moved(shape: Shape, pose: Pose) -> Shape:
    return shape if pose == Pose() else replace(shape, pose=pose @ shape.pose)


def _rebase_joint(joint: Joint, hosts: dict[str, tuple[str, Pose]]) -> Joint:
    host, pose = hosts[joint.parent]
    return joint if host == joint.parent else replace(joint, parent=host, parent_pose=pose @ joint.parent_pose)


def _rebase_frame(frame: Frame, hosts: dict[str, tuple[str, Pose]]) -> Frame:
    host, pose = hosts[frame.link]
    return frame if host == frame.link else Frame(frame.name, host, pose @ frame.pose)


def _rebase_loop(loop: LoopJoint, hosts: dict[str, tuple[str, Pose]]) -> LoopJoint:
    (first, one), (second, other) = hosts[loop.first], hosts[loop.second]
    points = (one @ Pose(loop.first_point)).position, (other @ Pose(loop.second_point)).position
    between = one @ Pose(orientation=loop.orientation) @ other.inverse()
    return LoopJoint(loop.name, first, second, *points, loop.type, between.orientation)


def _rename_pairs(
    pairs: tuple[tuple[str, str], ...], hosts: dict[str, tuple[str, Pose]]
) -> tuple[tuple[str, str], ...]:
    renamed = ((hosts[first][0], hosts[second][0]) for first, second in pairs)
    return tuple(dict.fromkeys(pair for pair in renamed if pair[0] != pair[1]))
