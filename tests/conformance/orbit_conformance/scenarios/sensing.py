"""Sensors of motion and force, against motion known in closed form."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TypeVar

import torch
from torch import Tensor

from orbit_conformance.bodies import WEIGHTLESS, G, body, cube, pendulum, scene
from orbit_conformance.scenario import SINGLE, Metric, Scenario, Trial
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import Capability, Sensor, World
from orbit_core.scene import (
    Articulation,
    ForceTorqueSpec,
    Frame,
    FrameSensorSpec,
    ImplicitPd,
    ImuSpec,
    Joint,
    JointSensorSpec,
    JointType,
    Link,
    Pose,
    RobotSpec,
    SensorSpec,
)
from orbit_core.sensors.proprioception import ForceTorqueSensor, FrameSensor, ImuSensor, JointSensor

_Kind = TypeVar("_Kind", bound=Sensor)

_RADIUS, _MASS = 0.4, 2.0
_SPIN = 3.0
"""Angular velocity in radians per second."""
_IMU = ImuSpec(name="imu", entity="arm", frame="tip")
_WRENCH = ForceTorqueSpec(name="wrench", entity="arm", link="arm")
_GROUP = "Sensors"
_HELD = ImplicitPd(joints=(".*",), stiffness=1e4, damping=1e3)


def _spinning_arm() -> RobotSpec:
    """A link that turns about z, its mass on its x axis at ``_RADIUS``, where the frame "tip" is."""
    links = (body("base"), Link("arm", _MASS, (_RADIUS, 0.0, 0.0), torch.eye(3).numpy() * 0.02))
    joints = (Joint("spin", JointType.CONTINUOUS, "base", "arm"),)
    frames = (Frame("tip", "arm", Pose((_RADIUS, 0.0, 0.0))),)
    return RobotSpec(name="arm", articulation=Articulation("arm", links, joints, frames=frames), fixed_base=True)


def _spin(trial: Trial, *sensors: SensorSpec, seconds: float = 0.5) -> World:
    """The arm after half a second at a steady speed, under gravity along its axis."""
    world = trial.world(scene(_spinning_arm(), sensors=sensors, terrain=()), num_envs=2)
    world.robots["arm"].set_joint_state(velocities=torch.full((2, 1), _SPIN, device=world.device))
    trial.step(world, trial.steps(seconds) - 1)
    trial.step(world)
    return world


def _sensor(world: World, name: str, kind: type[_Kind]) -> _Kind:
    sensor = world.sensors[name]
    assert isinstance(sensor, kind)
    return sensor


def _worst(measured: Tensor, *truth: float) -> float:
    """Largest error of any environment's vector."""
    return float((measured.double().cpu() - torch.tensor(truth, dtype=torch.float64)).norm(dim=-1).max())


def _imu_in_a_circle(trial: Trial) -> Mapping[str, float]:
    imu = _sensor(_spin(trial, _IMU), "imu", ImuSensor)
    return {
        "angular_velocity": _worst(imu.angular_velocity, 0.0, 0.0, _SPIN),
        "acceleration": _worst(imu.linear_acceleration, -(_SPIN**2) * _RADIUS, 0.0, G),
    }


def _imu_falling_and_at_rest(trial: Trial) -> Mapping[str, float]:
    """One cube falls while it spins about its centre, and one lies on its side on the ground."""
    on_its_side = Pose((1.0, 0.0, 0.05), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))
    entities = (cube("falling", pose=Pose((0.0, 0.0, 10.0))), cube("resting", pose=on_its_side))
    sensors = tuple(ImuSpec(name=entity.name, entity=entity.name, frame=entity.name) for entity in entities)
    world = trial.world(scene(*entities, sensors=sensors), num_envs=2)
    world.objects["falling"].set_root_velocity(torch.tensor([[0.0, 0, 0, 1, 2, 3]] * 2, device=world.device))
    trial.step(world, trial.steps(1.0) - 1)
    trial.step(world)
    return {
        "falling": _worst(_sensor(world, "falling", ImuSensor).linear_acceleration, 0.0, 0.0, 0.0),
        "resting": _worst(_sensor(world, "resting", ImuSensor).linear_acceleration, -G, 0.0, 0.0),
    }


def _force_torque_of_a_spinning_arm(trial: Trial) -> Mapping[str, float]:
    """The joint pulls the mass inwards and bears its weight, which has the arm's length for a lever."""
    sensor = _sensor(_spin(trial, _WRENCH), "wrench", ForceTorqueSensor)
    return {
        "force": _worst(sensor.force, -_MASS * _SPIN**2 * _RADIUS, 0.0, _MASS * G),
        "torque": _worst(sensor.torque, 0.0, -_MASS * G * _RADIUS, 0.0),
    }


def _force_torque_of_a_level_arm(trial: Trial) -> Mapping[str, float]:
    """Two links of 1 kg, each with its mass at 0.25 m of its 0.5, held level."""
    sensors = tuple(ForceTorqueSpec(name=link, entity="pendulum", link=link) for link in ("base", "link0", "link1"))
    world = trial.world(scene(pendulum(actuators=(_HELD,)), sensors=sensors, terrain=()), num_envs=2)
    trial.step(world, trial.steps(2.0))
    truth = {"base": (3 * G, -G), "link0": (2 * G, -G), "link1": (G, -0.25 * G)}
    poses = dict(zip(truth, world.robots["pendulum"].link_poses.unbind(1), strict=True))  # they sag by 1 mrad
    force, torque = (
        {link: quat_rotate(pose[:, 3:], getattr(world.sensors[link], part)) for link, pose in poses.items()}
        for part in ("force", "torque")
    )
    return {
        "force": max(_worst(force[link], 0.0, 0.0, weight) for link, (weight, _) in truth.items()),
        "torque": max(_worst(torque[link], 0.0, moment, 0.0) for link, (_, moment) in truth.items()),
    }


def _frames_and_joints(trial: Trial) -> Mapping[str, float]:
    """Errors of the frame and joint sensors of an arm that turns by itself, and of its tip."""
    sensors = (
        JointSensorSpec(name="joint", entity="arm"),
        FrameSensorSpec(name="tip", entity="arm", frame="tip"),
        FrameSensorSpec(name="seen", entity="arm", frame="base", relative_to="tip"),
    )
    still = dataclasses.replace(scene(_spinning_arm(), sensors=sensors, terrain=()), gravity=WEIGHTLESS)
    world = trial.world(still, num_envs=2)
    world.robots["arm"].set_joint_state(velocities=torch.full((2, 1), _SPIN, device=world.device))
    trial.step(world, trial.steps(0.5))
    angle = 0.5 * _SPIN
    cosine, sine = _RADIUS * math.cos(angle), _RADIUS * math.sin(angle)
    joint, tip, seen = _sensor(world, "joint", JointSensor), *(_sensor(world, n, FrameSensor) for n in ("tip", "seen"))
    turned = (math.cos(0.5 * angle), 0.0, 0.0, math.sin(0.5 * angle))
    return {
        "joint_position": _worst(joint.positions, angle),
        "joint_velocity": _worst(joint.velocities, _SPIN),
        "position": max(_worst(tip.pose[:, :3], cosine, sine, 0.0), _worst(seen.pose[:, :3], -_RADIUS, 0.0, 0.0)),
        "orientation": _worst(tip.pose[:, 3:], *turned),
        "velocity": _worst(tip.velocity, -_SPIN * sine, _SPIN * cosine, 0.0, 0.0, 0.0, _SPIN),
    }


_DIFFERENCES = "some engines give it directly, others as a difference of velocities that single precision rounds"
_SETTLING = "solvers that iterate leave the arm a motion that the best do not"
_SINGLE = "engines of single precision round each step's turn to 1e-7 of the angle"
_RIGID_BODY = "Goldstein, Classical Mechanics, 3rd ed., section 4.9"

SCENARIOS = (
    Scenario(
        name="imu_in_a_circle",
        group=_GROUP,
        question="Does an inertial sensor on a spinning arm read what it should?",
        truth="omega along z; acceleration - omega^2 r along the arm and g along the axis",
        source=_RIGID_BODY,
        run=_imu_in_a_circle,
        needs=(Capability.ARTICULATIONS,),
        metrics=(
            Metric(
                name="angular_velocity",
                unit="rad/s",
                tolerance=1e-6,
                meaning="length of the error",
                looser_because=SINGLE,
            ),
            Metric(
                name="acceleration",
                unit="m/s^2",
                tolerance=0.03,
                meaning="length of the error; the sensor reads the mean of a step, half a step late: omega^3 r dt / 2",
            ),
        ),
    ),
    Scenario(
        name="imu_falling_and_at_rest",
        group=_GROUP,
        question="Does an inertial sensor read nothing in free fall, and g at rest?",
        truth="0 at the centre of mass of a falling body; g upwards, in the sensor's own axes, at rest",
        source=_RIGID_BODY,
        run=_imu_falling_and_at_rest,
        metrics=(
            Metric(name="falling", unit="m/s^2", tolerance=1.9e-4, meaning="length of the error, after 1 s"),
            Metric(
                name="resting",
                unit="m/s^2",
                tolerance=2e-5,
                meaning="length of the error, after 1 s",
                looser_because=_DIFFERENCES,
            ),
        ),
    ),
    Scenario(
        name="force_torque_of_a_spinning_arm",
        group=_GROUP,
        question="Does a force-torque sensor feel the centripetal force?",
        truth="force - m omega^2 r along the arm and m g along the axis; torque - m g r across",
        source=_RIGID_BODY,
        judges=(Capability.JOINT_WRENCHES,),
        run=_force_torque_of_a_spinning_arm,
        needs=(Capability.JOINT_WRENCHES, Capability.ARTICULATIONS),
        metrics=(
            Metric(
                name="force",
                unit="N",
                tolerance=3e-4,
                meaning="length of the error, of 21 N",
                looser_because=_DIFFERENCES,
            ),
            Metric(
                name="torque",
                unit="N m",
                tolerance=5e-4,
                meaning="length of the error, of 7.8 N m",
                looser_because=_DIFFERENCES,
            ),
        ),
    ),
    Scenario(
        name="force_torque_of_a_level_arm",
        group=_GROUP,
        question="Do force-torque sensors feel what hangs on each joint?",
        truth="the weights beyond a joint, and their moments about it",
        source="Beer and Johnston, Vector Mechanics for Engineers: Statics, 12th ed., chapter 4",
        judges=(Capability.JOINT_WRENCHES,),
        run=_force_torque_of_a_level_arm,
        needs=(Capability.JOINT_WRENCHES, Capability.IMPLICIT_DRIVES),
        metrics=(
            Metric(
                name="force",
                unit="N",
                tolerance=1e-3,
                meaning="length of the worst sensor's error, of 29 N",
                looser_because=_SETTLING,
            ),
            Metric(
                name="torque",
                unit="N m",
                tolerance=1e-4,
                meaning="length of the worst sensor's error, of 9.8 N m",
                looser_because=_SETTLING,
            ),
        ),
    ),
    Scenario(
        name="frame_and_joint_sensors",
        group=_GROUP,
        question="Do the sensors of joints and frames tell where a spinning arm is and how it moves?",
        truth="angle omega t; the tip on its circle at that angle, with velocity omega x r",
        source=_RIGID_BODY,
        run=_frames_and_joints,
        needs=(Capability.ARTICULATIONS,),
        metrics=(
            Metric(
                name="joint_position", unit="rad", tolerance=1e-4, meaning="error after 0.5 s", looser_because=_SINGLE
            ),
            Metric(
                name="joint_velocity",
                unit="rad/s",
                tolerance=1e-6,
                meaning="error after 0.5 s",
                looser_because=SINGLE,
            ),
            Metric(
                name="position",
                unit="m",
                tolerance=1e-4,
                looser_because=_SINGLE,
                meaning="error of the tip in the world, and of the base seen from the tip",
            ),
            Metric(
                name="orientation",
                unit="",
                tolerance=1e-4,
                looser_because=_SINGLE,
                meaning="length of the quaternion's error",
            ),
            Metric(
                name="velocity",
                unit="m/s, rad/s",
                tolerance=1e-4,
                looser_because=_SINGLE,
                meaning="length of the error of the tip's velocity",
            ),
        ),
    ),
)
