"""What devices drive besides a single arm: hands of many fingers, wheels, and several end effectors of one robot."""

from __future__ import annotations

import pytest
import torch

from orbit_core.actions import ActionTerms, BinaryGripperConfig, DifferentialIkConfig, JointPositionConfig
from orbit_core.backends import default_backend
from orbit_core.envs import make
from orbit_data.teleoperation.device import Event, Reading
from orbit_data.teleoperation.driver import Driver
from orbit_motion.synergies import GraspSynergiesConfig

BACKEND = default_backend()
UP = Reading(twist=(0.0, 0.0, 0.2, 0.0, 0.0, 0.0))
NEXT, GRIP = Reading(events=(Event.NEXT,)), Reading(events=(Event.GRIPPER,))
STILL = Reading()


@pytest.mark.parametrize("action", ["grasp_synergies", "joint_position", "joint_velocity", "joint_impedance"])
def test_a_hand_without_arm_holds_then_closes_and_opens(action: str) -> None:
    environment = make("In-Hand-Repose", 1, BACKEND, action=action)
    driver = Driver(environment)
    driver.restart()
    hand = driver.hand
    assert hand is not None
    begin = hand.robot.joint_positions.clone()
    for _ in range(5):
        environment.step(driver.act(UP))
    assert (hand.robot.joint_positions - begin).abs().max() < 0.15  # a posture between open and closed
    away = {}
    for opened in (False, True):
        environment.step(driver.act(GRIP))
        assert hand.gripper_open is opened
        wanted = hand.grip()
        for _ in range(15):
            environment.step(driver.act(STILL))
        away[opened] = float((hand.robot.joint_positions[:, hand.fingers] - wanted).abs().max())
    assert away[True] < 0.1
    assert away[False] < 0.6  # on the cube that it holds
    environment.close()


def test_fingers_follow_joint_values_by_their_synergies() -> None:
    environment = make("In-Hand-Repose", 1, BACKEND, action="grasp_synergies")
    driver = Driver(environment)
    driver.restart()
    hand = driver.hand
    assert hand is not None
    hand.gripper_open = False
    closed, names = hand.grip()[0].tolist(), [hand.robot.joint_names[joint] for joint in hand.fingers]
    command = driver.act(Reading(joints=dict(zip(names, closed, strict=True))))
    assert command[0, 0] == pytest.approx(-1.0, abs=0.01)
    environment.close()


def test_a_base_on_two_wheels_takes_the_arm_along() -> None:
    environment = make("Reach", 1, BACKEND, robot="tiago", action="ik_relative", episode_length=20.0)
    driver = Driver(environment)
    driver.restart()
    assert driver.choices == ("robot",)
    hand = driver.hand
    assert hand is not None
    base = hand.robot.spec.base_link
    at, begin = hand.robot.frame_pose(base).clone(), hand.measured
    for _ in range(50):
        environment.step(driver.act(Reading(base=(0.5, 0.0, 0.0))))
    driven = (hand.robot.frame_pose(base) - at)[0, :3]
    carried = (hand.measured - begin)[0, :3]
    assert driven[0] > 0.3
    torch.testing.assert_close(carried, driven, atol=0.05, rtol=0.0)
    before = hand.robot.frame_pose(base)[0, 6].clone()
    for _ in range(25):
        environment.step(driver.act(Reading(twist=UP.twist, base=(0.0, 0.0, 1.0))))
    assert hand.robot.frame_pose(base)[0, 6] > before + 0.03
    assert hand.measured[0, 2] > begin[0, 2] + 0.04
    environment.close()


def test_next_goes_through_the_end_effectors_of_one_robot() -> None:
    left, right = "dex3_left_tcp", "dex3_right_tcp"
    actions = ActionTerms(
        left=DifferentialIkConfig(frame=left),
        right=DifferentialIkConfig(frame=right),
        left_hand=GraspSynergiesConfig(frame=left),
        right_hand=BinaryGripperConfig(frame=right),
    )
    environment = make("Reach", 1, BACKEND, robot="unitree_g1_dex3", actions=actions)
    driver = Driver(environment)
    assert driver.choices == (f"robot {left}", f"robot {right}")
    for name in driver.choices:
        environment.reset()
        driver.restart()
        assert driver.active == name
        other = next(hand for each, hand in driver.hands.items() if each != name)
        hand = driver.hands[name]
        begin = hand.measured[0, 2].item(), other.measured[0, 2].item()
        for _ in range(20):
            environment.step(driver.act(UP))
        assert hand.measured[0, 2] > begin[0] + 0.03
        assert abs(other.measured[0, 2] - begin[1]) < 0.02
        command = driver.act(GRIP)
        assert (hand.gripper_open, other.gripper_open) == (False, True)
        assert command[0, 12:].sign().tolist() == ([-1.0, 1.0] if left in name else [1.0, -1.0])
        driver.act(NEXT)
    environment.close()


def test_one_generator_moves_both_arms_of_a_humanoid() -> None:
    actions = ActionTerms(body=JointPositionConfig(scale=None))
    rises: list[dict[str, float]] = []
    environment = make("Reach", 1, BACKEND, robot="unitree_g1", actions=actions)
    driver = Driver(environment)
    for _ in driver.choices:
        environment.reset(0)
        driver.restart()
        begin = {name: hand.measured[0, 2].item() for name, hand in driver.hands.items()}
        for _ in range(20):
            environment.step(driver.act(UP))
        rises.append({name: hand.measured[0, 2].item() - begin[name] for name, hand in driver.hands.items()})
        driver.act(NEXT)
    for name in driver.choices:
        asked, other = (rise[name] for rise in (rises if name == driver.choices[0] else rises[::-1]))
        assert asked > other + 0.04  # a walker that no policy holds begins to fall, and its arms with it
    environment.close()


def test_an_end_effector_that_the_action_does_not_move_is_not_driven() -> None:
    actions = ActionTerms(right=DifferentialIkConfig(frame="right_rubber_hand"))
    environment = make("Reach", 1, BACKEND, robot="unitree_g1", actions=actions)
    driver = Driver(environment)
    assert driver.choices == ("robot",)
    assert driver.hand is not None
    assert driver.hand.frame == "right_rubber_hand"
    environment.close()
