"""How many reachable poses full inverse kinematics finds, for every arm of the catalogue.

    python benchmarks/full_ik.py --targets 1000

A target is the pose of the hand at joint positions drawn evenly within the arm's limits, or half a turn where there are
none. A search begins at home. It counts where the hand is within 1e-4 m and 1e-3 rad, by forward kinematics in float64,
with all joints within their limits. Prints a table in Markdown.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_assets.catalogue import robot, robot_names
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_error
from orbit_core.interfaces.layout import home_positions
from orbit_core.interfaces.names import match_names
from orbit_core.scene import EndEffector, RobotSpec
from orbit_motion.full_ik import FullIk

POSITION, ROTATION = 1e-4, 1e-3


@dataclass(frozen=True)
class Reached:
    """What a search came to."""

    joints: int
    rate: float
    """Share of the targets that were reached."""
    seconds: float


def reached(spec: RobotSpec, effector: EndEffector, targets: int, seed: int = 0) -> Reached:
    """How many of so many targets an arm reaches."""
    articulation = spec.articulation
    joints = match_names(effector.arm_joints, articulation.joint_names, "joint", spec.name)
    movable = articulation.movable_joints
    joints = [joint for joint in joints if movable[joint].mimic is None]
    limits = torch.tensor([(joint.lower_limit, joint.upper_limit) for joint in movable])
    home = torch.as_tensor(home_positions(spec), dtype=torch.float32)
    low, high = limits[joints].clamp(-torch.pi, torch.pi).unbind(1)
    drawn = torch.rand(targets, len(joints), generator=torch.Generator().manual_seed(seed))
    there = home.repeat(targets, 1)
    there[:, joints] = low + drawn * (high - low)
    exact = KinematicTree(articulation, dtype=torch.float64)
    poses = _hand(exact, effector.frame, there)
    solver = FullIk(KinematicTree(articulation), effector.frame, joints, limits, home)
    start = home.repeat(targets, 1)
    begin = time.process_time()
    found = start.clone()
    found[:, joints] = solver.solve(poses.float(), start).positions
    seconds = time.process_time() - begin
    error = pose_error(_hand(exact, effector.frame, found), poses)
    near = (error[:, :3].norm(dim=1) <= POSITION) & (error[:, 3:].norm(dim=1) <= ROTATION)
    inside = ((found >= limits[:, 0] - 1e-5) & (found <= limits[:, 1] + 1e-5))[:, joints].all(1)
    return Reached(len(joints), float((near & inside).float().mean()), seconds)


def _hand(tree: KinematicTree, frame: str, positions: Tensor) -> Tensor:
    """(N, 7) in the root."""
    root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], dtype=tree.dtype).repeat(len(positions), 1)
    return tree.frame_pose(tree.forward(root, positions.to(tree.dtype)), frame)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", type=int, default=1000)
    parser.add_argument("--only", nargs="*", help="names of robots")
    arguments = parser.parse_args()
    print("| robot | hand | joints | reached | ms a target |\n|---|---|---|---|---|")
    for name in arguments.only or robot_names():
        spec = robot(name)
        for effector in spec.end_effectors if spec.has_arm else ():
            if not effector.arm_joints:
                continue
            with torch.inference_mode():
                found = reached(spec, effector, arguments.targets)
            cost = 1e3 * found.seconds / arguments.targets
            row = (name, effector.frame, found.joints, f"{100 * found.rate:.1f} %", f"{cost:.2f}")
            print("| " + " | ".join(str(cell) for cell in row) + " |", flush=True)


if __name__ == "__main__":
    main()
