"""One command moves every joint of a gripper to its own end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch

from orbit_assets.catalogue import robot as catalogue_robot
from orbit_core.actions import BinaryGripperConfig, DifferentialIkConfig, JointTarget, joint_commands
from orbit_core.configuration import Text, configured
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.preparation.validation import validate_entity
from orbit_core.scene import EndEffector, Gripper

MakeRobot = Callable[..., Any]
OPEN, CLOSE = torch.tensor([[1.0]]), torch.tensor([[-1.0]])


def positions(robot: Any, config: BinaryGripperConfig, command: torch.Tensor) -> dict[str, float]:
    generator = config.build("gripper", robot)
    targets = generator.compute({"command": command})[JointTarget.POSITION][0]
    names = [robot.joint_names[joint] for joint in generator.joints]
    return dict(zip(names, targets.tolist(), strict=True))


def test_each_joint_has_its_own_position_whatever_the_order_of_the_names(kinematic_robot: MakeRobot) -> None:
    config = BinaryGripperConfig(
        joints=("panda_joint7", "panda_joint2"), open_position=(0.7, 0.2), closed_position=(-0.7, -0.2)
    )
    robot = kinematic_robot(num_envs=1)
    assert positions(robot, config, OPEN) == pytest.approx({"panda_joint2": 0.2, "panda_joint7": 0.7})
    assert positions(robot, config, CLOSE) == pytest.approx({"panda_joint2": -0.2, "panda_joint7": -0.7})


def test_a_pattern_gives_its_position_to_all_joints_that_it_matches(kinematic_robot: MakeRobot) -> None:
    config = BinaryGripperConfig(
        joints=("panda_joint[12]", "panda_joint5"), open_position=(0.1, 0.5), closed_position=0
    )
    expected = {"panda_joint1": 0.1, "panda_joint2": 0.1, "panda_joint5": 0.5}
    assert positions(kinematic_robot(num_envs=1), config, OPEN) == pytest.approx(expected)


def test_the_robots_own_gripper_may_have_a_position_for_each_joint(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot(num_envs=1)
    effector = replace(
        robot.spec.end_effector, gripper=Gripper(("panda_joint6", "panda_joint5"), (0.6, 0.5), (0.0, -0.5))
    )
    robot._spec = replace(robot.spec, end_effectors=(effector,))
    assert positions(robot, BinaryGripperConfig(), OPEN) == pytest.approx({"panda_joint5": 0.5, "panda_joint6": 0.6})
    assert positions(robot, BinaryGripperConfig(), CLOSE) == pytest.approx({"panda_joint5": -0.5, "panda_joint6": 0.0})


def test_positions_of_another_number_than_the_joints_are_refused(kinematic_robot: MakeRobot) -> None:
    with pytest.raises(ValueError, match="closed_position of a gripper has 1 positions for 2 entries"):
        Gripper(("a", "b"), (0.0, 0.0), (1.0,))
    config = BinaryGripperConfig(joints=("panda_joint1",), open_position=(0.1, 0.2), closed_position=0.0)
    with pytest.raises(ConfigurationError, match="'gripper' has 2 positions for 1 entries"):
        config.build("gripper", kinematic_robot())


def test_positions_can_be_set_as_text() -> None:
    config = configured(BinaryGripperConfig(), {"open_position": Text("0.1,0.2"), "closed_position": Text("0.5")}, "it")
    assert (config.open_position, config.closed_position) == ((0.1, 0.2), 0.5)


def test_a_gripper_of_unknown_joints_is_named() -> None:
    panda = catalogue_robot("franka_panda")
    effector = replace(panda.end_effector, gripper=Gripper(("panda_finger",), 0.0, 1.0))
    with pytest.raises(UnknownNameError, match="panda_finger"):
        validate_entity(replace(panda, end_effectors=(effector,)))


def test_an_end_effector_without_an_arm_is_moved_by_its_own_joints_and_by_no_inverse_kinematics() -> None:
    panda = catalogue_robot("franka_panda")
    hand = replace(panda, end_effectors=(EndEffector("panda_hand_tcp", (), panda.end_effector.gripper),))
    assert not hand.has_arm
    assert len(joint_commands(hand).joints) == 8
    with pytest.raises(ConfigurationError, match="has no arm that moves its end effector: mount it on one"):
        DifferentialIkConfig().joint_indices(hand, "ik")
