"""A gripper as boxes around its links, in the end effector's frame, wide open: what may not be where the thing is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from orbit_assets.audit.robots.postures import gripper_posture, gripping_links, shapes_in_frame
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import Gripper, Link, RobotSpec

# m along the approach from the frame, within which fingers limit the opening.
_NEAR = 0.01


@dataclass(frozen=True, eq=False)
class HandBoxes:
    """Boxes (B, 2, 3), least and largest corner in m, and the opening (m) between fingers along the frame's y."""

    boxes: Tensor
    opening: float
    points: Tensor
    """(P, 3) m on the shapes themselves."""

    @staticmethod
    def of(spec: RobotSpec) -> HandBoxes:
        """Of a robot's first end effector.

        Raises:
            ConfigurationError: it has no gripper, or nothing of it is on both sides of its frame.
        """
        effector = spec.end_effectors[0] if spec.end_effectors else None
        if effector is None or effector.gripper is None:
            raise ConfigurationError(f"robot '{spec.name}' has no gripper to grasp with")
        posture = gripper_posture(spec, effector.gripper, effector.gripper.open_position)
        clouds = shapes_in_frame(spec, effector.frame, _hand_links(spec, effector.gripper), posture)
        boxes = [torch.tensor(np.stack((cloud.min(0), cloud.max(0))), dtype=torch.float32) for cloud in clouds]
        stacked = torch.stack(boxes) if boxes else torch.zeros(0, 2, 3)
        points = torch.tensor(np.concatenate(clouds or [np.zeros((0, 3))]), dtype=torch.float32)
        return HandBoxes(stacked, _opening(stacked, spec.name), points)

    def touches(self, points: Tensor, margin: float = 0.0) -> Tensor:
        """(...,) whether any of points (..., M, 3) in the end effector's frame is within ``margin`` m of a box."""
        low, high = self.boxes[:, 0] - margin, self.boxes[:, 1] + margin
        inside = (points[..., None, :] > low.to(points)) & (points[..., None, :] < high.to(points))
        return inside.all(-1).any(-1).any(-1)


def _hand_links(spec: RobotSpec, gripper: Gripper) -> list[Link]:
    """Those that the gripper moves, and those that carry them."""
    moving = {link.name for link in gripping_links(spec, gripper)}
    carriers = {joint.parent for joint in spec.articulation.joints if joint.child in moving}
    return [link for link in spec.articulation.links if link.name in moving | carriers]


def _opening(boxes: Tensor, name: str) -> float:
    near = (boxes[:, 0, 2] < _NEAR) & (boxes[:, 1, 2] > -_NEAR)
    left, right = near & (boxes[:, 0, 1] > 0.0), near & (boxes[:, 1, 1] < 0.0)
    if not left.any() or not right.any():
        raise ConfigurationError(f"the gripper of '{name}' has no finger on each side of its frame: it is not parallel")
    return float(boxes[left, 0, 1].min() - boxes[right, 1, 1].max())
