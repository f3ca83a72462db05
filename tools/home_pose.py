"""Find a home position for an arm, and see how much of its workspace it reaches from there.

    python tools/home_pose.py jaco2 --low 0.3 -0.2 0.15 --high 0.5 0.2 0.4

prints joint positions for the catalogue entry's ``home``: the hand points straight down at the middle of the workspace,
its fingers open along y. Of several such positions it takes the one from which the arm reaches the most random poses of
the workspace with no joint further than 2 rad from home, which is what actions command.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
import tyro
from torch import Tensor

from orbit_assets.catalogue import robot
from orbit_core.dynamics.kinematics import KinematicTree, joint_ancestry
from orbit_core.dynamics.transforms import quat_from_euler, quat_multiply
from orbit_core.interfaces.layout import home_positions
from orbit_core.interfaces.names import match_names
from orbit_motion.full_ik import FullIk, FullIkConfig
from orbit_motion.workspace import fitted_workspace

_COMMANDED = 2.0
"""rad from home that actions reach."""
_TILT, _YAW = 0.3, 1.0
"""rad to either side, of a workspace's poses."""
_CLEARANCE = 0.05
"""m that every moving link's origin is above what the robot stands on, at the height that it is placed in a scene."""


@dataclass(frozen=True)
class HomeSettings:
    """Find a home position for an arm, and see how much of its workspace it reaches from there."""

    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROBOT")]
    """Of a robot in the catalogue, or a composition."""
    low: tuple[float, float, float] | None = None
    """Corner of the workspace in the root link, m; the catalogue's where left out."""
    high: tuple[float, float, float] | None = None
    candidates: int = 48
    poses: int = 128


class Arm:
    """A robot's first end effector and the joints that move it."""

    def __init__(self, name: str) -> None:
        spec = robot(name)
        self.effector, self.articulation = spec.end_effector, spec.articulation
        self.floor = -spec.pose.position[2]
        self.tree = KinematicTree(self.articulation)
        self.joints = match_names(self.effector.arm_joints, self.articulation.joint_names, "joint", name)
        joints = self.articulation.movable_joints
        self.limits = torch.tensor([(joint.lower_limit, joint.upper_limit) for joint in joints])
        self.home = torch.as_tensor(home_positions(spec), dtype=torch.float32)

    def reached(self, home: Tensor, poses: Tensor, near_home: bool) -> Tensor:
        """(M,) which of the poses (M, 7) are reached from the home position (J,)."""
        limits = self.limits
        if near_home:
            limits = torch.stack(
                (limits[:, 0].maximum(home - _COMMANDED), limits[:, 1].minimum(home + _COMMANDED)), dim=1
            )
        solver = FullIk(self.tree, self.effector.frame, self.joints, limits, home, FullIkConfig(seeds=8))
        return solver.solve(poses, home.repeat(len(poses), 1)).converged

    def homes(self, pose: Tensor, count: int) -> Tensor:
        """(M, J) positions that hold the hand at ``pose`` (7,), from as many random starts."""
        starts = self.home.repeat(count, 1)
        low, high = self.limits[self.joints].clamp(-torch.pi, torch.pi).unbind(1)
        starts[:, self.joints] = low + torch.rand(count, len(self.joints)) * (high - low)
        config = FullIkConfig(seeds=1, iterations=120)
        solver = FullIk(self.tree, self.effector.frame, self.joints, self.limits, self.home, config)
        solution = solver.solve(pose.repeat(count, 1), starts)
        starts[:, self.joints] = solution.positions
        root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]).repeat(count, 1)
        moved = [link for link, moves in enumerate(joint_ancestry(self.articulation)) if moves.any()]
        heights = self.tree.forward(root, starts)[:, moved, 2].amin(1)
        return starts[solution.converged & (heights > self.floor + _CLEARANCE)]

    def margin(self, homes: Tensor) -> Tensor:
        """(M,) of the joint that is nearest to a limit, as a share of its range; joints that turn on have half."""
        low, high = self.limits[self.joints].unbind(1)
        values, middle = homes[:, self.joints], (low + high) / 2
        return (0.5 - torch.where((high - low).isfinite(), (values - middle).abs() / (high - low), 0.0)).min(1).values


def main(settings: HomeSettings) -> None:
    """Print the best position found, and what it reaches."""
    torch.manual_seed(0)
    arm = Arm(settings.name)
    workspace = arm.effector.workspace or fitted_workspace(robot(settings.name))
    low, high = torch.tensor(settings.low or workspace.low), torch.tensor(settings.high or workspace.high)
    poses = _poses(low, high, settings.poses)
    print(f"the entry's home: {_told(arm, arm.home, poses)}")
    middle = torch.tensor([*((low + high) / 2).tolist(), 0.0, 1.0, 0.0, 0.0])  # half a turn about x: z down
    homes = arm.homes(middle, settings.candidates)
    if not len(homes):
        raise SystemExit("the hand cannot point straight down at the middle of the workspace: move the box")
    best = homes[arm.margin(homes).argsort(descending=True)[:8]]
    shares = [arm.reached(home, poses, near_home=True).float().mean() for home in best]
    home = best[int(torch.stack(shares).argmax())]
    print(f"the best found:   {_told(arm, home, poses)}")
    print({arm.articulation.joint_names[joint]: round(float(home[joint]), 3) for joint in arm.joints})


def _told(arm: Arm, home: Tensor, poses: Tensor) -> str:
    within, near = (arm.reached(home, poses, near).float().mean() for near in (False, True))
    margin = arm.margin(home[None])[0]
    return f"reaches {within:.0%} of the workspace, {near:.0%} as actions do; worst joint {margin:.0%} from a limit"


def _poses(low: Tensor, high: Tensor, count: int) -> Tensor:
    """(M, 7) random ones of the workspace."""
    position = low + torch.rand(count, 3) * (high - low)
    roll, pitch = (_TILT * (2 * torch.rand(count) - 1) for _ in range(2))
    half = 0.5 * _YAW * (2 * torch.rand(count) - 1)
    zero = torch.zeros(count)
    down = torch.stack((zero, half.cos(), half.sin(), zero), 1)
    return torch.cat((position, quat_multiply(quat_from_euler(roll, pitch, zero), down)), 1)


if __name__ == "__main__":
    main(tyro.cli(HomeSettings))
