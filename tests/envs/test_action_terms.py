"""Actions are composed of terms: any robots, joints and motion generators, and every clash is named beforehand."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
import torch

from orbit_assets.catalogue import robot as catalogue_robot
from orbit_assets.compose import attach
from orbit_core.actions import (
    ActionTerms,
    BaseVelocityConfig,
    BinaryGripperConfig,
    DifferentialIkConfig,
    JointEffortConfig,
    JointPositionConfig,
    JointVelocityConfig,
)
from orbit_core.backends import default_backend
from orbit_core.envs import Environment, make
from orbit_core.envs.configuration import configure
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.scene import (
    Articulation,
    EndEffector,
    Gripper,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    PlanarBase,
    Pose,
    RobotSpec,
    Scene,
)
from orbit_tasks.handover import GIVER, RECEIVER, Handover
from orbit_tasks.lift import Lift
from orbit_tasks.reach import Reach

BACKEND = default_backend()
ARM = ("panda_joint[1-7]",)
FINGER = "panda_finger_joint1"


def mobile_panda(name: str = "robot") -> RobotSpec:
    """A Franka Panda on a platform that three joints without wheels carry over the floor."""
    arm = catalogue_robot("franka_panda")
    links = (
        Link("ground"),
        Link("slide", 5.0, inertia=np.eye(3)),
        Link("carriage", 5.0, inertia=np.eye(3)),
        Link("platform", 40.0, inertia=2.0 * np.eye(3)),
    )
    joints = (
        Joint("base_x", JointType.PRISMATIC, "ground", "slide", axis=(1.0, 0.0, 0.0)),
        Joint("base_y", JointType.PRISMATIC, "slide", "carriage", axis=(0.0, 1.0, 0.0)),
        Joint("base_yaw", JointType.CONTINUOUS, "carriage", "platform"),
    )
    base = Articulation("mobile_panda", links, joints)
    return replace(
        arm,
        name=name,
        articulation=attach(base, arm.articulation, "platform", Pose((0.0, 0.0, 0.3))),
        actuators=(*arm.actuators, ImplicitPd(joints=("base_.*",), stiffness=1e4, damping=5e3)),
        planar_base=PlanarBase("base_x", "base_y", "base_yaw"),
    )


def two_armed() -> RobotSpec:
    """One robot of two Pandas side by side on one column, each with its hand."""
    panda = catalogue_robot("franka_panda")
    column = Articulation("two_pandas", (Link("column", 50.0, inertia=np.eye(3)),))
    both = column
    for side, y in (("left_", 0.4), ("right_", -0.4)):
        both = attach(both, panda.articulation, "column", Pose((0.0, y, 0.5)), prefix=side)
    sides = ("left_", "right_")
    return replace(
        panda,
        articulation=both,
        home={f"{side}{pattern}": value for side in sides for pattern, value in panda.home.items()},
        actuators=tuple(
            replace(group, joints=tuple(side + joint for joint in group.joints))
            for side in sides
            for group in panda.actuators
        ),
        end_effectors=tuple(
            EndEffector(
                f"{side}panda_hand_tcp",
                (side + ARM[0],),
                Gripper((side + FINGER,), 0.04, 0.0),
                workspace=panda.end_effector.workspace,
            )
            for side in sides
        ),
    )


@dataclass(kw_only=True)
class Stand(Reach):
    """Reach with any robot, for its actions alone."""

    spec: RobotSpec = field(default_factory=mobile_panda)

    def scene(self) -> Scene:
        scene = super().scene()
        return replace(scene, robots=(replace(self.spec, name="robot"),), objects=())


def started(task: Any) -> Environment:
    environment = Environment(task, 2, BACKEND)
    environment.reset(seed=0)
    return environment


def components(environment: Environment) -> dict[str, int]:
    return {generator.name: generator.command_size for generator in environment.actions.generators}


def act(environment: Environment, steps: int, **commands: list[float]) -> None:
    """Hold commands by term, zero elsewhere."""
    parts = [commands.get(name, [0.0] * size) for name, size in components(environment).items()]
    action = torch.tensor([value for part in parts for value in part]).repeat(environment.num_envs, 1)
    for _ in range(steps):
        environment.step(action)


def test_a_mobile_arm_needs_no_code_of_its_own() -> None:
    environment = started(Stand(action="ik_relative"))
    assert components(environment) == {"ik_relative": 6, "gripper": 1, "base": 3}
    robot = environment.world.robots["robot"]
    base = robot.find_joints("base_.*")
    start = robot.joint_positions[:, base[2]].clone()
    act(environment, 40, base=[0.0, 0.0, 1.0])
    yaw = robot.joint_positions[:, base[2]].clone()
    assert yaw - start == pytest.approx(0.8, abs=0.1)  # 1 rad/s over 0.8 s
    before = robot.joint_positions[:, base[:2]].clone()
    act(environment, 25, base=[1.0, 0.0, 0.0])
    moved = robot.joint_positions[:, base[:2]] - before
    heading = torch.stack((yaw.cos(), yaw.sin()), dim=1)
    assert (moved * heading).sum(1) == pytest.approx(0.5, abs=0.06)  # 1 m/s over 0.5 s, where the base looks
    across = moved - (moved * heading).sum(1, keepdim=True) * heading
    assert across.norm(dim=1).max() < 0.08
    environment.close()


def test_a_base_carries_the_hand_where_it_is_wished() -> None:
    environment = started(Stand(action="joint_position"))
    robot = environment.world.robots["robot"]
    act(environment, 40, base=[0.0, 0.0, 1.0])  # turned, so that its axes are not the root's
    goal = robot.frame_pose("panda_hand_tcp") + torch.tensor([0.2, -0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    base = environment.actions.generators[2]
    opened = torch.ones(2, dtype=torch.bool)
    for _ in range(150):
        rest = torch.zeros(2, 8)
        environment.step(torch.cat((rest, base.encode(goal, opened)), dim=1))
    assert (robot.frame_pose("panda_hand_tcp") - goal)[:, :2].norm(dim=1).max() < 0.03
    environment.close()


def test_base_and_arm_are_composed_at_will() -> None:
    actions = ActionTerms(base=BaseVelocityConfig(max_speed=0.5), arm=JointPositionConfig(joints=ARM, scale=0.2))
    environment = started(Stand(actions=actions))
    assert components(environment) == {"base": 3, "arm": 7}
    assert environment.task.action == "composed"
    robot = environment.world.robots["robot"]
    (x,) = robot.find_joints("base_x")
    start = robot.joint_positions[:, x].clone()
    act(environment, 50, base=[1.0, 0.0, 0.0])
    assert robot.joint_positions[:, x] - start == pytest.approx(0.5, abs=0.06)
    fingers = robot.find_joints(FINGER)  # of no term
    assert robot.joint_positions[:, fingers] == pytest.approx(0.04, abs=5e-3)
    environment.close()


def test_the_arms_of_one_robot_are_terms_by_the_frames_that_they_move() -> None:
    hands = {side: f"{side}_panda_hand_tcp" for side in ("left", "right")}
    arms = {side: DifferentialIkConfig(frame=frame) for side, frame in hands.items()}
    grippers = {f"{side}_gripper": BinaryGripperConfig(frame=frame) for side, frame in hands.items()}
    environment = started(Stand(spec=two_armed(), actions=ActionTerms(**arms, **grippers)))
    assert components(environment) == {"left": 6, "right": 6, "left_gripper": 1, "right_gripper": 1}
    robot = environment.world.robots["robot"]
    before = {side: robot.frame_pose(frame)[:, 2].clone() for side, frame in hands.items()}
    act(environment, 40, right=[0.0, 0.0, 1.0, 0.0, 0.0, 0.0], left_gripper=[-1.0])
    risen = {side: robot.frame_pose(frame)[:, 2] - before[side] for side, frame in hands.items()}
    assert risen["right"].min() > 0.05
    assert risen["left"].abs().max() < 0.03
    opened = robot.joint_positions[:, robot.find_joints(f"(left|right)_{FINGER}")]
    assert opened == pytest.approx(np.array([[0.0, 0.04]] * 2), abs=5e-3)
    environment.close()


def test_fingers_of_a_hand_are_joints_like_others() -> None:
    gripper = catalogue_robot("ur10_robotiq_2f85").end_effector.gripper
    assert gripper is not None
    actions = ActionTerms(arm=DifferentialIkConfig(), hand=JointPositionConfig(joints=gripper.joints, scale=None))
    environment = started(Lift(robot="ur10_robotiq_2f85", actions=actions))
    assert components(environment) == {"arm": 6, "hand": 1}
    robot = environment.world.robots["robot"]
    act(environment, 50, hand=[0.5])
    knuckle = robot.joint_positions[:, robot.find_joints(*gripper.joints)]
    limit = robot.position_limits[robot.find_joints(*gripper.joints), 1]
    assert knuckle == pytest.approx(0.5 * float(limit), abs=0.05)
    environment.close()


def test_components_stand_robot_by_robot_in_the_order_of_the_agents() -> None:
    arm, gripper = JointPositionConfig(scale=2.0), BinaryGripperConfig()
    actions = ActionTerms(
        theirs=replace(arm, robot=RECEIVER),
        ours=replace(arm, robot=GIVER),
        our_hand=replace(gripper, robot=GIVER),
        their_hand=replace(gripper, robot=RECEIVER),
    )
    environment = started(Handover(actions=actions))
    assert [*components(environment)] == ["ours", "our_hand", "theirs", "their_hand"]
    assert environment.actions.slices == {GIVER: slice(0, 8), RECEIVER: slice(8, 16)}
    assert environment.multi_agent is not None
    assert environment.multi_agent.action_sizes == {GIVER: 8, RECEIVER: 8}
    environment.close()


def test_terms_that_a_word_stands_for_act_as_the_word() -> None:
    ends = []
    arm = JointPositionConfig(scale=2.0, limit_speed=True)
    for fields in ({}, {"actions": ActionTerms(arm=arm, hand=BinaryGripperConfig())}):
        environment = make("Lift", 2, BACKEND, seed=3, **fields)
        action = torch.linspace(-1.0, 1.0, environment.action_size).repeat(2, 1)
        environment.reset(seed=3)
        for _ in range(20):
            environment.step(action)
        ends.append(environment.world.robots["robot"].joint_positions.clone())
        environment.close()
    torch.testing.assert_close(ends[0], ends[1], atol=0.0, rtol=0.0)


def test_drives_lose_what_works_against_their_term_alone() -> None:
    actions = ActionTerms(
        upper=JointVelocityConfig(joints=("panda_joint[1-2]",)), wrist=JointEffortConfig(joints=("panda_joint7",))
    )
    environment = started(Lift(actions=actions))
    gains = {}
    for group in environment.world.robots["robot"].spec.actuators:
        for joint in environment.world.robots["robot"].find_joints(*group.joints):
            gains[joint] = (group.stiffness, group.damping)
    assert gains == {**dict.fromkeys((0, 1), (0.0, 80.0)), **dict.fromkeys((2, 3, 4, 5), (400.0, 80.0)), 6: (0.0, 0.0),
                     7: (2000.0, 100.0)}  # fmt: skip
    environment.close()


def test_terms_are_changed_by_their_paths() -> None:
    task = configure(Lift, {"action": "ik_relative", "actions.ik_relative.position_scale": 0.1})
    assert task.actions.ik_relative == DifferentialIkConfig(position_scale=0.1)
    assert task.actions.gripper == BinaryGripperConfig()
    off = configure(Lift, {"actions.gripper": None})
    environment = started(off)
    assert components(environment) == {"joint_position": 7}
    environment.close()
    with pytest.raises(UnknownNameError, match=r"unknown field 'actions\.ik_relative\.position_scal'|position_scale"):
        configure(Lift, {"action": "ik_relative", "actions.ik_relative.position_scal": 0.1})


ANY = JointPositionConfig(joints=(".*",))


@pytest.mark.parametrize(
    ("actions", "error", "message"),
    [
        (
            ActionTerms(arm=DifferentialIkConfig(), wrist=JointPositionConfig(joints=("panda_joint7",))),
            ConfigurationError,
            "terms 'arm' and 'wrist' both move joint 'panda_joint7' of robot 'robot'",
        ),
        (ActionTerms(arm=JointPositionConfig(joints=("panda_jiont7",))), UnknownNameError,
         "unknown joint 'panda_jiont7' in robot 'robot', for action term 'arm': did you mean 'panda_joint7'"),
        (ActionTerms(arm=JointPositionConfig(robot="robto")), UnknownNameError,
         "unknown robot 'robto' in action term 'arm' of task Lift: did you mean 'robot'"),
        (ActionTerms(hand=JointPositionConfig(joints=("panda_finger_joint2",))), ConfigurationError,
         "no joint moves freely in robot 'robot', for action term 'hand'"),
        (ActionTerms(base=BaseVelocityConfig()), ConfigurationError,
         "action term 'base': robot 'robot' has no planar base"),
        (ActionTerms(base=BaseVelocityConfig(joints=("panda_joint1", "panda_joint2"))), ConfigurationError,
         "action term 'base' moves a base by exactly three joints"),
        (ActionTerms(arm=DifferentialIkConfig(frame="nose"), off=None), Exception, "nose"),
        (ActionTerms(hand=BinaryGripperConfig(frame="nose")), UnknownNameError, "unknown end effector 'nose'"),
        (ActionTerms(), ConfigurationError, "no action term of task Lift moves robot 'robot'"),
        ({"arm": ANY}, ConfigurationError, "actions of task Lift are a dataclass of action terms"),
        (ActionTerms(arm=0.5), ConfigurationError, "must be a ActionTerm, not 0.5"),  # pyright: ignore
    ],
)  # fmt: skip
def test_what_terms_cannot_be_is_said_before_the_first_step(actions: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        Environment(Lift(actions=actions), 1, BACKEND)


def test_robots_that_lack_what_a_term_needs_are_named() -> None:
    hand = ActionTerms(arm=DifferentialIkConfig())
    with pytest.raises(ConfigurationError, match="action term 'arm': robot 'robot' has no end effector"):
        make("Velocity-Flat", 1, BACKEND, actions=hand)
    cartpole = Stand(spec=catalogue_robot("cartpole"), actions=ActionTerms(all=ANY))
    with pytest.raises(ConfigurationError, match=r"joint 'hinge' of robot 'robot', for action term 'all', has no actu"):
        Environment(cartpole, 1, BACKEND)
    alone = ActionTerms(arm=JointPositionConfig(robot=GIVER))
    with pytest.raises(ConfigurationError, match="no action term of task Handover moves robot 'receiver'"):
        Environment(Handover(actions=alone), 1, BACKEND)


def test_a_word_and_terms_do_not_contradict_each_other() -> None:
    actions = ActionTerms(arm=JointPositionConfig())
    with pytest.raises(ConfigurationError, match="composed of action terms, and action 'ik_relative' would change"):
        Environment(Lift(actions=actions, action="ik_relative"), 1, BACKEND)
    with pytest.raises(ConfigurationError, match="task Lift has no action terms of its own"):
        Environment(Lift(action="composed"), 1, BACKEND)
