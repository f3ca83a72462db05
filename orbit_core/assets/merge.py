"""Fixed joints removed: every link that cannot move against its parent becomes part of it, exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from orbit_core.scene import Articulation, Frame, Joint, Link, Pose, Shape


def merge_fixed_links(articulation: Articulation) -> Articulation:
    """The same mechanism without fixed joints.

    Masses, centres of mass and inertias add up exactly (parallel-axis theorem). Each merged link leaves a
    :class:`Frame` of its name; shapes, frames, joints and collision exclusions move to the link that took it in, which
    keeps its own semantic label. Links must be in topological order.
    """
    if all(joint.movable for joint in articulation.joints):
        return articulation
    hosts = _hosts(articulation)
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
    )


def combine_inertia(
    bodies: list[tuple[float, npt.NDArray[np.float64], npt.NDArray[np.float64]]],
) -> tuple[float, npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Mass (kg), centre of mass (3,) and inertia (3, 3) about it of bodies given the same way, all in the same axes."""
    mass = sum(body[0] for body in bodies)
    if mass == 0:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    center = sum((m * c for m, c, _ in bodies), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for m, c, own in bodies:
        d = c - center
        inertia += own + m * (d @ d * np.eye(3) - np.outer(d, d))
    return mass, center, inertia


def _hosts(articulation: Articulation) -> dict[str, tuple[str, Pose]]:
    """For each link the link that it ends up in, and its pose there."""
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
    bodies = []
    for link, pose in members:
        rotation = pose.rotation_matrix()
        bodies.append((link.mass, pose.transform(link.center_of_mass), rotation @ link.inertia @ rotation.T))
    mass, center, inertia = combine_inertia(bodies)
    x, y, z = (float(value) for value in center)
    return replace(
        host,
        mass=mass,
        center_of_mass=(x, y, z),
        inertia=inertia,
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


def _rename_pairs(
    pairs: tuple[tuple[str, str], ...], hosts: dict[str, tuple[str, Pose]]
) -> tuple[tuple[str, str], ...]:
    renamed = ((hosts[first][0], hosts[second][0]) for first, second in pairs)
    return tuple(dict.fromkeys(pair for pair in renamed if pair[0] != pair[1]))
