"""Parameters that differ between environments, by what they do."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import torch
from torch import Tensor

from orbit_conformance.bodies import WEIGHTLESS, G, ball, cube, rotor, scene, slider
from orbit_conformance.scenario import FIRST_ORDER, Metric, Scenario, Trial
from orbit_core.interfaces import Capability, Object, World
from orbit_core.scene import ImplicitPd, Pose

_GROUP = "Randomised parameters"
# The rotation that takes the z axis to y.
_ON_ITS_SIDE = Pose((0.0, 0.0, 1.0), (math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0))
# Values are given out of order, so that a mix-up of environments shows.
_PLACES = torch.tensor([0, 2, 1])


def _thing(world: World, name: str) -> Object:
    return world.robots.get(name) or world.objects[name]


def _relative(measured: Tensor, truth: Tensor) -> float:
    """Largest error as part of the truth."""
    return float(((measured.cpu() - truth) / truth).abs().max())


def _mass(trial: Trial) -> Mapping[str, float]:
    masses = torch.tensor([1.0, 4.0, 0.25])
    world = trial.world(scene(cube(), gravity=WEIGHTLESS, terrain=()), num_envs=3)
    thing = _thing(world, "cube")
    thing.set_masses(masses[_PLACES][:, None].to(world.device), env_ids=_PLACES.to(world.device))
    world.reset()
    # Of the cube of 1 kg and 0.1 m: set masses scale it along.
    inertia = 0.1**2 / 6
    wrench = torch.tensor([2.0, 0.0, 0.0, 0.0, 0.0, 2.0 * inertia], device=world.device)
    thing.set_wrenches(wrench.expand(3, 1, 6))
    trial.step(world, trial.steps(0.5))
    velocity = thing.root_velocity
    return {"force": _relative(velocity[:, 0], 1.0 / masses), "torque": _relative(velocity[:, 5], 1.0 / masses)}


def _friction(trial: Trial) -> Mapping[str, float]:
    """Friction of a cube, which decides because the ground's is smaller."""
    coefficients, speed = torch.tensor([0.3, 0.9, 0.5]), 1.5
    world = trial.world(scene(cube()), num_envs=3)
    thing, ids = _thing(world, "cube"), _PLACES.to(world.device)
    thing.set_friction(coefficients[_PLACES][:, None].to(world.device), env_ids=ids)
    # The larger coefficient of a pair counts, so that the ground's must be below each cube's.
    world.set_terrain_friction(torch.full((3,), 0.1, device=world.device))
    world.reset()
    trial.step(world, trial.steps(0.2))
    start = thing.root_pose[:, 0].clone()
    thing.set_root_velocity(torch.tensor([[speed, 0, 0, 0, 0, 0]] * 3, device=world.device))
    trial.step(world, trial.steps(1.0))
    return {"distance": _relative(thing.root_pose[:, 0] - start, speed**2 / (2.0 * coefficients * G))}


def _gains(trial: Trial) -> Mapping[str, float]:
    stiffness, effort = torch.tensor([10.0, 40.0, 20.0]), 2.0
    drive = ImplicitPd(joints=(".*",), stiffness=5.0, damping=1.0)
    world = trial.world(scene(rotor(inertia=0.05, actuators=(drive,)), terrain=()), num_envs=3)
    robot, ids = world.robots["rotor"], _PLACES.to(world.device)
    # Critical damping settles fastest, so that two seconds suffice at every stiffness.
    damping = 2.0 * (0.05 * stiffness).sqrt()  # critical
    gains = [gain[_PLACES][:, None].to(world.device) for gain in (stiffness, damping)]
    _thing(world, "rotor").set_gains(gains[0], gains[1], env_ids=ids)
    world.reset()
    robot.set_effort_targets(torch.full((3, 1), effort, device=world.device))
    trial.step(world, trial.steps(2.0))
    return {"deflection": _relative(robot.joint_positions[:, 0], effort / stiffness)}


def _joints(trial: Trial) -> Mapping[str, float]:
    """Four wheels in each environment: one is damped, one rubs, one is driven, and one hangs on a spring."""
    inertia, speed, effort, seconds = 0.05, 4.0, 0.3, 0.5
    damping, friction = torch.tensor([0.05, 0.15, 0.1]), torch.tensor([0.1, 0.3, 0.2])
    armature, stiffness = torch.tensor([0.05, 0.2, 0.1]), torch.tensor([1.0, 4.0, 2.0])
    # Each wheel starts with a value that no environment is set to: one that is not written shows.
    parts = {
        "damped": rotor(inertia=inertia, damping=0.02),
        "rubbed": rotor(inertia=inertia, friction=0.05),
        "heavy": rotor(inertia=inertia, armature=0.01),
        "sprung": rotor(inertia=inertia, stiffness=3.0, damping=0.4),
    }
    wheels = [
        dataclasses.replace(wheel, name=name, pose=Pose((0.0, float(row), 0.0)))
        for row, (name, wheel) in enumerate(parts.items())
    ]
    world = trial.world(scene(*wheels, gravity=WEIGHTLESS, terrain=()), num_envs=3)
    ids, turning = _PLACES.to(world.device), torch.full((3, 1), speed, device=world.device)
    own = [values[_PLACES][:, None].to(world.device) for values in (damping, friction, armature, stiffness)]
    world.robots["damped"].set_joint_parameters(damping=own[0], env_ids=ids)
    world.robots["rubbed"].set_joint_parameters(friction=own[1], env_ids=ids)
    world.robots["heavy"].set_joint_parameters(armature=own[2], env_ids=ids)
    world.robots["sprung"].set_joint_parameters(stiffness=own[3], env_ids=ids)
    world.reset()
    for name in ("damped", "rubbed"):
        world.robots[name].set_joint_state(velocities=turning)
    for name in ("heavy", "sprung"):
        world.robots[name].set_effort_targets(torch.full((3, 1), effort, device=world.device))
    # Damped and rubbed wheels still turn after this time; at rest nothing could be told apart.
    trial.step(world, trial.steps(seconds))
    speeds = {name: world.robots[name].joint_velocities[:, 0].clone() for name in parts}
    trial.step(world, trial.steps(3.0))  # springs settle by exp(-4 t)
    return {
        "damping": _relative(speeds["damped"], speed * (-damping * seconds / inertia).exp()),
        "friction": _relative(speeds["rubbed"], speed - friction * seconds / inertia),
        "armature": _relative(speeds["heavy"], effort * seconds / (inertia + armature)),
        "stiffness": _relative(world.robots["sprung"].joint_positions[:, 0], effort / stiffness),
    }


def _limits(trial: Trial) -> Mapping[str, float]:
    """Carriages that a force pushes up to their upper limits, and then down to their lower ones."""
    lower, upper = torch.tensor([-0.1, -0.3, -0.2]), torch.tensor([0.3, 0.1, 0.2])
    # The limits of the model are wider than all that are set, so that an ignored setting shows as a longer way.
    carriage = slider(damping=20.0, lower_limit=-0.5, upper_limit=0.5)
    world = trial.world(scene(carriage, gravity=WEIGHTLESS, terrain=()), num_envs=3)
    robot, ids = world.robots["slider"], _PLACES.to(world.device)
    low, high = (values[_PLACES][:, None].to(world.device) for values in (lower, upper))
    robot.set_joint_limits(low, high, env_ids=ids)
    world.reset()
    stops: list[Tensor] = []
    for effort in (10.0, -10.0):
        robot.set_effort_targets(torch.full((3, 1), effort, device=world.device))
        trial.step(world, trial.steps(2.0))
        stops.append(robot.joint_positions[:, 0].cpu().clone())
    return {"stop": float((torch.stack(stops) - torch.stack((upper, lower))).abs().max())}


def _gravity(trial: Trial) -> Mapping[str, float]:
    # The Moon's, one in no axis of the world, and Jupiter's.
    gravity = torch.tensor([[0.0, 0.0, -1.62], [1.0, 2.0, 3.0], [0.0, 0.0, -24.8]])
    world = trial.world(scene(ball(height=10.0), terrain=()), num_envs=3)
    world.set_gravity(gravity[_PLACES].to(world.device), _PLACES.to(world.device))
    world.reset()
    trial.step(world, trial.steps(0.5))
    velocity = world.objects["ball"].root_velocity[:, :3].cpu()
    return {"velocity": float(((velocity - 0.5 * gravity).norm(dim=1) / (0.5 * gravity.norm(dim=1))).max())}


def _center_of_mass(trial: Trial) -> Mapping[str, float]:
    """A wheel about a level axis against a spring, and boxes pushed at by gravity through their shifted centres."""
    aside, stiffness = torch.tensor([0.0, 0.2, -0.1]), 30.0
    drive = ImplicitPd(joints=(".*",), stiffness=stiffness, damping=3.0)
    wheel = dataclasses.replace(rotor(inertia=0.02, actuators=(drive,)), pose=_ON_ITS_SIDE)
    world = trial.world(scene(wheel, cube(half=0.1)), num_envs=3)
    ids = _PLACES.to(world.device)

    def along_x(values: Tensor) -> Tensor:
        return torch.nn.functional.pad(values[_PLACES][:, None, None], (0, 2)).to(world.device)

    _thing(world, "rotor").set_centers_of_mass(along_x(aside), links=[1], env_ids=ids)
    _thing(world, "cube").set_centers_of_mass(along_x(torch.tensor([0.09, 0.11, -0.11])), env_ids=ids)
    world.reset()
    trial.step(world, trial.steps(2.0))
    sag = torch.zeros(3, dtype=torch.float64)
    for _ in range(100):  # k q = m g r cos(q), by iteration; the axis points along +y, so gravity turns it forwards
        sag = G * aside / stiffness * sag.cos()
    # Cosine between the cube's up axis and the world's: tipped by more than 60 degrees counts as fallen.
    upright = 1.0 - 2.0 * world.objects["cube"].root_pose[:, 4:6].cpu().square().sum(1)
    return {
        "sag": float((world.robots["rotor"].joint_positions[:, 0].cpu() - sag).abs().max()),
        "tipped": float(((upright < 0.5) != torch.tensor([False, True, True])).float().mean()),
    }


_SINGLE = "engines of single precision round each step"
_NEWTON = "Goldstein, Classical Mechanics, 3rd ed., section 1.1"

SCENARIOS = (
    Scenario(
        name="mass_per_environment",
        group=_GROUP,
        question="Does a heavier body accelerate less?",
        truth="v = F t / m, and as much of its spin, its inertia growing with its mass",
        source=_NEWTON,
        judges=(Capability.RANDOMIZE_MASS,),
        run=_mass,
        needs=(Capability.RANDOMIZE_MASS, Capability.EXTERNAL_WRENCHES),
        metrics=(
            Metric(
                name="force",
                unit="",
                tolerance=1e-5,
                meaning="largest error of a velocity, as a part of it",
                looser_because=_SINGLE,
            ),
            Metric(
                name="torque",
                unit="",
                tolerance=1e-4,
                meaning="largest error of a spin, as a part of it",
                looser_because=_SINGLE,
            ),
        ),
    ),
    Scenario(
        name="friction_per_environment",
        group=_GROUP,
        question="Does a rougher body slide less far?",
        truth="v^2 / (2 mu g)",
        source="Beer and Johnston, Vector Mechanics for Engineers: Statics, 12th ed., section 8.1",
        judges=(Capability.RANDOMIZE_FRICTION,),
        run=_friction,
        needs=(Capability.RANDOMIZE_FRICTION,),
        metrics=(
            Metric(
                name="distance", unit="", tolerance=0.05, meaning="largest error, of first order in the step: v dt / 2"
            ),
        ),
    ),
    Scenario(
        name="gains_per_environment",
        group=_GROUP,
        question="Does a stiffer drive give way less?",
        truth="q = tau / k",
        source="Ogata, Modern Control Engineering, 5th ed., section 5.3",
        judges=(Capability.RANDOMIZE_GAINS,),
        run=_gains,
        needs=(Capability.RANDOMIZE_GAINS, Capability.IMPLICIT_DRIVES),
        metrics=(
            Metric(
                name="deflection",
                unit="",
                tolerance=1e-4,
                meaning="largest error, as a part of it",
                looser_because=_SINGLE,
            ),
        ),
    ),
    Scenario(
        name="joints_per_environment",
        group=_GROUP,
        question="Do joints slow down, speed up and give way by their own damping, friction, armature and springs?",
        truth="w exp(-d t / I); w - f t / I; tau t / (I + a); tau / k",
        source=_NEWTON,
        judges=(Capability.RANDOMIZE_JOINTS,),
        run=_joints,
        needs=(
            Capability.RANDOMIZE_JOINTS,
            Capability.JOINT_DAMPING,
            Capability.JOINT_FRICTION,
            Capability.ARMATURE,
            Capability.JOINT_SPRINGS,
        ),
        metrics=(
            Metric(
                name="damping",
                unit="",
                tolerance=0.03,
                meaning="largest error of a speed, as a part of it",
                looser_because=FIRST_ORDER,
            ),
            Metric(
                name="friction",
                unit="",
                tolerance=1e-3,
                meaning="largest error of a speed, as a part of it",
                looser_because=_SINGLE,
            ),
            Metric(
                name="armature",
                unit="",
                tolerance=1e-4,
                meaning="largest error of a speed, as a part of it",
                looser_because=_SINGLE,
            ),
            Metric(
                name="stiffness",
                unit="",
                tolerance=1e-4,
                meaning="largest error of a spring's angle, as a part of it",
                looser_because=_SINGLE,
            ),
        ),
    ),
    Scenario(
        name="limits_per_environment",
        group=_GROUP,
        question="Does a joint stop at the limits of its own environment?",
        truth="the position is the limit",
        source=_NEWTON,
        judges=(Capability.RANDOMIZE_LIMITS,),
        run=_limits,
        needs=(Capability.RANDOMIZE_LIMITS, Capability.JOINT_DAMPING),
        metrics=(
            Metric(
                name="stop",
                unit="m",
                tolerance=5e-4,
                meaning="largest way of a joint at rest from its limit",
                looser_because="a soft stop gives way by 0.2 mm",
            ),
        ),
    ),
    Scenario(
        name="gravity_per_environment",
        group=_GROUP,
        question="Do things fall faster under more gravity, and where it points?",
        truth="v = g t",
        source=_NEWTON,
        judges=(Capability.RANDOMIZE_GRAVITY,),
        run=_gravity,
        needs=(Capability.RANDOMIZE_GRAVITY,),
        metrics=(
            Metric(
                name="velocity",
                unit="",
                tolerance=1e-5,
                meaning="largest error, as a part of it",
                looser_because=_SINGLE,
            ),
        ),
    ),
    Scenario(
        name="center_of_mass_per_environment",
        group=_GROUP,
        question="Does a shifted centre of mass turn a wheel and tip a box?",
        truth="k q = m g r cos(q) for the wheel; a box tips once its centre is beyond its edge",
        source="Beer and Johnston, Vector Mechanics for Engineers: Statics, 12th ed., chapter 4",
        judges=(Capability.RANDOMIZE_CENTER_OF_MASS,),
        run=_center_of_mass,
        needs=(Capability.RANDOMIZE_CENTER_OF_MASS, Capability.IMPLICIT_DRIVES),
        metrics=(
            Metric(
                name="sag",
                unit="rad",
                tolerance=1e-4,
                meaning="largest error of the wheel's angle",
                looser_because=_SINGLE,
            ),
            Metric(
                name="tipped", unit="", tolerance=0.0, meaning="part of the boxes that lie and should stand, or reverse"
            ),
        ),
    ),
)
