"""Where the links of a description are at given positions of its joints."""

from __future__ import annotations

from collections.abc import Mapping

from orbit_core.scene import Articulation, Joint, JointType, Pose


def link_poses(articulation: Articulation, positions: Mapping[str, float]) -> dict[str, Pose]:
    """The pose of each link by name, in the root link's frame.

    ``positions`` are rad or m by joint, zero where not named; followers stand where it puts them, not where their
    leaders would. Links must be in topological order.
    """
    poses = {articulation.root.name: Pose()}
    for joint in articulation.joints:
        moved = _motion(joint, positions.get(joint.name, 0.0))
        poses[joint.child] = poses[joint.parent] @ joint.parent_pose @ moved @ joint.child_pose.inverse()
    return poses


def _motion(joint: Joint, position: float) -> Pose:
    if joint.type is JointType.PRISMATIC:
        x, y, z = joint.axis
        return Pose((position * x, position * y, position * z))
    return Pose.from_axis_angle(joint.axis, position) if joint.movable else Pose()
