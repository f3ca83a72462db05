"""A gripper as boxes around its links, in the end effector's frame, wide open: what may not be where the thing is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from orbit_core.audit.robots.postures import gripper_posture
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_inverse, pose_multiply, transform_points
from orbit_core.dynamics.tree import joint_ancestry
from orbit_core.interfaces import ConfigurationError
from orbit_core.interfaces.names import match_names
from orbit_core.motion.grasping.surface import surface_of
from orbit_core.scene import Gripper, Link, RobotSpec, Shape

_POINTS = 300
_NEAR = 0.01
"""m along the approach from the frame, within which fingers limit the opening."""


@dataclass(frozen=True, eq=False)
class HandBoxes:
    """Boxes (B, 2, 3), least and largest corner in m, and the opening (m) between fingers along the frame's y."""

    boxes: Tensor
    opening: float

    @staticmethod
    def of(spec: RobotSpec) -> HandBoxes:
        """Of a robot's first end effector.

        Raises:
            ConfigurationError: it has no gripper, or nothing of it is on both sides of its frame.
        """
        articulation = spec.articulation
        effector = spec.end_effectors[0] if spec.end_effectors else None
        if effector is None or effector.gripper is None:
            raise ConfigurationError(f"robot '{spec.name}' has no gripper to grasp with")
        posture = gripper_posture(spec, effector.gripper, effector.gripper.open_position)
        positions = torch.tensor([posture[name] for name in articulation.joint_names])
        tree = KinematicTree(articulation, torch.device("cpu"))
        root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
        links = tree.forward(root, positions[None])
        into = pose_inverse(tree.frame_pose(links, effector.frame))
        boxes = [
            _box_of(pose[0], articulation.links[number], shape)
            for number in _hand_links(spec, effector.gripper)
            for pose in (pose_multiply(into, links[:, number]),)
            for shape in articulation.links[number].collisions
        ]
        stacked = torch.stack(boxes) if boxes else torch.zeros(0, 2, 3)
        return HandBoxes(stacked, _opening(stacked, spec.name))

    def touches(self, points: Tensor, margin: float = 0.0) -> Tensor:
        """(...,) whether any of points (..., M, 3) in the end effector's frame is within ``margin`` m of a box."""
        low, high = self.boxes[:, 0] - margin, self.boxes[:, 1] + margin
        inside = (points[..., None, :] > low.to(points)) & (points[..., None, :] < high.to(points))
        return inside.all(-1).any(-1).any(-1)


def _hand_links(spec: RobotSpec, gripper: Gripper) -> list[int]:
    """Those that the gripper's joints and their followers move, and those that carry them."""
    articulation = spec.articulation
    names = articulation.joint_names
    leaders = {names[column] for column in match_names(gripper.joints, names, "joint", spec.name)}
    columns = [
        column
        for column, joint in enumerate(articulation.movable_joints)
        if joint.name in leaders or (joint.mimic is not None and joint.mimic.joint in leaders)
    ]
    moved = joint_ancestry(articulation)[:, columns].any(axis=1)
    parents = {articulation.movable_joints[column].parent for column in columns}
    carriers = {articulation.link_names.index(name) for name in parents}
    return sorted({int(number) for number in np.flatnonzero(moved)} | carriers)


def _box_of(pose: Tensor, link: Link, shape: Shape) -> Tensor:
    """(2, 3) least and largest corner of one of a link's collision shapes, with the link at a pose (7,)."""
    points = surface_of(replace(link, collisions=(shape,)), _POINTS).points
    placed = transform_points(pose[None], points[None])[0]
    return torch.stack((placed.amin(0), placed.amax(0)))


def _opening(boxes: Tensor, name: str) -> float:
    near = (boxes[:, 0, 2] < _NEAR) & (boxes[:, 1, 2] > -_NEAR)
    left, right = near & (boxes[:, 0, 1] > 0.0), near & (boxes[:, 1, 1] < 0.0)
    if not left.any() or not right.any():
        raise ConfigurationError(f"the gripper of '{name}' has no finger on each side of its frame: it is not parallel")
    return float(boxes[left, 0, 1].min() - boxes[right, 1, 1].max())
