"""Find a home position for an arm: its end effector straight down before it, each joint far from its limits.

    python tools/home_pose.py ur5 --position 0.45 0.0 0.35

prints joint positions for the catalogue entry's ``home``. Several starts are tried; the one whose worst joint is
farthest from its limits wins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import torch
import tyro

from orbit_core.assets import robot
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_error
from orbit_core.interfaces.names import match_names

_ITERATIONS = 120
_DAMPING = 1e-3
_CENTRING = 0.05
_REACHED = 0.01


@dataclass(frozen=True)
class HomeSettings:
    """Find a home position for an arm, its end effector straight down before it."""

    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROBOT")]
    """Of a robot in the catalogue, or a composition."""
    position: tuple[float, float, float] = (0.45, 0.0, 0.35)
    """Of the end effector's frame in the root, m."""
    yaw: float = 0.0
    """Of the hand about the vertical, rad; at 0 its fingers open along the root's y."""
    starts: int = 64


def main(settings: HomeSettings) -> None:
    """Print the best position found, and how far off the end effector is there."""
    spec = robot(settings.name)
    effector, articulation = spec.end_effector, spec.articulation
    joints = articulation.movable_joints
    arm = match_names(effector.arm_joints, articulation.joint_names, "joint", spec.name)
    low, high = torch.tensor([(joints[i].lower_limit, joints[i].upper_limit) for i in arm]).T
    turning = (high - low) > 2 * torch.pi
    middle, reach = torch.where(turning, 0.0, (low + high) / 2), torch.where(turning, 2 * torch.pi, high - low)
    tree = KinematicTree(articulation)
    root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]).repeat(settings.starts, 1)
    # Half a turn about x has z down and y to the right; the yaw comes after it.
    half = settings.yaw / 2
    target = torch.tensor([[*settings.position, 0.0, math.cos(half), math.sin(half), 0.0]])
    torch.manual_seed(0)
    positions = torch.zeros(settings.starts, len(joints))
    positions[:, arm] = middle + (torch.rand(settings.starts, len(arm)) - 0.5) * reach
    error = torch.zeros(0)
    for _ in range(_ITERATIONS):
        links = tree.forward(root, positions)
        error = pose_error(tree.frame_pose(links, effector.frame), target)
        jacobian = tree.jacobian(links, effector.frame)[:, :, arm]
        normal = jacobian.mT @ jacobian + _DAMPING * torch.eye(len(arm))
        centre = _CENTRING * torch.where(turning, 0.0, middle - positions[:, arm])
        step = torch.linalg.solve(normal, (jacobian.mT @ error[..., None])[..., 0] + _DAMPING * centre)
        positions[:, arm] = torch.clamp(positions[:, arm] + step.clamp(-0.3, 0.3), low, high)
    turned = torch.remainder(positions[:, arm] + torch.pi, 2 * torch.pi) - torch.pi
    values = torch.where(turning, turned, positions[:, arm])
    margin = (0.5 - torch.where(turning, 0.0, (values - middle) / reach).abs()).min(1).values
    failed = error.abs().max(1).values > _REACHED
    best = int((margin - failed.float()).argmax())
    told = ", NOT REACHED" if failed[best] else ""
    print(f"worst joint {float(margin[best]):.0%} of its range from a limit{told}")
    print({articulation.joint_names[i]: round(float(v), 3) for i, v in zip(arm, values[best], strict=True)})


if __name__ == "__main__":
    main(tyro.cli(HomeSettings))
