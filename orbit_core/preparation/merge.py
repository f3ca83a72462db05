"""Merging of links that cannot move against each other: masses and inertias add up exactly."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Articulation, Frame, Joint, Link, LoopJoint, Pose, Shape
from orbit_core.scene.pose import Vector3

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass in kg, centre of mass in a frame, and inertia (3, 3) in kg m^2 about it in the frame's axes."""

    mass: float
    """kg."""
    center_of_mass: Vector3
    """m, in the frame."""
    inertia: FloatArray
    """(3, 3) kg m^2 about the centre of mass."""

    def placed(self, pose: Pose) -> MassProperties:
        """Return the same body seen from the frame in which its own frame has ``pose``."""
        rotation = pose.rotation_matrix()
        return MassProperties(
            self.mass, _vector(pose.transform(self.center_of_mass)), rotation @ self.inertia @ rotation.T
        )

    def about(self, point: npt.ArrayLike) -> FloatArray:
        """Return the inertia (3, 3) about another point of the same frame, by the parallel-axis theorem."""
        return self.inertia + _point_mass_inertia(self.mass, np.asarray(point) - np.asarray(self.center_of_mass))


def combine(bodies: Iterable[MassProperties]) -> MassProperties:
    """Return the mass properties of several bodies, given in one frame, that move as one.

    Raises:
        AssetError: the bodies have no mass.
    """
    parts = tuple(bodies)
    total = sum(part.mass for part in parts)
    if total <= 0:
        raise AssetError("a body without mass has no centre of mass: give at least one of its parts a mass")
    center = sum((part.mass * np.asarray(part.center_of_mass) for part in parts), np.zeros(3)) / total
    return MassProperties(total, _vector(center), sum((part.about(center) for part in parts), np.zeros((3, 3))))


def merge_fixed_links(articulation: Articulation) -> Articulation:
    """Return the same mechanism without fixed joints.

    Masses, centres of mass and inertias add up exactly (parallel-axis theorem). Each merged link leaves a
    :class:`Frame` of its name; shapes, frames, joints and collision exclusions move to the link that took it in, which
    keeps its own semantic label. Links must be in topological order.
    """
    # Most articulations were merged by their reader; they are returned unchanged.
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
    """Return for each link the link that it is merged into, and its pose there."""
    hosts: dict[str, tuple[str, Pose]] = {}
    joint_of = {joint.child: joint for joint in articulation.joints}
    for link in articulation.links:
        joint = joint_of.get(link.name)
        if joint is None or joint.movable:
            hosts[link.name] = (link.name, Pose())
        else:
            # Parents come first in topological order, so that their host is known.
            host, pose = hosts[joint.parent]
            hosts[link.name] = (host, pose @ joint.parent_pose @ joint.child_pose.inverse())
    return hosts


def _combine(members: list[tuple[Link, Pose]]) -> Link:
    host = members[0][0]
    if len(members) == 1:
        return host
    bodies = [MassProperties(link.mass, link.center_of_mass, link.inertia).placed(pose) for link, pose in members]
    # A chain of fixed frames without mass stays without mass.
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
    # Exclusions within one merged link have no meaning any more.
    return tuple(dict.fromkeys(pair for pair in renamed if pair[0] != pair[1]))


def _point_mass_inertia(mass: float, offset: FloatArray) -> FloatArray:
    return mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))


def _vector(values: npt.ArrayLike) -> Vector3:
    x, y, z = (float(value) for value in np.asarray(values))
    return (x, y, z)
