"""Forward kinematics and mass matrix of one description in double precision, as a measuring stick.

:mod:`orbit_core.dynamics` computes the same in batches for control; this one shares no code with it, nor with a reader.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from orbit_core.scene import Articulation, Joint, JointType

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Posture:
    """A description at one set of joint positions, its root at the origin.

    ``links`` and ``frames`` hold poses (4, 4) by name, in the root's frame. ``axes`` and ``origins`` (3,) are those of
    each movable joint, in the root's frame too.
    """

    links: Mapping[str, FloatArray]
    frames: Mapping[str, FloatArray]
    axes: Mapping[str, FloatArray]
    origins: Mapping[str, FloatArray]


def posture(articulation: Articulation, positions: Mapping[str, float]) -> Posture:
    """Where everything is when the movable joints are at ``positions`` (m, rad; zero where not named).

    Followers stand where ``positions`` puts them, not where their leaders would. Links must be in topological order.
    """
    links = {articulation.root.name: np.eye(4)}
    axes: dict[str, FloatArray] = {}
    origins: dict[str, FloatArray] = {}
    for joint in articulation.joints:
        before = links[joint.parent] @ joint.parent_pose.matrix()
        links[joint.child] = before @ _motion(joint, positions.get(joint.name, 0.0)) @ _inverse(joint)
        if joint.movable:
            axes[joint.name] = before[:3, :3] @ np.asarray(joint.axis, dtype=float)
            origins[joint.name] = before[:3, 3]
    frames = {frame.name: links[frame.link] @ frame.pose.matrix() for frame in articulation.frames}
    return Posture(links, frames, axes, origins)


def mass_matrix(articulation: Articulation, at: Posture) -> FloatArray:
    """The mass matrix (J, J) of the movable joints, in their order, the root held and followers free; with armature.

    The sum over links of ``m Jv^T Jv + Jw^T R I R^T Jw`` (Siciliano et al., Robotics, 2009, eq. 7.32).
    """
    joints = articulation.movable_joints
    above = _ancestors(articulation)
    matrix = np.diag([float(joint.armature) for joint in joints])
    for link in articulation.links:
        pose = at.links[link.name]
        center = pose[:3, :3] @ np.asarray(link.center_of_mass) + pose[:3, 3]
        linear, angular = np.zeros((3, len(joints))), np.zeros((3, len(joints)))
        for index, joint in enumerate(joints):
            if joint.name not in above[link.name]:
                continue
            axis = at.axes[joint.name]
            if joint.type is JointType.PRISMATIC:
                linear[:, index] = axis
            else:
                linear[:, index] = np.cross(axis, center - at.origins[joint.name])
                angular[:, index] = axis
        turned = pose[:3, :3] @ link.inertia @ pose[:3, :3].T
        matrix += link.mass * linear.T @ linear + angular.T @ turned @ angular
    return matrix


def _ancestors(articulation: Articulation) -> dict[str, frozenset[str]]:
    """For each link the names of the movable joints between it and the root."""
    found = {articulation.root.name: frozenset[str]()}
    for joint in articulation.joints:
        own = frozenset([joint.name]) if joint.movable else frozenset[str]()
        found[joint.child] = found[joint.parent] | own
    return found


def _motion(joint: Joint, position: float) -> FloatArray:
    """What the joint does at a position (4, 4): a shift along its axis, or Rodrigues' rotation about it."""
    result = np.eye(4)
    axis = np.asarray(joint.axis, dtype=float)
    if joint.type is JointType.PRISMATIC:
        result[:3, 3] = position * axis
    elif joint.movable:
        x, y, z = axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        result[:3, :3] += np.sin(position) * cross + (1.0 - np.cos(position)) * cross @ cross
    return result


def _inverse(joint: Joint) -> FloatArray:
    return joint.child_pose.inverse().matrix()
