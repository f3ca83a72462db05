"""What each sensor says about a scene whose truth is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from orbit_core.interfaces import BACKGROUND, TERRAIN, ConfigurationError, UnknownNameError
from orbit_core.scene import (
    Articulation,
    Box,
    ContactSensorSpec,
    ForceTorqueSpec,
    Frame,
    FrameSensorSpec,
    ImuSpec,
    Joint,
    JointSensorSpec,
    JointType,
    Link,
    Noise,
    ObjectSpec,
    Plane,
    Pose,
    RayCasterSpec,
    RobotSpec,
    Scene,
    SensorSpec,
    Shape,
    Sphere,
    single_link,
)
from orbit_core.sensors import grid_pattern

GROUND = (Shape(Plane(), name="ground"),)
G = 9.81


def block(name: str, height: float, half: float = 0.1, mass: float = 2.0, pose: Pose | None = None) -> ObjectSpec:
    inertia = np.eye(3) * mass * 2 * half**2 / 3
    body = single_link(name, Shape(Box((half, half, half))), mass, inertia)
    tip = Frame("tip", name, Pose.from_euler(0.0, 0.0, math.pi / 2, (0.5, 0.0, 0.0)))
    body = Articulation(name, body.links, frames=(tip,))
    return ObjectSpec(name=name, articulation=body, pose=pose or Pose((0.0, 0.0, height)))


def pendulum() -> RobotSpec:
    """Two links on a fixed base; at position zero both reach along x, one metre each, turning about y."""
    inertia = np.eye(3) * 0.01
    links = (
        Link("base", 1.0, inertia=inertia),
        Link("upper", 1.0, (0.5, 0.0, 0.0), inertia),
        Link("lower", 2.0, (0.5, 0.0, 0.0), inertia),
    )
    axis, elbow = (0.0, 1.0, 0.0), Pose((1.0, 0.0, 0.0))
    joints = (
        Joint("shoulder", JointType.REVOLUTE, "base", "upper", axis=axis, lower_limit=-7, upper_limit=7),
        Joint("elbow", JointType.REVOLUTE, "upper", "lower", elbow, axis=axis, lower_limit=-7, upper_limit=7),
    )  # fmt: skip
    articulation = Articulation("pendulum", links, joints, (Frame("tip", "lower", Pose((1.0, 0, 0))),))
    return RobotSpec(name="pendulum", articulation=articulation, pose=Pose((0, 0, 3.0)), fixed_base=True)


def scene(
    *things: ObjectSpec | RobotSpec, sensors: tuple[SensorSpec, ...], gravity: float = -G, dt: float = 0.002
) -> Scene:
    return Scene(
        robots=tuple(thing for thing in things if isinstance(thing, RobotSpec)),
        objects=tuple(thing for thing in things if isinstance(thing, ObjectSpec)),
        terrain=GROUND,
        sensors=sensors,
        gravity=(0.0, 0.0, gravity),
        physics_dt=dt,
    )


def assert_near(actual, expected, tolerance=1e-4):
    torch.testing.assert_close(
        actual, torch.as_tensor(expected, dtype=actual.dtype).expand_as(actual), atol=tolerance, rtol=0
    )


# Joints and frames ---------------------------------------------------------------------------------------------------


def test_joint_sensors_pick_joints_by_name(make_rig):
    rig = make_rig(scene(pendulum(), sensors=(JointSensorSpec(name="elbow", entity="pendulum", joints=("el.*",)),)))
    joints = torch.tensor([0, 1])
    rig.engine.write_joint_state(joints, torch.tensor([[0.1, 0.2], [0.3, 0.4]]), torch.tensor([[1.0, 2], [3, 4]]))
    sensor = rig.sensors["elbow"]
    assert sensor.joint_names == ("elbow",)
    assert_near(sensor.positions, [[0.2], [0.4]])
    assert_near(sensor.velocities, [[2.0], [4.0]])


def test_a_frame_moves_with_its_link(make_rig):
    spec = FrameSensorSpec(name="tip", entity="block", frame="tip")
    rig = make_rig(scene(block("block", 1.0), sensors=(spec,)))
    rig.engine.write_root_state(0, None, torch.tensor([[1.0, 0, 0, 0, 0, 2.0]]).repeat(2, 1))
    half = math.sqrt(0.5)
    assert_near(rig.sensors["tip"].pose, [0.5, 0, 1, half, 0, 0, half])
    assert_near(rig.sensors["tip"].velocity, [1.0, 1.0, 0, 0, 0, 2])


def test_a_frame_seen_from_a_moving_frame(make_rig):
    spec = FrameSensorSpec(name="tip", entity="pendulum", frame="tip", relative_to="upper")
    rig = make_rig(scene(pendulum(), sensors=(spec,)))
    # The upper link hangs, the lower stands out level; the elbow alone turns the tip in the upper link's frame.
    angles = torch.tensor([[math.pi / 2, -math.pi / 2]]).repeat(2, 1)
    rig.engine.write_joint_state(torch.tensor([0, 1]), angles, torch.tensor([[5.0, 3.0]]).repeat(2, 1))
    assert_near(rig.sensors["tip"].pose[:, :3], [1.0, 0, 1.0])
    assert_near(rig.sensors["tip"].velocity, [3.0, 0, 0, 0, 3.0, 0])


def test_unknown_names_say_which_sensor(make_rig):
    for spec, culprit in (
        (FrameSensorSpec(name="s", entity="blok", frame="tip"), "entity 'blok' in sensor 's': did you mean 'block'"),
        (FrameSensorSpec(name="s", entity="block", frame="top"), "frame 'top' in sensor 's': did you mean 'tip'"),
        (JointSensorSpec(name="s", entity="block", joints=("a",)), "joint 'a' in sensor 's'"),
    ):
        with pytest.raises(UnknownNameError, match=culprit):
            make_rig(scene(block("block", 1.0), sensors=(spec,)))


# Inertial units ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [None, 100.0])
def test_an_imu_in_free_fall_feels_nothing(make_rig, rate):
    rig = make_rig(scene(block("block", 5.0), sensors=(ImuSpec(name="imu", entity="block", frame="block", rate=rate),)))
    imu = rig.sensors["imu"]
    assert_near(imu.linear_acceleration, [0, 0, G])  # before the first step its velocity counts as constant
    rig.step(10)
    assert_near(imu.linear_acceleration, [0, 0, 0], 1e-2)


def test_an_imu_at_rest_feels_gravity_in_its_own_axes(make_rig):
    lying = Pose.from_euler(math.pi / 2, 0.0, 0.0, (0, 0, 0.1))
    spec = ImuSpec(name="imu", entity="block", frame="block")
    rig = make_rig(scene(block("block", 0.1, pose=lying), sensors=(spec,)))
    rig.step(300)
    assert_near(rig.sensors["imu"].linear_acceleration, [0, G, 0], 0.02)


def test_an_imu_off_the_axis_feels_the_centripetal_acceleration(make_rig):
    spec = ImuSpec(name="imu", entity="block", frame="tip")
    rig = make_rig(scene(block("block", 1.0), sensors=(spec,), gravity=0.0, dt=0.001))
    rig.engine.write_root_state(0, None, torch.tensor([[0.0, 0, 0, 0, 0, 3.0]]).repeat(2, 1))
    rig.step(2)
    # The tip's y axis points along the block's -x, towards the middle.
    assert_near(rig.sensors["imu"].linear_acceleration, [0, 9 * 0.5, 0], 0.05)
    assert_near(rig.sensors["imu"].angular_velocity, [0, 0, 3.0])


def test_a_written_velocity_is_no_acceleration(make_rig):
    spec = ImuSpec(name="imu", entity="block", frame="block", rate=100.0)
    rig = make_rig(scene(block("block", 5.0), sensors=(spec,), gravity=0.0))
    for _ in range(3):
        rig.engine.write_root_state(0, None, torch.randn(2, 6))
        rig.step(5)
        assert_near(rig.sensors["imu"].linear_acceleration, [0, 0, 0], 1e-2)


# Contact -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [None, 50.0])
def test_contact_forces_carry_the_weight_by_pair(make_rig, rate):
    spec = ContactSensorSpec(name="c", entity="low", filters=("terrain", "high"), rate=rate)
    rig = make_rig(scene(block("low", 0.1), block("high", 0.3), sensors=(spec,)))
    sensor = rig.sensors["c"]
    assert_near(sensor.forces, 0.0)
    for _ in range(40):
        rig.step(10)
    assert sensor.link_names == ("low",)
    assert sensor.forces.shape == (2, 1, 3)
    assert_near(sensor.forces, [0, 0, 2 * G], 0.1)
    assert_near(sensor.filtered_forces[:, 0], [[0, 0, 4 * G], [0, 0, -2 * G]], 0.1)
    assert sensor.in_contact().all()
    assert not sensor.in_contact(threshold=100.0).any()


def test_contact_forces_are_averaged_over_the_world_step_however_it_is_chunked(make_rig):
    falling = block("block", 0.15)
    averaged = ContactSensorSpec(name="c", entity="block")
    plain = make_rig(scene(falling, sensors=(averaged,)))
    chunked = make_rig(
        scene(falling, sensors=(averaged, FrameSensorSpec(name="f", entity="block", frame="block", rate=500.0)))
    )
    impulse = torch.zeros(2)
    for _ in range(40):
        plain.step(20)
        chunked.step(20)
        torch.testing.assert_close(plain.sensors["c"].forces, chunked.sensors["c"].forces, atol=1e-3, rtol=1e-3)
        impulse += plain.sensors["c"].forces[:, 0, 2] * 20 * 0.002
    # The block starts and ends at rest, so the ground gave what gravity took.
    assert_near(impulse, 2 * G * 1.6, 0.05)


def test_a_reset_environment_feels_no_contact_until_it_steps(make_rig):
    rig = make_rig(scene(block("block", 0.1), sensors=(ContactSensorSpec(name="c", entity="block"),)))
    rig.step(100)
    rig.reset(torch.tensor([0]))
    assert_near(rig.sensors["c"].forces[0], 0.0)
    assert_near(rig.sensors["c"].forces[1], [0, 0, 2 * G], 0.5)


def test_contact_timers_tell_flight_and_touch(make_rig):
    rig = make_rig(scene(block("block", 0.1 + G / 2 * 0.2**2), sensors=(ContactSensorSpec(name="c", entity="block"),)))
    timer = rig.sensors["c"].timer()
    assert rig.sensors["c"].timer() is timer
    for _ in range(18):
        rig.step(5)
    assert_near(timer.air_time, 0.18, 1e-4)
    assert_near(timer.contact_time, 0.0)
    touched = False
    for _ in range(40):
        rig.step(5)
        touched |= bool(timer.touched_down(within=0.01).all())
    assert touched
    assert_near(timer.last_air_time, 0.2, 0.011)
    assert (timer.contact_time > 0.2).all()
    assert_near(timer.air_time, 0.0)
    rig.reset(torch.tensor([1]))
    assert timer.contact_time[0] > 0.2
    assert timer.times[:, 1].abs().max() == 0.0


# Force-torque --------------------------------------------------------------------------------------------------------


def test_a_force_torque_sensor_carries_what_hangs_below_it(make_rig):
    rig = make_rig(scene(pendulum(), sensors=(ForceTorqueSpec(name="ft", entity="pendulum", link="upper"),)))
    down = torch.tensor([[math.pi / 2, 0.0]]).repeat(2, 1)
    rig.engine.write_joint_state(torch.tensor([0, 1]), down, torch.zeros(2, 2))
    rig.step(1)
    # Hanging, the link's x axis points down; the parent pulls it up.
    assert_near(rig.sensors["ft"].force, [-3 * G, 0, 0], 0.02)
    assert_near(rig.sensors["ft"].torque, 0.0, 0.02)


# Rays ----------------------------------------------------------------------------------------------------------------


def scan(**settings) -> RayCasterSpec:
    return RayCasterSpec(
        **{"name": "scan", "entity": "block", "frame": "block", "directions": ((0, 0, -2.0),)} | settings
    )


def test_rays_pass_through_their_own_entity_and_meet_the_ground(make_rig):
    origins, directions = grid_pattern((0.4, 0.2), 0.1)
    rig = make_rig(scene(block("block", 1.0), sensors=(scan(origins=origins, directions=directions),)))
    sensor = rig.sensors["scan"]
    assert sensor.distances.shape == (2, 15)
    assert_near(sensor.distances, 1.0)
    assert_near(sensor.normals, [0, 0, 1.0])
    assert_near(sensor.points[..., 2], 0.0)
    assert_near(sensor.points[0, :5, 0], [-0.2, -0.1, 0, 0.1, 0.2])
    assert (sensor.links == TERRAIN).all()


def test_rays_see_other_entities_and_miss_beyond_their_reach(make_rig):
    directions = ((1.0, 0, 0), (0, 1.0, 0), (0, 0, -1.0))
    other = block("other", 1.0, pose=Pose((1.0, 0, 1.0)))
    rig = make_rig(scene(block("block", 1.0), other, sensors=(scan(directions=directions, max_distance=0.95),)))
    sensor = rig.sensors["scan"]
    assert_near(sensor.distances[:, 0], 0.9)
    assert sensor.distances[:, 1:].isinf().all()
    assert sensor.points[:, 1:].isinf().all()
    assert sensor.links[0].tolist() == [1, BACKGROUND, BACKGROUND]
    assert_near(sensor.normals[0], [[-1.0, 0, 0], [0, 0, 0], [0, 0, 0]])


def test_a_level_pattern_turns_with_the_heading_alone(make_rig):
    tilted = Pose.from_euler(0.0, 0.0, math.pi / 2, (0, 0, 1.0)) @ Pose.from_euler(0.3, 0.4, 0.0)
    above = Pose((0.2, 0, 1.0))
    sensors = (scan(pose=above, yaw_only=True), scan(name="tilted", pose=above))
    rig = make_rig(scene(block("block", 1.0, pose=tilted), sensors=sensors))
    level = rig.sensors["scan"]
    yaw = Pose(orientation=tilted.orientation).rotation_matrix()
    heading = math.atan2(yaw[1, 0], yaw[0, 0])
    expected = [0.2 * math.cos(heading), 0.2 * math.sin(heading), 0.0]
    assert_near(level.points[:, 0], expected, 1e-3)
    assert_near(level.distances, 2.0, 1e-3)
    assert (rig.sensors["tilted"].distances > 2.02).all()


def test_range_noise_moves_points_along_their_rays(make_rig):
    rig = make_rig(scene(block("block", 1.0), sensors=(scan(noise=Noise(std=0.05)),)), num_envs=100)
    sensor = rig.sensors["scan"]
    assert sensor.distances.std().item() == pytest.approx(0.05, rel=0.3)
    torch.testing.assert_close(sensor.points[..., 2], 1.0 - sensor.distances)
    assert_near(sensor.points[..., :2], 0.0)


def test_patterns_that_cannot_be_are_refused(make_rig):
    with pytest.raises(ConfigurationError, match="non-zero length"):
        make_rig(scene(block("block", 1.0), sensors=(scan(directions=((0.0, 0, 0),)),)))
    with pytest.raises(ConfigurationError, match="2 ray origins for 1 directions"):
        make_rig(scene(block("block", 1.0), sensors=(scan(origins=((0, 0, 0), (1, 0, 0))),)))


def test_a_ball_is_round_to_a_lidar(make_rig):
    ball = ObjectSpec(
        name="ball",
        articulation=single_link("ball", Shape(Sphere(0.5)), 1.0, np.eye(3) * 0.1),
        pose=Pose((2.0, 0, 1.0)),
    )
    directions = tuple((1.0, y, 0.0) for y in (-0.2, -0.1, 0.0, 0.1, 0.2))
    rig = make_rig(scene(block("block", 1.0), ball, sensors=(scan(directions=directions),)))
    sensor = rig.sensors["scan"]
    assert_near((sensor.points - torch.tensor([2.0, 0, 1.0])).norm(dim=-1), 0.5, 1e-3)
