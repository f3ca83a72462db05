"""Tools that a robot holds for good: fixed in its hand, and where it holds them when an episode begins."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from orbit_assets.audit.robots.postures import gripper_posture
from orbit_assets.compose import attach
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_inverse, pose_multiply
from orbit_core.interfaces import ConfigurationError, match_names
from orbit_core.interfaces.layout import home_positions
from orbit_core.mdp import common
from orbit_core.scene import Articulation, Pose, RobotSpec
from orbit_motion.full_ik import FullIk, IkSolution


def with_tool(robot: RobotSpec, tool: Articulation, frame: str) -> RobotSpec:
    """The robot with a tool fixed in its hand, whose ``frame`` is what it moves; a gripper stays closed around it."""
    effector = robot.end_effector
    # The gripper stays closed around the tool and is no longer part of the action.
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
    solution, home = _postures(robot, pose[None])
    if not solution.converged.item():
        place = ", ".join(f"{value:.2f}" for value in pose[:3].tolist())
        raise ConfigurationError(
            f"robot '{robot.articulation.name}' cannot bring '{robot.end_effector.frame}' to ({place}) m, where its "
            "episodes begin: choose another robot"
        )
    names = robot.articulation.joint_names
    return replace(robot, home=dict(zip(names, home[0].tolist(), strict=True)))


def furthest(robot: RobotSpec, stations: Tensor, pose: Pose) -> Pose:
    """Return a pose of an upright thing that faces the robot at which the hand reaches all its stations.

    At ``pose``, or else nearer, by 2 cm each and 16 cm at most, to where the end effector reaches all ``stations``
    (K, 7) in the thing's frame; or to most of them. Places that are 2 cm and 0.1 rad off are asked about.
    """
    x, y, z = pose.position
    best, most = pose, -1
    for nearer in range(9):
        here = x - 0.02 * nearer
        corners = torch.tensor([(here - 0.02, y, z, 0.1), (here + 0.02, y, z, -0.1)])
        poses = pose_multiply(*torch.broadcast_tensors(common.standing(corners)[:, None], stations)).view(-1, 7)
        count = int(_postures(robot, poses)[0].converged.sum())
        best, most = (Pose((here, y, z)), count) if count > most else (best, most)
        if most == len(poses):
            break
    return best


def _postures(robot: RobotSpec, poses: Tensor) -> tuple[IkSolution, Tensor]:
    """Return the arm's solutions for end effector poses (K, 7), and positions (K, J) of all joints."""
    articulation, effector = robot.articulation, robot.end_effector
    home = torch.tensor(home_positions(robot), dtype=torch.float32).expand(len(poses), -1).clone()
    limits = torch.tensor([(joint.lower_limit, joint.upper_limit) for joint in articulation.movable_joints])
    joints = match_names(effector.arm_joints, articulation.joint_names, "joint", f"arm of robot '{robot.name}'")
    root = torch.tensor([(*robot.pose.position, *robot.pose.orientation)]).expand(len(poses), 7)
    solver = FullIk(KinematicTree(articulation), effector.frame, joints, limits, home[0])
    # On the CPU: a scene is made before there is a device.
    solution = solver.solve(pose_multiply(pose_inverse(root), poses.cpu()), home)
    home[:, joints] = solution.positions
    return solution, home
