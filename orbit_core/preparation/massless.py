"""Which links may have no mass: those between joints that together still move a link with mass in independent ways."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Articulation, Joint, JointType, Pose

_ELSEWHERE = (0.3, -0.5, 0.7, 0.4, -0.6, 0.2)
"""Positions, in rad or m, at which a chain's joints are tried: angles that are singular at zero may be sound there."""
_DEPENDENT = 1e-6
"""Share of the largest singular value of the joints' unit motions below which they are dependent."""


def check_massless(articulation: Articulation) -> None:
    """Hold the moving links without mass to what can be simulated. There must be no fixed joints.

    Such a link has no inertia and collides with nothing, it carries links with mass, and the joints on the way to the
    next of these, those with armature left out, move it in independent ways: otherwise some effort would meet no
    inertia at all.

    Raises:
        AssetError: names the link or the joints.
    """
    joint_of = {joint.child: joint for joint in articulation.joints}
    carried = {joint.parent for joint in articulation.joints}
    massless = {link.name for link in articulation.links[1:] if link.mass == 0}
    for link in articulation.links[1:]:
        if link.name in massless:
            if link.name not in carried:
                raise _error(
                    articulation, link.name, "moves but has no mass: give it mass and inertia, or fix its joint"
                )
            if np.any(link.inertia):
                raise _error(articulation, link.name, "has an inertia but no mass: give it mass")
            if link.collisions:
                raise _error(articulation, link.name, "collides but has no mass: give it mass and inertia")
        elif link.name in joint_of and joint_of[link.name].parent in massless:
            _check_independent(articulation, _chain(link.name, joint_of, massless))


def _chain(link: str, joint_of: dict[str, Joint], massless: set[str]) -> list[Joint]:
    """The joints from the last link with mass, or the root, to ``link``, the outermost first."""
    joints = [joint_of[link]]
    while joints[-1].parent in massless:
        joints.append(joint_of[joints[-1].parent])
    return joints[::-1]


def _check_independent(articulation: Articulation, joints: list[Joint]) -> None:
    free = [joint.armature == 0 for joint in joints]
    if not any(free):
        return
    motions = _unit_motions(joints)[:, free]
    values = np.linalg.svd(motions, compute_uv=False)
    if motions.shape[1] > 6 or values[-1] < _DEPENDENT * values[0]:
        names = ", ".join(f"'{joint.name}'" for joint, each in zip(joints, free, strict=True) if each)
        raise AssetError(
            f"'{articulation.name}': joints {names} move link '{joints[-1].child}' in the same way, with no mass "
            "between them: give the links between them mass, or one of the joints armature"
        )


def _unit_motions(joints: list[Joint]) -> npt.NDArray[np.float64]:
    """(6, k) velocity and angular velocity that each joint gives the last link, each column of length one."""
    pose = Pose()
    columns: list[npt.NDArray[np.float64]] = []
    for number, joint in enumerate(joints):
        pose = pose @ joint.parent_pose
        axis = pose.rotation_matrix() @ np.asarray(joint.axis)
        position = _ELSEWHERE[number % len(_ELSEWHERE)]
        if joint.type is JointType.PRISMATIC:
            column = np.concatenate((axis, np.zeros(3)))
            moved = Pose((position * joint.axis[0], position * joint.axis[1], position * joint.axis[2]))
        else:
            column = np.concatenate((np.cross(pose.position, axis), axis))
            moved = Pose.from_axis_angle(joint.axis, position)
        columns.append(column / np.linalg.norm(column))
        pose = pose @ moved @ joint.child_pose.inverse()
    return np.stack(columns, axis=1)


def _error(articulation: Articulation, link: str, fault: str) -> AssetError:
    return AssetError(f"'{articulation.name}': link '{link}' {fault}")
