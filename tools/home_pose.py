"""Find a home position for an arm: its end effector straight down before it, each joint far from its limits.

    python tools/home_pose.py ur5 --position 0.45 0.0 0.35

prints joint positions for the catalogue entry's ``home``. Several starts are tried; the one whose worst joint is
farthest from its limits wins.
"""

from __future__ import annotations

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
    starts: int = 32


def main(settings: HomeSettings) -> None:
    """Print the best position found, and how far off the end effector is there."""
    spec = robot(settings.name)
    effector, articulation = spec.end_effector, spec.articulation
    joints = articulation.movable_joints
    arm = match_names(effector.arm_joints, articulation.joint_names, "joint", spec.name)
    low, high = torch.tensor(
        [(max(joints[i].lower_limit, -torch.pi), min(joints[i].upper_limit, torch.pi)) for i in arm]
    ).T
    tree = KinematicTree(articulation)
    root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]).repeat(settings.starts, 1)
    target = torch.tensor([[*settings.position, 0.0, 1.0, 0.0, 0.0]])  # half a turn about x: z down, y to the right
    torch.manual_seed(0)
    positions = torch.zeros(settings.starts, len(joints))
    positions[:, arm] = low + torch.rand(settings.starts, len(arm)) * (high - low)
    error = torch.zeros(0)
    for _ in range(_ITERATIONS):
        links = tree.forward(root, positions)
        error = pose_error(tree.frame_pose(links, effector.frame), target)
        jacobian = tree.jacobian(links, effector.frame)[:, :, arm]
        normal = jacobian.mT @ jacobian + _DAMPING * torch.eye(len(arm))
        centre = _CENTRING * ((low + high) / 2 - positions[:, arm])
        step = torch.linalg.solve(normal, (jacobian.mT @ error[..., None])[..., 0] + _DAMPING * centre)
        positions[:, arm] = torch.clamp(positions[:, arm] + step.clamp(-0.3, 0.3), low, high)
    values = positions[:, arm]
    margin = torch.minimum((values - low) / (high - low), (high - values) / (high - low)).min(1).values
    failed = error.abs().max(1).values > _REACHED
    best = int((margin - failed.float()).argmax())
    told = ", NOT REACHED" if failed[best] else ""
    print(f"worst joint {float(margin[best]):.0%} of its range from a limit{told}")
    print({articulation.joint_names[i]: round(float(v), 3) for i, v in zip(arm, values[best], strict=True)})


if __name__ == "__main__":
    main(tyro.cli(HomeSettings))
