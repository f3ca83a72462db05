"""Workspaces that are computed for arms whose description gives none."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_assets import catalogue
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import quat_multiply
from orbit_core.envs import make
from orbit_core.interfaces import ConfigurationError
from orbit_core.interfaces.layout import home_positions
from orbit_core.mdp import common
from orbit_core.scene import (
    Articulation,
    EndEffector,
    Frame,
    ImplicitPd,
    Joint,
    JointCommands,
    JointType,
    Link,
    Pose,
    RobotSpec,
    Workspace,
)
from orbit_motion import workspace
from orbit_motion.full_ik import FullIk
from orbit_motion.workspace import fitted_workspace, with_workspace

UPPER, LOWER, HAND = 0.2, 0.2, 0.1


def five_joint_arm(turned: float = 0.0) -> RobotSpec:
    """Pan, shoulder, elbow, wrist and roll; at zero the arm stands straight up, at home its hand points down ahead."""
    lengths = {"pan": 0.0, "shoulder": 0.1, "elbow": UPPER, "wrist": LOWER, "roll": 0.5 * HAND}
    links = tuple(Link(name, 0.2, inertia=np.diag([1e-3] * 3)) for name in ("base", *lengths))
    joints = tuple(
        Joint(
            f"{child}_joint",
            JointType.REVOLUTE,
            parent.name,
            child,
            Pose((0.0, 0.0, length)),
            axis=(0.0, 0.0, 1.0) if child in ("pan", "roll") else (0.0, 1.0, 0.0),
            lower_limit=-6.0,
            upper_limit=6.0,
            effort_limit=50.0,
            velocity_limit=3.0,
            armature=0.05,
        )
        for parent, (child, length) in zip(links, lengths.items(), strict=False)
    )
    body = Articulation("five_joints", links, joints, (Frame("tip", "roll", Pose((0.0, 0.0, 0.5 * HAND))),))
    return RobotSpec(
        name="five_joints",
        articulation=body,
        pose=Pose.from_euler(0.0, 0.0, turned),
        fixed_base=True,
        home={"shoulder_joint": 0.4, "elbow_joint": 1.6, "wrist_joint": math.pi - 2.0, "roll_joint": math.pi},
        joint_commands=JointCommands(joints=(".*",), position_scale=2.0),
        actuators=(ImplicitPd(joints=(".*",), stiffness=200.0, damping=20.0),),
        gravity_compensation=True,
        end_effectors=(EndEffector("tip", (".*",)),),
    )


@pytest.fixture(scope="module")
def fitted() -> Workspace:
    return fitted_workspace(five_joint_arm())


def _missed(spec: RobotSpec, poses: torch.Tensor) -> int:
    """Number of poses (N, 7) in the root link that inverse kinematics with all its seeds does not reach."""
    body, home = spec.articulation, torch.as_tensor(home_positions(spec)).float()
    limits = torch.tensor([(joint.lower_limit, joint.upper_limit) for joint in body.movable_joints])
    solver = FullIk(KinematicTree(body), "tip", range(5), limits, home)
    return int((~solver.solve(poses, home.expand(len(poses), 5)).converged).sum())


def _poses(box: Workspace, count: int = 64) -> torch.Tensor:
    draws = torch.rand(count, 4, generator=torch.Generator().manual_seed(1))
    low, high = torch.tensor(box.low), torch.tensor(box.high)
    return torch.cat((low + draws[:, :3] * (high - low), common.facing_down(box.yaw * (2.0 * draws[:, 3] - 1.0))), 1)


def test_a_hand_of_five_joints_reaches_its_computed_workspace_upright_only(fitted: Workspace) -> None:
    assert (fitted.tilt, fitted.yaw) == (0.0, 1.0)
    assert fitted.low[2] > 0.0, "it keeps above the table"
    poses = _poses(fitted)
    assert _missed(five_joint_arm(), poses) == 0
    aside = torch.tensor([math.cos(0.15), math.sin(0.15), 0.0, 0.0]).expand(64, 4)
    tilted = torch.cat((poses[:, :3], quat_multiply(aside, poses[:, 3:])), 1)
    assert _missed(five_joint_arm(), tilted) > 32, "a hand of five joints does not tilt out of the arm's plane"


def test_a_computed_workspace_is_ahead_of_a_turned_robot_as_of_any(fitted: Workspace) -> None:
    turned = five_joint_arm(math.pi / 2)
    body = replace(turned, home={**turned.home, "pan_joint": -math.pi / 2})
    ahead = fitted_workspace(body).placed(body.pose)
    assert ahead.low[0] > 0.05
    assert _missed(five_joint_arm(), _poses(ahead)) == 0, (
        "the environment's axes are those of the robot that is not turned"
    )


def test_a_robot_that_faces_another_way_is_refused_with_the_remedy() -> None:
    near_home = JointCommands(joints=(".*",), position_scale=0.8)  # it does not lean over backwards
    away = replace(five_joint_arm(math.pi), joint_commands=near_home)
    with pytest.raises(ConfigurationError, match=r"'five_joints' has no workspace.*Turn the robot's pose"):
        fitted_workspace(away)


def test_a_workspace_that_is_given_is_kept() -> None:
    spec = catalogue.robot("franka_panda")
    assert with_workspace(spec) is spec
    assert spec.end_effector.workspace == Workspace()


def test_goals_are_drawn_where_the_arm_reaches_and_larger_tasks_refuse_it(
    monkeypatch: pytest.MonkeyPatch, fitted: Workspace
) -> None:
    computed = list[RobotSpec]()
    monkeypatch.setattr(workspace, "robot", lambda _, **fields: replace(five_joint_arm(), **fields))
    monkeypatch.setattr(workspace, "fitted_workspace", lambda spec: (computed.append(spec), fitted)[1])
    env = make("Reach", 8, "mujoco", robot="five_joints", seed=0)
    env.reset()
    assert len(computed) == 1
    assert _missed(five_joint_arm(), env.commands["goal"]) == 0
    env.close()
    with pytest.raises(ConfigurationError, match=r"this task needs .* choose a larger robot"):
        workspace.arm("five_joints", gripper=False, room=(1.0, 1.0, 1.0))
