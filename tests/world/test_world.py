"""Worlds over an engine: frames, written state, randomised parameters, sensors' timing, explicit actuators."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_assets.catalogue import robot
from orbit_assets.joint_models import BALL, compound
from orbit_assets.objects import box
from orbit_core.backends import default_backend
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.interfaces import (
    ArgumentError,
    AssetError,
    ConfigurationError,
    NonFiniteError,
    ShapeError,
    UnknownNameError,
    World,
)
from orbit_core.scene import (
    Articulation,
    ContactSensorSpec,
    IdealPd,
    ImuSpec,
    Joint,
    JointSensorSpec,
    JointType,
    Link,
    MarkerSpec,
    Pose,
    RobotSpec,
    Scene,
)
from orbit_core.sensors import ContactSensor, ImuSensor, JointSensor
from orbit_core.world import simulate

BACKEND = default_backend()
MakeWorld = Callable[..., World]
CUBE = box("cube", size=(0.1, 0.1, 0.1), mass=0.5, pose=Pose((0.6, 0.0, 0.05)))


@pytest.fixture
def make_world() -> Iterator[MakeWorld]:
    made: list[World] = []

    def make(scene: Scene, num_envs: int = 2) -> World:
        made.append(simulate(scene, num_envs, BACKEND))
        return made[-1]

    yield make
    for world in made:
        world.close()


def arm_scene() -> Scene:
    return Scene(robots=(robot("franka_panda", name="arm"),), objects=(CUBE,), markers=(MarkerSpec("goal"),))


def test_a_frames_pose_and_jacobian_agree_with_the_description(make_world: MakeWorld) -> None:
    arm = make_world(arm_scene()).robots["arm"]
    tree = KinematicTree(arm.spec.articulation)
    frame = arm.spec.end_effector.frame
    poses = tree.forward(arm.root_pose, arm.joint_positions)
    position = arm.frame_position(frame)  # before the pose, from which it would be taken
    torch.testing.assert_close(arm.frame_pose(frame), tree.frame_pose(poses, frame), atol=2e-6, rtol=0)
    assert torch.equal(position, arm.frame_pose(frame)[:, :3])
    assert torch.equal(arm.frame_position(frame), position)
    torch.testing.assert_close(arm.jacobian(frame), tree.jacobian(poses, frame), atol=2e-6, rtol=0)


def test_a_frames_velocity_is_the_jacobian_times_the_joints(make_world: MakeWorld) -> None:
    arm = make_world(arm_scene()).robots["arm"]
    joints = arm.find_joints("panda_joint[1-7]")
    velocities = torch.linspace(-1.0, 1.0, 7).repeat(2, 1)
    arm.set_joint_state(velocities=velocities, joints=joints)
    frame = arm.spec.end_effector.frame
    expected = (arm.jacobian(frame, joints) @ velocities[..., None]).squeeze(-1)
    torch.testing.assert_close(arm.frame_velocity(frame), expected, atol=1e-5, rtol=0)


def test_mimic_joints_are_written_with_their_leader(make_world: MakeWorld) -> None:
    arm = make_world(arm_scene()).robots["arm"]
    leader, follower = arm.find_joints("panda_finger_joint1", "panda_finger_joint2")
    arm.set_joint_state(torch.full((2, 1), 0.013), torch.full((2, 1), 0.1), joints=[leader])
    torch.testing.assert_close(arm.joint_positions[:, follower], torch.full((2,), 0.013))
    torch.testing.assert_close(arm.joint_velocities[:, follower], torch.full((2,), 0.1))


def test_names_and_regular_expressions_are_looked_up(make_world: MakeWorld) -> None:
    arm = make_world(arm_scene()).robots["arm"]
    assert arm.find_links("panda_link[12]") == [1, 2]
    with pytest.raises(UnknownNameError, match="unknown joint 'panda_joint9' in 'arm'"):
        arm.find_joints("panda_joint9")
    with pytest.raises(UnknownNameError, match=r"unknown frame 'panda_hnad' in 'arm'.*'panda_hand'"):
        arm.frame_pose("panda_hnad")


def test_bad_state_is_refused_with_the_culprit(make_world: MakeWorld) -> None:
    world = make_world(arm_scene())
    cube = world.objects["cube"]
    with pytest.raises(ShapeError, match=r"root pose of 'cube' must have shape \(2, 7\), not \(1, 7\)"):
        cube.set_root_pose(torch.zeros(1, 7))
    pose = cube.root_pose.clone()
    pose[1, 0] = torch.inf
    with pytest.raises(NonFiniteError, match=r"root pose of 'cube' .* environment 1"):
        cube.set_root_pose(pose)


def test_randomised_mass_and_wrench_act(make_world: MakeWorld) -> None:
    world = make_world(Scene(objects=(replace(CUBE, pose=Pose((0.0, 0.0, 5.0))),)))
    cube = world.objects["cube"]
    cube.set_masses(torch.tensor([[1.0], [2.0]]))
    cube.set_wrenches(torch.tensor([3.0, 0.0, 0.0, 0.0, 0.0, 0.0]).repeat(2, 1, 1))
    world.step(20)
    # v = F t / m
    torch.testing.assert_close(cube.root_velocity[:, 0], torch.tensor([0.3, 0.15]), rtol=1e-3, atol=0)


def test_randomised_centre_of_mass_tips_the_body(make_world: MakeWorld) -> None:
    world = make_world(Scene(objects=(CUBE,)))
    cube = world.objects["cube"]
    cube.set_centers_of_mass(torch.tensor([[[0.0, 0.0, 0.0]], [[0.06, 0.0, 0.0]]]))
    world.step(60)
    # Beyond its edge, at 0.05 m, nothing holds the second cube up.
    assert cube.root_pose[0, 3] > 0.999
    assert cube.root_pose[1, 3] < 0.99


def test_randomised_friction_decides_how_far_a_cube_slides(make_world: MakeWorld) -> None:
    world = make_world(Scene(objects=(CUBE,)))
    cube = world.objects["cube"]
    cube.set_friction(torch.tensor([[0.2], [0.4]]))
    world.set_terrain_friction(torch.tensor([0.2, 0.2]))
    cube.set_root_velocity(torch.tensor([1.0, 0, 0, 0, 0, 0]).repeat(2, 1))
    start = cube.root_pose[:, 0].clone()
    world.step(200)
    distance = cube.root_pose[:, 0] - start
    # v^2 / (2 mu g), the larger coefficient of the pair
    torch.testing.assert_close(distance, 1.0 / (2 * torch.tensor([0.2, 0.4]) * 9.81), rtol=0.1, atol=0)


def test_gravity_reaches_the_engine_and_the_imu(make_world: MakeWorld) -> None:
    flying = replace(CUBE, pose=Pose((0.0, 0.0, 5.0)))
    world = make_world(Scene(objects=(flying,), sensors=(ImuSpec(name="imu", entity="cube", frame="cube"),)))
    world.set_gravity(torch.tensor([[0.0, 0.0, -1.62]]), torch.tensor([1]))
    world.step(20)
    expected = -0.1 * torch.tensor([9.81, 1.62])
    torch.testing.assert_close(world.objects["cube"].root_velocity[:, 2], expected, rtol=1e-3, atol=0)
    imu = world.sensors["imu"]
    assert isinstance(imu, ImuSensor)
    torch.testing.assert_close(imu.linear_acceleration, torch.zeros(2, 3), atol=0.02, rtol=0)  # free fall


def test_gains_of_implicit_and_explicit_drives_are_set_alike(make_world: MakeWorld) -> None:
    spec = robot("franka_panda", name="arm")
    arm_group, *rest = spec.actuators
    explicit = IdealPd(joints=arm_group.joints, stiffness=400.0, damping=40.0)
    moved = []
    for actuators in (spec.actuators, (explicit, *rest)):
        world = make_world(Scene(robots=(replace(spec, actuators=actuators),)))
        arm = world.robots["arm"]
        joints = arm.find_joints("panda_joint[1-7]")
        arm.set_gains(torch.tensor([[40.0], [400.0]]).repeat(1, 7), torch.full((2, 7), 40.0), joints)
        arm.set_position_targets(arm.home_positions[joints].repeat(2, 1) + 0.1, joints)
        world.step(20)
        moved.append(arm.joint_positions[:, 0] - arm.home_positions[0])
    assert moved[0][1] > 4 * moved[0][0] > 0
    torch.testing.assert_close(moved[0], moved[1], rtol=0.1, atol=0)
    with pytest.raises(ConfigurationError, match="'panda_finger_joint2' has no actuator"):
        arm.set_gains(torch.ones(2, 1), torch.ones(2, 1), arm.find_joints("panda_finger_joint2"))


def test_contact_forces_average_over_the_step_with_explicit_actuators_too(make_world: MakeWorld) -> None:
    spec = robot("franka_panda", name="arm")
    arm_group, *rest = spec.actuators
    explicit = IdealPd(joints=arm_group.joints, stiffness=100.0, damping=20.0)
    sensor = ContactSensorSpec(name="touch", entity="cube", filters=("terrain", "arm"))
    world = make_world(Scene(robots=(replace(spec, actuators=(explicit, *rest)),), objects=(CUBE,), sensors=(sensor,)))
    for _ in range(25):
        world.step(4)
    touch = world.sensors["touch"]
    assert isinstance(touch, ContactSensor)
    weight = torch.tensor([0.0, 0.0, 0.5 * 9.81])
    torch.testing.assert_close(touch.forces[:, 0], weight.repeat(2, 1), atol=0.05, rtol=0)
    torch.testing.assert_close(touch.filtered_forces[:, 0, 0], weight.repeat(2, 1), atol=0.05, rtol=0)
    assert (touch.filtered_forces[:, 0, 1] == 0).all()


def test_a_slow_sensor_holds_its_value_within_a_step(make_world: MakeWorld) -> None:
    slow = JointSensorSpec(name="slow", entity="arm", rate=50.0)
    fast = JointSensorSpec(name="fast", entity="arm")
    world = make_world(replace(arm_scene(), sensors=(slow, fast)))
    arm = world.robots["arm"]
    arm.set_position_targets(arm.joint_positions + 0.2)
    readings = {name: sensor for name, sensor in world.sensors.items() if isinstance(sensor, JointSensor)}
    world.step(4)
    held = readings["slow"].positions.clone()
    torch.testing.assert_close(held, readings["fast"].positions)
    world.step(3)
    assert torch.equal(readings["slow"].positions, held)
    assert not torch.equal(readings["fast"].positions, held)
    world.step(5)  # due at the first of these five steps, and not again
    assert not torch.equal(readings["slow"].positions, held)


def test_a_snapshot_repeats_sensors_markers_and_random_draws(make_world: MakeWorld) -> None:
    world = make_world(replace(arm_scene(), sensors=(JointSensorSpec(name="joints", entity="arm", rate=50.0),)))
    world.robots["arm"].set_position_targets(world.robots["arm"].joint_positions + 0.1)
    world.step(6)
    world.markers["goal"].set_pose(torch.tensor([1.0, 2, 3, 1, 0, 0, 0]).repeat(2, 1))
    state = world.save_state()

    def continuation() -> list[torch.Tensor]:
        world.step(6)
        sensor = world.sensors["joints"]
        assert isinstance(sensor, JointSensor)
        draw = world.random.uniform((3,))
        return [sensor.positions.clone(), world.link_poses.clone(), draw, world.markers["goal"].pose.clone()]

    first = continuation()
    world.markers["goal"].set_pose(torch.eye(1, 7).roll(3), torch.tensor([0]))
    world.load_state(state)
    for one, again in zip(first, continuation(), strict=True):
        assert torch.equal(one, again)


def test_the_build_report_tells_of_the_catalogues_choices(make_world: MakeWorld) -> None:
    world = make_world(arm_scene())
    assert any("armature" in line.got for line in world.build_report)
    assert world.native == world.engine.native


def test_a_free_body_without_mass_is_refused(make_world: MakeWorld) -> None:
    link = replace(CUBE.articulation.root, mass=0.0)
    hollow = replace(CUBE, articulation=replace(CUBE.articulation, links=(link,)))
    with pytest.raises(AssetError, match=r"'cube'.*no mass"):
        make_world(Scene(objects=(hollow,)))


def test_two_things_of_one_name_are_refused(make_world: MakeWorld) -> None:
    with pytest.raises(ConfigurationError, match="two entity specifications share the name 'cube'"):
        make_world(Scene(objects=(CUBE, CUBE)))


def test_links_without_mass_keep_to_none(make_world: MakeWorld) -> None:
    links, joints = compound(Joint("pivot", JointType.CONTINUOUS, "base", "bob"), BALL)
    bob = Link("bob", 2.0, (0.0, 0.0, -0.5), 0.01 * np.eye(3))
    pivoted = Articulation("pivoted", (Link("base"), *links, bob), joints)
    world = make_world(Scene(robots=(RobotSpec(name="pivoted", articulation=pivoted, fixed_base=True),)))
    robot = world.robots["pivoted"]
    assert not world.build_report
    robot.set_masses(2 * robot.nominal_masses)
    robot.set_joint_state(torch.full((world.num_envs, 3), 0.3))
    world.step(10)
    assert robot.joint_positions.isfinite().all()
    with pytest.raises(ArgumentError, match="masses of 'pivoted' without any"):
        robot.set_masses(torch.ones(world.num_envs, 1), links=[1])
