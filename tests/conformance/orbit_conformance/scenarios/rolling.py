"""Scenarios of rolling: wheels, coins, balls on turntables, and wheels that drive a base."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from orbit_assets.objects import cylinder
from orbit_conformance.bodies import SMOOTH, SMOOTH_GROUND, G, body, marble, on_slope, scene, slope, smooth_material
from orbit_conformance.scenario import FIRST_ORDER, Metric, Scenario, Trial
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import Capability
from orbit_core.scene import (
    Articulation,
    Box,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    ObjectSpec,
    PhysicsMaterial,
    Pose,
    RobotSpec,
    Shape,
    Sphere,
)

# Wheels --------------------------------------------------------------------------------------------------------------

RADIUS, WIDTH = 0.1, 0.04
_SPEED = 1.0
# Headings in rad of the two wheels on level ground.
_HEADINGS = (0.0, 0.6)
# Slopes as the tangent of the angle; at friction 0.5 a wheel rolls up to 1.5.
_SLOPES = (0.1, 0.4)


def _wheel(name: str, pose: Pose) -> ObjectSpec:
    """A solid cylinder of 1 kg; with the identity as ``pose`` its axis is y."""
    upright = pose @ Pose.from_euler(-math.pi / 2, 0.0, 0.0)
    return cylinder(name, RADIUS, WIDTH, mass=1.0, material=smooth_material(0.5), pose=upright)


def _rolling_wheel(trial: Trial) -> Mapping[str, float]:
    wheels = [
        _wheel(f"wheel{number}", Pose.from_euler(0.0, 0.0, heading, (0.0, 1.0 * number, RADIUS)))
        for number, heading in enumerate(_HEADINGS)
    ]
    world = trial.world(scene(*wheels, terrain=SMOOTH_GROUND))
    trial.step(world, trial.steps(0.1))
    starts = []
    for wheel, heading in zip(world.objects.values(), _HEADINGS, strict=True):
        starts.append(wheel.root_pose[0, :3].cpu().clone())
        along = torch.tensor([math.cos(heading), math.sin(heading), 0.0])
        # Pure rolling from the start: friction has nothing to do on the level.
        spin = torch.tensor([-math.sin(heading), math.cos(heading), 0.0]) / RADIUS
        wheel.set_root_velocity((_SPEED * torch.cat((along, spin)))[None].to(world.device))
    slower, aside, curve = 0.0, 0.0, []
    for time in trial.advance(world, 2.0, every=0.1):
        for wheel, heading, start in zip(world.objects.values(), _HEADINGS, starts, strict=True):
            along = torch.tensor([math.cos(heading), math.sin(heading), 0.0])
            way = wheel.root_pose[0, :3].cpu() - start
            # Distance instead of speed: slips of single steps add up.
            slower = max(slower, abs(float(way @ along) / _SPEED - time))
            aside = max(aside, float((way - (way @ along) * along).norm()))
        curve.append((time, float(world.objects["wheel0"].root_velocity[0, :3].norm()), _SPEED))
    trial.trace("speed of a wheel on the level", "m/s", *zip(*curve, strict=True))
    downhill = [abs(value - 1) for tangent in _SLOPES for value in _down(trial, tangent)]
    return {"level": slower / 2.0, "aside": aside, "downhill": max(downhill)}


def _down(trial: Trial, tangent: float) -> tuple[float, float]:
    """Gain of speed, and of spin times radius, of a wheel down a slope in 0.5 s, over 2/3 g sin t."""
    angle = math.atan(tangent)
    world = trial.world(scene(_wheel("wheel", on_slope(angle, RADIUS)), terrain=(slope(angle, SMOOTH),)))
    wheel = world.objects["wheel"]
    trial.step(world, trial.steps(0.1))
    before = wheel.root_velocity[0].cpu().clone()
    trial.step(world, trial.steps(0.5))
    gained = wheel.root_velocity[0].cpu() - before
    # A solid cylinder has 1 + 1/2 of its mass as inertia along the slope.
    truth = 2 / 3 * G * math.sin(angle) * 0.5
    along = torch.tensor([math.cos(angle), 0.0, -math.sin(angle)])
    return float(gained[:3] @ along) / truth, float(gained[4]) * RADIUS / truth


# A coin --------------------------------------------------------------------------------------------------------------

# Thickness of the coin in metres; its radius is that of the wheels.
THICKNESS = 0.02
# Lean in rad from upright, and angular velocity in rad/s about the vertical.
_LEAN, _TURNING = 0.3, 1.5


def steady_roll(lean: float, turning: float) -> tuple[float, float]:
    """Speed of the centre (m/s) and spin about the own axis (rad/s) of a disc of 1 kg that rolls round a circle.

    It leans to the centre of the circle by ``lean`` and goes round at ``turning`` rad/s (Routh, Advanced Dynamics of a
    System of Rigid Bodies, section 244; here with the disc's thickness, as it rolls on the edge of a face). With axes
    along the path, up the disc's plane and along its axis, ``dL/dt = r x F`` about the centre of mass is linear in the
    spin w: ``W s (C w - A W c) = W v q - g (a c - h s)`` and ``v = h W s - a w``, where a is the radius, h half the
    thickness, W the turning, ``s = cos(lean)``, ``c = sin(lean)`` and ``q = a s + h c`` the height of the centre.
    """
    radius, half = RADIUS, THICKNESS / 2
    across, axial = (3 * radius**2 + THICKNESS**2) / 12, radius**2 / 2
    s, c = math.cos(lean), math.sin(lean)
    height = radius * s + half * c
    push = turning * s * (across * c + half * height) - G * (radius * c - half * s) / turning
    spin = push / (axial * s + radius * height)
    return half * turning * s - radius * spin, spin


def _rolling_coin(trial: Trial) -> Mapping[str, float]:
    """The coin moves along x at first, leaning towards y."""
    speed, spin = steady_roll(_LEAN, _TURNING)
    axis = torch.tensor([0.0, -math.cos(_LEAN), math.sin(_LEAN)])
    height = RADIUS * math.cos(_LEAN) + THICKNESS / 2 * math.sin(_LEAN)
    pose = Pose.from_euler(math.pi / 2 - _LEAN, 0.0, 0.0, (0.0, 0.0, height))
    coin = cylinder("coin", RADIUS, THICKNESS, mass=1.0, material=smooth_material(0.9), pose=pose)
    world = trial.world(scene(coin, terrain=SMOOTH_GROUND))
    thing = world.objects["coin"]
    turning = torch.tensor([0.0, 0.0, _TURNING])
    rate = spin * axis + turning - (turning @ axis) * axis
    thing.set_root_velocity(torch.cat((torch.tensor([speed, 0.0, 0.0]), rate))[None].to(world.device))
    radius = speed / _TURNING
    path, lean, curve = 0.0, 0.0, []
    for time in trial.advance(world, 2.0, every=0.05):
        pose_now = thing.root_pose[0].cpu()
        angle = _TURNING * time
        truth = torch.tensor([radius * math.sin(angle), radius * (1 - math.cos(angle)), height])
        path = max(path, float((pose_now[:3] - truth).norm()) / radius)
        own = quat_rotate(pose_now[3:], torch.tensor([0.0, 0.0, 1.0]))
        # Clamped, as rounding may leave the axis a little longer than one.
        lean = max(lean, abs(math.asin(max(-1.0, min(1.0, float(own[2])))) - _LEAN))
        curve.append((time, float(pose_now[1]), float(truth[1])))
    trial.trace("way of the coin aside", "m", *zip(*curve, strict=True))
    return {"path": path, "lean": lean}


# A turntable ---------------------------------------------------------------------------------------------------------

_TABLE_RATE = 5.0
_BALL = 0.03


def _turntable() -> RobotSpec:
    """A square table of half a metre's reach, 0.1 m high, held at its rate by a strong motor."""
    top = Shape(Box((0.5, 0.5, 0.05)), material=smooth_material(0.5))
    links = (body("base"), Link("table", 10.0, (0.0, 0.0, 0.0), np.eye(3), (top,), (top,)))
    joint = Joint("spindle", JointType.CONTINUOUS, "base", "table", Pose((0.0, 0.0, 0.05)))
    return RobotSpec(
        name="turntable",
        articulation=Articulation("turntable", links, (joint,)),
        fixed_base=True,
        actuators=(ImplicitPd(joints=(".*",), damping=1e4),),
    )


def _ball_on_turntable(trial: Trial) -> Mapping[str, float]:
    """A ball set rolling at 0.2 m/s in the world's frame, 0.1 m off the axis, goes round a circle of 0.14 m."""
    ball = marble("marble", _BALL, smooth_material(0.5), Pose((0.1, 0.0, 0.1 + _BALL)), mass=0.1)
    world = trial.world(scene(_turntable(), ball, terrain=()))
    robot, thing = world.robots["turntable"], world.objects["marble"]
    rate = torch.tensor([[_TABLE_RATE]], device=world.device)
    robot.set_velocity_targets(rate)
    robot.set_joint_state(velocities=rate)
    place, speed = torch.tensor([0.1, 0.0]), torch.tensor([0.0, 0.2])
    slip = speed - _TABLE_RATE * _quarter(place)
    # No slip: v - a spin x z = W z x r, so the horizontal spin is z x (v - W z x r) / a.
    spin = _quarter(slip) / _BALL
    thing.set_root_velocity(torch.tensor([[*speed.tolist(), 0.0, *spin.tolist(), 0.0]], device=world.device))
    # A solid ball circles at 2/7 of the table's rate, whatever its radius and its place.
    own = 2 / 7 * _TABLE_RATE
    center = place + _quarter(speed) / own
    radius = float(speed.norm()) / own
    path, curve = 0.0, []
    for time in trial.advance(world, 3.0, every=0.05):
        now = thing.root_pose[0, :2].cpu()
        turned = own * time
        arm = place - center
        truth = center + math.cos(turned) * arm + math.sin(turned) * _quarter(arm)
        path = max(path, float((now - truth).norm()) / radius)
        curve.append((time, float(now[0]), float(truth[0])))
    trial.trace("place of the ball along x", "m", *zip(*curve, strict=True))
    return {"path": path}


def _quarter(vector: Tensor) -> Tensor:
    """The vector (2,) turned by a right angle: z x vector."""
    return torch.stack((-vector[1], vector[0]))


_RADIUS, _TRACK, _CASTER = 0.1, 0.4, 0.05
# Of a wheel about its axle, kg m^2, and of its drive, N m s/rad: 50 times the inertia over a step of 5 ms.
_INERTIA, _DAMPING = 2e-3, 20.0
_BASE_SPEED = 0.5


def _base() -> RobotSpec:
    """10 kg on two driven wheels and a smooth caster behind them."""
    caster = Shape(Sphere(_CASTER), Pose((-0.2, 0.0, _CASTER - _RADIUS)), SMOOTH)
    trunk = Link("trunk", 10.0, (-0.03, 0.0, 0.0), np.diag((0.1, 0.2, 0.2)), collisions=(caster,))
    tyre = Shape(Sphere(_RADIUS), material=PhysicsMaterial(1.0, 1.0))
    moments = np.diag((0.5 * _INERTIA, _INERTIA, 0.5 * _INERTIA))
    wheels = {"left": 0.5 * _TRACK, "right": -0.5 * _TRACK}
    links = tuple(Link(name, 0.4, (0.0, 0.0, 0.0), moments, collisions=(tyre,)) for name in wheels)
    joints = tuple(
        Joint(f"{name}_axle", JointType.CONTINUOUS, "trunk", name, Pose((0.0, y, 0.0)), axis=(0.0, 1.0, 0.0))
        for name, y in wheels.items()
    )
    drive = ImplicitPd(joints=(".*",), damping=_DAMPING)
    articulation = Articulation("base", (trunk, *links), joints)
    return RobotSpec(name="base", articulation=articulation, pose=Pose((0.0, 0.0, _RADIUS)), actuators=(drive,))


def _driven(trial: Trial) -> Mapping[str, float]:
    """Command half a metre per second from rest: friction limits what a strong drive may do."""
    world = trial.world(scene(_base()))
    base = world.robots["base"]
    trial.step(world, trial.steps(0.2))
    base.set_velocity_targets(torch.full((1, 2), _BASE_SPEED / _RADIUS, device=world.device))
    times: list[float] = []
    speeds: list[float] = []
    pitch = 0.0
    for time in trial.advance(world, 1.2):
        w, _, y, _ = base.root_pose[0, 3:].tolist()
        pitch = max(pitch, abs(2.0 * math.atan2(y, w)))
        times.append(time)
        speeds.append(float(base.root_velocity[0, 0]))
    trial.trace("speed of the base", "m/s", times, speeds, [_BASE_SPEED] * len(times))
    # The first half is acceleration, limited by friction.
    later = np.array(speeds[len(speeds) // 2 :])
    return {
        "speed": abs(float(later.mean()) / _BASE_SPEED - 1.0),
        "overshoot": max(0.0, max(speeds) / _BASE_SPEED - 1.0),
        "pitch": pitch,
    }


SCENARIOS = (
    Scenario(
        name="rolling_wheel",
        group="Friction",
        question="Does a cylinder roll on without slowing on the level, and down a slope as fast as it should?",
        truth="constant v = 1 m/s in two directions; a = r alpha = 2/3 g sin at slopes of 10 and 40 %",
        source="Taylor, Classical Mechanics, section 10.4: a solid cylinder that rolls, I = m r^2 / 2",
        run=_rolling_wheel,
        judges=(Capability.FRICTION,),
        metrics=(
            Metric(
                name="level",
                unit="",
                tolerance=1e-3,
                meaning="largest error of the way within 2 s on the level, over that after 2 s",
                looser_because="a thousandth of a way is less than any wheel's slip",
            ),
            Metric(
                name="aside",
                unit="m",
                tolerance=5e-5,
                meaning="largest way off the heading within 2 s",
                looser_because="a hundredth of a millimetre in two metres is what single precision adds up to",
            ),
            Metric(name="downhill", unit="", tolerance=2e-3, meaning="largest relative error of a and r alpha"),
        ),
    ),
    Scenario(
        name="rolling_coin",
        group="Friction",
        question="Does a coin on its edge, leaning, roll round the circle of its lean and speed?",
        truth="steady rolling: lean 0.3 rad, once round in 2 pi / 1.5 s; the speed from the balance of moments",
        source="Routh, Advanced Dynamics of a System of Rigid Bodies, 6th ed., section 244",
        run=_rolling_coin,
        judges=(Capability.FRICTION,),
        metrics=(
            Metric(
                name="path",
                unit="",
                tolerance=0.4,
                meaning="largest distance of the centre from where it should be within 2 s, over the circle's radius",
            ),
            Metric(
                name="lean",
                unit="rad",
                tolerance=0.06,
                meaning="largest error of the lean within 2 s",
                looser_because=FIRST_ORDER,
            ),
        ),
    ),
    Scenario(
        name="ball_on_turntable",
        group="Friction",
        question="Does a ball that rolls on a rotating table go round in circles of its own?",
        truth="circles at 2/7 of the table's rate, wherever on the table and however fast",
        source="Weltner, American Journal of Physics 47, 1979, p. 984: stable circular orbits of freely moving balls",
        needs=(Capability.IMPLICIT_DRIVES,),
        run=_ball_on_turntable,
        judges=(Capability.FRICTION,),
        metrics=(
            Metric(
                name="path",
                unit="",
                tolerance=0.02,
                meaning="largest distance from where it should be within 3 s, over the circle's radius",
            ),
        ),
    ),
    Scenario(
        name="driven_wheels",
        group="Friction",
        question="Do light wheels under strong velocity drives drive their base, and not throw it?",
        truth="v = omega r once friction has brought the base to speed, and a trunk that stays level",
        source="Siegwart, Nourbakhsh and Scaramuzza, Introduction to Autonomous Mobile Robots, 2nd ed., section 3.2",
        run=_driven,
        needs=(Capability.FLOATING_BASE, Capability.IMPLICIT_DRIVES, Capability.FRICTION),
        metrics=(
            Metric(
                name="speed", unit="", tolerance=0.02, meaning="error of the mean speed in the second half, relative"
            ),
            Metric(
                name="overshoot",
                unit="",
                tolerance=0.01,
                meaning="speed beyond the commanded one, relative to it",
                looser_because="a hundredth of its speed is less than any base's odometry tells apart",
            ),
            Metric(
                name="pitch",
                unit="rad",
                tolerance=5e-3,
                meaning="largest tilt of the trunk",
                looser_because="a third of a degree is less than the unevenness of floors",
            ),
        ),
    ),
)
