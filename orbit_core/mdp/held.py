"""Tools that a robot holds for good: fixed in its hand, and where it holds them when an episode begins."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from orbit_core.assets.compose import attach
from orbit_core.audit.robots.postures import gripper_posture
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_inverse, pose_multiply
from orbit_core.interfaces import ConfigurationError, match_names
from orbit_core.interfaces.layout import home_positions
from orbit_core.motion.full_ik import FullIk
from orbit_core.scene import Articulation, RobotSpec


def with_tool(robot: RobotSpec, tool: Articulation, frame: str) -> RobotSpec:
    """The robot with a tool fixed in its hand, whose ``frame`` is what it moves; a gripper stays closed around it."""
    effector = robot.end_effector
    gripper = effector.gripper
    home = gripper_posture(robot, gripper, gripper.closed_position) if gripper else robot.home
    own = replace(effector, frame=frame, gripper=None, finger_tips=())
    body = attach(robot.articulation, tool, effector.frame)
    return replace(robot, articulation=body, home=home, end_effectors=(own, *robot.end_effectors[1:]))


def starting_at(robot: RobotSpec, pose: Tensor) -> RobotSpec:
    """The robot whose home has its end effector at ``pose`` (7,), in the environment's frame.

    Raises:
        ConfigurationError: it cannot reach there.
    """
    articulation, effector = robot.articulation, robot.end_effector
    names = articulation.joint_names
    home = torch.tensor(home_positions(robot), dtype=torch.float32)[None]
    limits = torch.tensor([(joint.lower_limit, joint.upper_limit) for joint in articulation.movable_joints])
    joints = match_names(effector.arm_joints, names, "joint", f"arm of robot '{robot.name}'")
    root = torch.tensor([(*robot.pose.position, *robot.pose.orientation)])
    solver = FullIk(KinematicTree(articulation), effector.frame, joints, limits, home[0])
    solution = solver.solve(pose_multiply(pose_inverse(root), pose[None].cpu()), home)
    if not solution.converged.item():
        place = ", ".join(f"{value:.2f}" for value in pose[:3].tolist())
        raise ConfigurationError(
            f"robot '{articulation.name}' cannot bring '{effector.frame}' to ({place}) m, where its episodes begin: "
            "choose another robot"
        )
    home[:, joints] = solution.positions
    return replace(robot, home=dict(zip(names, home[0].tolist(), strict=True)))
