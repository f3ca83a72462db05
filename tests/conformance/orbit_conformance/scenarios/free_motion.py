"""Bodies, and chains of bodies, that nothing touches."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from torch import Tensor

from orbit_conformance.bodies import WEIGHTLESS, G, ball, body, cube, scene
from orbit_conformance.reference import FloatArray, euler_equations, trajectory
from orbit_conformance.scenario import SINGLE, Metric, Scenario, Trial
from orbit_core.dynamics.transforms import quat_rotate, quat_rotate_inverse
from orbit_core.interfaces import Object
from orbit_core.scene import (
    Articulation,
    Box,
    Cylinder,
    IdealPd,
    Joint,
    JointType,
    ObjectSpec,
    Pose,
    RobotSpec,
    Shape,
    single_link,
)


@dataclass(frozen=True)
class Momenta:
    """Momenta of all links of a thing together, in double precision, about the environment's origin."""

    mass: float
    """kg of all links together."""
    center: Tensor
    """Centre of mass (N, 3) in m."""
    linear: Tensor
    """Linear momentum (N, 3) in kg m/s."""
    angular: Tensor
    """Angular momentum (N, 3) in kg m^2/s about the centre of mass."""
    energy: Tensor
    """Kinetic energy (N,) in J."""


def momenta(thing: Object) -> Momenta:
    """The momenta, computed from poses and velocities of the links alone."""
    links = thing.spec.articulation.links
    poses, velocities = thing.link_poses.double().cpu(), thing.link_velocities.double().cpu()
    masses = torch.tensor([link.mass for link in links], dtype=torch.float64)[:, None]
    inertias = torch.stack([torch.as_tensor(link.inertia) for link in links])
    offsets = torch.tensor([link.center_of_mass for link in links], dtype=torch.float64)
    spins, turned = velocities[..., 3:], poses[..., 3:]
    # Velocities are those of link origins; momenta need those of the centres of mass.
    levers = quat_rotate(turned, offsets.expand_as(spins))
    centers = poses[..., :3] + levers
    speeds = velocities[..., :3] + torch.linalg.cross(spins, levers)
    # Inertias are constant in the link's frame: rotate the spin into it and the momentum back.
    own = quat_rotate(turned, (inertias @ quat_rotate_inverse(turned, spins)[..., None])[..., 0])
    mass = float(masses.sum())
    center, linear = (masses * centers).sum(-2) / mass, (masses * speeds).sum(-2)
    angular = (own + torch.linalg.cross(centers - center[:, None], masses * speeds)).sum(-2)
    energy = 0.5 * (masses * speeds * speeds + own * spins).sum((-2, -1))
    return Momenta(mass, center, linear, angular, energy)


def _skew(name: str, mass: float, moments: tuple[float, float, float], pose: Pose) -> ObjectSpec:
    """A body whose principal axes and centre of mass are askew in its link."""
    # Any rotation off the axes will do: an engine that ignores products of inertia fails.
    axes = Pose.from_euler(0.4, -0.7, 1.1).rotation_matrix()
    shape = Shape(Box((0.05, 0.08, 0.03)))
    articulation = single_link(name, shape, mass, axes @ np.diag(moments) @ axes.T, (0.03, -0.02, 0.01))
    return ObjectSpec(name=name, articulation=articulation, pose=pose)


def _cylinder(name: str, pose: Pose) -> ObjectSpec:
    """A cylinder of 2 kg, 0.1 m across and 0.3 m long."""
    side = 2.0 * (3 * 0.05**2 + 0.3**2) / 12
    inertia = np.diag([side, side, 0.5 * 2.0 * 0.05**2])
    return ObjectSpec(name=name, articulation=single_link(name, Shape(Cylinder(0.05, 0.15)), 2.0, inertia), pose=pose)


# Under gravity -------------------------------------------------------------------------------------------------------


def _free_fall(trial: Trial) -> Mapping[str, float]:
    height = 10.0
    # 500 times the mass of the ball: gravity must not depend on it.
    heavy = cube(mass=50.0, pose=Pose((1.0, 0.0, height)))
    world = trial.world(scene(ball(mass=0.1, height=height), heavy, terrain=()))
    positions, speeds, times = [], [], []
    for time in trial.advance(world, 1.0, every=0.1):
        times.append(time)
        positions.append([body.root_pose[0, 2].item() for body in world.objects.values()])
        speeds.append([body.root_velocity[0, 2].item() for body in world.objects.values()])
    time = torch.tensor(times)[:, None]
    heights, truth = torch.tensor(positions), height - 0.5 * G * time**2
    trial.trace("height", "m", times, heights[:, 0].tolist(), truth[:, 0].tolist())
    return {
        "position": float((heights - truth).abs().max()),
        "velocity": float((torch.tensor(speeds) + G * time).abs().max()),
    }


def _projectile(trial: Trial) -> Mapping[str, float]:
    """Thrown with the same speed of the centre of mass, one not spinning and one spinning about an axis aside."""
    speed = torch.tensor([3.0, -1.0, 4.0])
    plain = cube("plain", pose=Pose((0.0, 0.0, 5.0)))
    spinning = cube("spinning", pose=Pose((-0.04, 2.0, 5.0)), center_of_mass=(0.04, 0.0, 0.0))
    world = trial.world(scene(plain, spinning, terrain=()))
    spin = torch.tensor([4.0, 6.0, -3.0])
    # The origin's velocity that gives the centre of mass the same speed as the plain cube's.
    slip = torch.linalg.cross(spin, torch.tensor([-0.04, 0.0, 0.0]))
    world.objects["plain"].set_root_velocity(torch.cat((speed, torch.zeros(3)))[None].to(world.device))
    world.objects["spinning"].set_root_velocity(torch.cat((speed + slip, spin))[None].to(world.device))
    error = {"range": 0.0, "height": 0.0, "spin": 0.0}
    paths = []
    for time in trial.advance(world, 1.0, every=0.05):
        for name, rate, aside in (("plain", torch.zeros(3), 0.0), ("spinning", spin, 2.0)):
            thing = world.objects[name]
            start = torch.tensor([0.0, aside, 5.0])
            truth = start + speed * time + 0.5 * torch.tensor([0.0, 0.0, -G]) * time**2
            apart = (momenta(thing).center[0] - truth).abs()
            error["range"] = max(error["range"], float(apart[:2].max()))
            error["height"] = max(error["height"], float(apart[2]))
            error["spin"] = max(error["spin"], float((thing.root_velocity[0, 3:].cpu() - rate).norm()))
        paths.append((time, float(momenta(world.objects["spinning"]).center[0, 2]), float(truth[2])))
    trial.trace("height of the spinning cube", "m", *zip(*paths, strict=True))
    return error


# Free rotation -------------------------------------------------------------------------------------------------------


def _spinning_bodies(trial: Trial) -> Mapping[str, float]:
    things = (
        cube("box", mass=2.0, pose=Pose((-1.0, 0.0, 0.0))),
        _cylinder("cylinder", Pose.from_euler(0.3, 0.5, 0.0)),
        _skew("asymmetric", 3.0, (0.01, 0.02, 0.025), Pose.from_euler(0.2, -0.4, 0.9, (1.0, 0.0, 0.0))),
    )
    world = trial.world(scene(*things, gravity=WEIGHTLESS, terrain=()))
    for thing in world.objects.values():
        thing.set_root_velocity(torch.tensor([[0.1, 0.2, -0.1, 3.0, 4.0, -2.0]], device=world.device))
    before = {name: momenta(thing) for name, thing in world.objects.items()}
    error = {"angular_momentum": 0.0, "energy": 0.0, "path": 0.0}
    energies = []
    for time in trial.advance(world, 2.0, every=0.1):
        for name, thing in world.objects.items():
            now, then = momenta(thing), before[name]
            turned = float((now.angular - then.angular).norm() / then.angular.norm())
            path = then.center + then.linear / then.mass * time
            error["angular_momentum"] = max(error["angular_momentum"], turned)
            error["energy"] = max(error["energy"], abs(float(now.energy / then.energy) - 1))
            error["path"] = max(error["path"], float((now.center - path).norm()))
            if name == "asymmetric":
                energies.append((time, float(now.energy), float(then.energy)))
    trial.trace("energy of the asymmetric body", "J", *zip(*energies, strict=True))
    return error


_MOMENTS = (0.01, 0.02, 0.03)
# Angular velocity in rad/s about the principal axes: a tilt of about half a degree.
_TURN = (0.05, 5.0, 0.05)
_TUMBLE = 4.0


@cache
def _tumbling(times: tuple[float, ...]) -> FloatArray:
    return trajectory(euler_equations(_MOMENTS), np.array([1.0, 0.0, 0.0, 0.0, *_TURN]), times)


def _intermediate_axis(trial: Trial) -> Mapping[str, float]:
    articulation = single_link("plate", Shape(Box((0.1, 0.07, 0.02))), 1.0, np.diag(_MOMENTS))
    plate = ObjectSpec(name="plate", articulation=articulation)
    world = trial.world(scene(plate, gravity=WEIGHTLESS, terrain=()))
    thing = world.objects["plate"]
    thing.set_root_velocity(torch.tensor([[0.0, 0.0, 0.0, *_TURN]], device=world.device))
    times, along, spins = [], [], []
    for time in trial.advance(world, _TUMBLE, every=0.02):
        pose, velocity = thing.root_pose[0].cpu(), thing.root_velocity[0].cpu()
        times.append(time)
        along.append(quat_rotate(pose[3:], torch.tensor([0.0, 1.0, 0.0])).tolist())
        # Spin in the body's axes, where Euler's equations hold.
        spins.append(quat_rotate_inverse(pose[3:], velocity[3:])[1].item())
    truth = _tumbling(tuple(times))
    axis = quat_rotate(torch.as_tensor(truth[:, :4]), torch.tensor([[0.0, 1.0, 0.0]], dtype=torch.float64))
    # The chord between two unit vectors keeps its precision at small angles, where an arc cosine has none.
    apart = torch.linalg.vector_norm(torch.tensor(along, dtype=torch.float64) - axis, dim=-1)
    trial.trace("spin about the intermediate axis", "rad/s", times, spins, truth[:, 5].tolist())
    flip, expected = _first_zero(times, spins), _first_zero(times, truth[:, 5].tolist())
    return {"flip_time": abs(flip / expected - 1), "axis": float(2 * torch.arcsin(apart.max() / 2))}


def _first_zero(times: list[float], values: list[float]) -> float:
    """The time at which a curve first changes its sign, by linear interpolation; NaN if never."""
    for (t, a), (u, b) in zip(zip(times, values, strict=True), zip(times[1:], values[1:], strict=True), strict=False):
        if a > 0 >= b:
            return t + (u - t) * a / (a - b)
    return math.nan


# A chain in free flight ----------------------------------------------------------------------------------------------


def _chain(name: str, x: float) -> RobotSpec:
    """Four unequal links on hinges about different axes, motors in them, nothing fixed."""
    # Axes in different directions couple all six components of the momenta.
    axes = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.6, 0.0, 0.8))
    links = [body("trunk", 3.0, (0.02, 0.0, 0.0), 0.05)]
    links += [body(f"link{i}", 1.0 / (i + 1), (0.15, 0.0, 0.02), 0.01 / (i + 1)) for i in range(3)]
    joints = [
        Joint(f"hinge{i}", JointType.CONTINUOUS, links[i].name, links[i + 1].name, Pose((0.3 if i else 0.1, 0.0, 0.0)),
              axis=axis)
        for i, axis in enumerate(axes)
    ]  # fmt: skip
    articulation = Articulation(name, tuple(links), tuple(joints))
    return RobotSpec(
        name=name, articulation=articulation, actuators=(IdealPd(joints=(".*",)),), pose=Pose((x, 0.0, 0.0))
    )


def _floating_chain(trial: Trial) -> Mapping[str, float]:
    world = trial.world(scene(_chain("passive", 0.0), _chain("driven", 3.0), gravity=WEIGHTLESS, terrain=()))
    for robot in world.robots.values():
        robot.set_root_velocity(torch.tensor([[0.2, -0.1, 0.3, 0.5, -0.4, 0.6]], device=world.device))
        robot.set_joint_state(velocities=torch.tensor([[2.0, -3.0, 1.5]], device=world.device))
    # Internal efforts change the energy, so that only the passive chain is held to that.
    world.robots["driven"].set_effort_targets(torch.tensor([[0.04, -0.03, 0.02]], device=world.device))
    before = {name: momenta(robot) for name, robot in world.robots.items()}
    error = {"linear_momentum": 0.0, "angular_momentum": 0.0, "path": 0.0, "energy": 0.0}
    energies = []
    for time in trial.advance(world, 2.0, every=0.1):
        for name, robot in world.robots.items():
            now, then = momenta(robot), before[name]
            path = then.center + then.linear / then.mass * time
            pushed = float((now.linear - then.linear).norm() / then.linear.norm())
            turned = float((now.angular - then.angular).norm() / then.angular.norm())
            error["linear_momentum"] = max(error["linear_momentum"], pushed)
            error["angular_momentum"] = max(error["angular_momentum"], turned)
            error["path"] = max(error["path"], float((now.center - path).norm()))
        now, then = momenta(world.robots["passive"]), before["passive"]
        error["energy"] = max(error["energy"], abs(float(now.energy / then.energy) - 1))
        energies.append((time, float(now.energy), float(then.energy)))
    trial.trace("energy of the passive chain", "J", *zip(*energies, strict=True))
    return error


_TURNED = "integrators of first order err in proportion to the time step; the best turns bodies by their momentum"

SCENARIOS = (
    Scenario(
        name="free_fall",
        group="Free motion",
        question="Do bodies of any mass fall as Galileo says?",
        truth="z = h - g t^2 / 2, v = -g t",
        source="Goldstein, Classical Mechanics, 3rd ed., section 1.1",
        run=_free_fall,
        metrics=(
            Metric(
                name="position",
                unit="m",
                tolerance=0.026,
                meaning="largest distance from the parabola within one second",
            ),
            Metric(
                name="velocity",
                unit="m/s",
                tolerance=1e-4,
                meaning="largest distance from -g t within one second",
                looser_because=SINGLE,
            ),
        ),
    ),
    Scenario(
        name="projectile",
        group="Free motion",
        question="Does the centre of mass of a thrown body follow a parabola, however the body spins?",
        truth="r = r0 + v0 t + g t^2 / 2; a cube's spin stays as it is about any axis",
        source="Goldstein, Classical Mechanics, 3rd ed., sections 1.2 and 5.6",
        run=_projectile,
        metrics=(
            Metric(
                name="range",
                unit="m",
                tolerance=1e-4,
                meaning="largest horizontal distance from the parabola",
                looser_because=SINGLE,
            ),
            Metric(name="height", unit="m", tolerance=0.026, meaning="largest vertical distance from the parabola"),
            Metric(
                name="spin",
                unit="rad/s",
                tolerance=1e-4,
                meaning="largest change of a cube's spin",
                looser_because=SINGLE,
            ),
        ),
    ),
    Scenario(
        name="spinning_bodies",
        group="Free motion",
        question="Do a box, a cylinder and an asymmetric body that spin freely keep angular momentum and energy?",
        truth="L and T are constant, the centre of mass goes straight on",
        source="Landau and Lifshitz, Mechanics, 3rd ed., sections 33 and 35",
        run=_spinning_bodies,
        metrics=(
            Metric(
                name="angular_momentum",
                unit="",
                tolerance=0.015,
                meaning="largest change over 2 s, relative",
                looser_because=_TURNED,
            ),
            Metric(
                name="energy",
                unit="",
                tolerance=2.5e-3,
                meaning="largest change of kinetic energy over 2 s, relative",
                looser_because=_TURNED,
            ),
            Metric(
                name="path",
                unit="m",
                tolerance=1e-4,
                meaning="largest distance of a centre of mass from its line",
                looser_because=SINGLE,
            ),
        ),
    ),
    Scenario(
        name="intermediate_axis",
        group="Free motion",
        question="Does a body that spins about its intermediate axis flip over when it should?",
        truth="Euler's equations, integrated at 1 ms in double precision with fourth order",
        source="Landau and Lifshitz, Mechanics, 3rd ed., section 37",
        run=_intermediate_axis,
        metrics=(
            Metric(
                name="flip_time",
                unit="",
                tolerance=0.0075,
                meaning="time of the first flip, relative",
                looser_because=_TURNED,
            ),
            Metric(
                name="axis",
                unit="rad",
                tolerance=0.06,
                meaning="largest angle between the axis and the true one, 4 s",
                looser_because=_TURNED,
            ),
        ),
    ),
    Scenario(
        name="floating_chain",
        group="Free motion",
        question="Does a free chain of links keep its momenta while its joints move, freely and by motors?",
        truth="P and L are constant, motors inside change neither; T is constant without them",
        source="Goldstein, Classical Mechanics, 3rd ed., section 1.2",
        run=_floating_chain,
        metrics=(
            Metric(name="linear_momentum", unit="", tolerance=1e-5, meaning="largest change over 2 s, relative"),
            Metric(name="angular_momentum", unit="", tolerance=0.01, meaning="largest change over 2 s, relative"),
            Metric(
                name="path", unit="m", tolerance=8e-5, meaning="largest distance of the centre of mass from its line"
            ),
            Metric(
                name="energy", unit="", tolerance=4e-3, meaning="largest change of kinetic energy over 2 s, relative"
            ),
        ),
    ),
)
