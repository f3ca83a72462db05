"""Friction that resists turning: about a contact's normal, against rolling, and of faces that turn flat."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch

from orbit_assets.objects import cylinder
from orbit_conformance.bodies import SMOOTH_GROUND, G, block, fixed, marble, scene, smooth_material
from orbit_conformance.reference import trajectory
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_conformance.scenarios.grasp import gripper
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import Capability, World
from orbit_core.scene import Box, ObjectSpec, PhysicsMaterial, Pose, Shape, Sphere, single_link

# Friction that is asked for ------------------------------------------------------------------------------------------

# Coefficients in metres: four and fifty times a material's defaults.
_TORSIONAL, _ROLLING = 0.02, 0.005
_RADIUS, _DOME = 0.05, 0.5


def _spinning_on_domes(trial: Trial) -> Mapping[str, float]:
    """A ball, a box and a cylinder that spin on the tops of wide domes, which each touches in one point."""
    material = PhysicsMaterial(0.5, 0.5, _TORSIONAL, 0.0)
    tops = {"ball": 0.4 * _RADIUS**2, "box": (2 * _RADIUS) ** 2 / 6, "cylinder": 0.5 * _RADIUS**2}
    at = [Pose((1.5 * number, 0.0, _DOME + _RADIUS)) for number in range(len(tops))]
    things = (
        marble("ball", _RADIUS, material, at[0]),
        block("box", 2 * _RADIUS, material, at[1]),
        cylinder("cylinder", _RADIUS, 2 * _RADIUS, mass=1.0, material=material, pose=at[2]),
    )
    # On a dome even a box touches in one point, so that only torsional friction can slow its spin.
    domes = [
        fixed(f"dome{number}", Sphere(_DOME), Pose((1.5 * number, 0.0, 0.0)), smooth_material())
        for number in range(len(tops))
    ]
    world = trial.world(scene(*things, *domes, terrain=()))
    trial.step(world, trial.steps(0.3))
    # Fast enough that none stops within the time.
    spin, time = 60.0, 0.2
    for name in tops:
        world.objects[name].set_root_velocity(torch.tensor([[0.0, 0.0, 0.0, 0.0, 0.0, spin]], device=world.device))
    trial.step(world, trial.steps(time))
    lost = {name: spin - float(world.objects[name].root_velocity[0, 5]) for name in tops}
    return {name: abs(lost[name] / (_TORSIONAL * G / inertia * time) - 1) for name, inertia in tops.items()}


def _rolling_out(trial: Trial) -> Mapping[str, float]:
    """A ball and a wheel that roll on the level: ``a = mu g r / (r^2 + I / m)``."""
    material = PhysicsMaterial(1.0, 1.0, 0.0, _ROLLING)
    # The cylinder's axis, z in its frame, is turned to lie across the direction of travel.
    wheel = Pose.from_euler(-math.pi / 2, 0.0, 0.0, (0.0, 1.0, _RADIUS))
    things = (
        marble("ball", _RADIUS, material, Pose((0.0, 0.0, _RADIUS))),
        cylinder("wheel", _RADIUS, 0.04, mass=1.0, material=material, pose=wheel),
    )
    world = trial.world(scene(*things, terrain=SMOOTH_GROUND))
    trial.step(world, trial.steps(0.1))
    speed, time = 1.0, 0.5
    for thing in world.objects.values():
        rolling = torch.tensor([[speed, 0.0, 0.0, 0.0, speed / _RADIUS, 0.0]], device=world.device)
        thing.set_root_velocity(rolling)
    trial.step(world, trial.steps(time))
    # m r^2 / (m r^2 + I): the share of the resisting moment that slows the centre.
    shares = {"ball": 5 / 7, "wheel": 2 / 3}
    lost = {name: speed - float(world.objects[name].root_velocity[0, 0]) for name in shares}
    return {name: abs(lost[name] / (share * _ROLLING * G / _RADIUS * time) - 1) for name, share in shares.items()}


# In a grip -----------------------------------------------------------------------------------------------------------

# Distance in metres of the bar's centre of mass from the grip, its mass in kg, and its inertia in kg m^2.
_LEVER, _BAR_MASS, _BAR_INERTIA = 0.05, 0.2, 5e-4
# Torsional friction of the fingers' round tips, in metres.
_TIP = 0.005
# Ratio in each environment of the weight's torque to the torque that both fingers resist: ``m g l / (2 mu F)``.
_LOADS = (0.5, 0.8, 0.95, 1.25, 2.0)


def _held_bar(trial: Trial, torsional: float, forces: tuple[float, ...]) -> World:
    """A bar along x, gripped at one end along y by two round tips, at rest and level; an environment for each force."""
    material = PhysicsMaterial(1.0, 1.0, torsional, 0.0)
    half = 0.03
    shape = Shape(Box((0.02, half, 0.01)), material=material)
    articulation = single_link("bar", shape, _BAR_MASS, np.eye(3) * _BAR_INERTIA, (_LEVER, 0.0, 0.0))
    bar = ObjectSpec(name="bar", articulation=articulation, pose=Pose((0.0, 0.0, half)))
    world = trial.world(scene(gripper(material, Sphere(0.01)), bar, terrain=()), len(forces))
    efforts = torch.tensor(forces, device=world.device)[:, None].expand(-1, 2)
    world.robots["gripper"].set_effort_targets(efforts, [1, 2])
    thing = world.objects["bar"]
    pose, still = thing.root_pose.clone(), torch.zeros(len(forces), 6, device=world.device)
    for _ in range(trial.steps(0.1)):  # a hand holds it until the fingers have closed
        trial.step(world)
        thing.set_root_pose(pose)
        thing.set_root_velocity(still)
    return world


def _dip(world: World) -> torch.Tensor:
    """Angle (N,) in rad by which the bar points below the horizontal."""
    ahead = torch.tensor([1.0, 0.0, 0.0], device=world.device).expand(world.num_envs, 3)
    along = quat_rotate(world.objects["bar"].root_pose[:, 3:], ahead)
    return torch.atan2(-along[:, 2], along[:, 0]).double().cpu()


def _swing(resisting: float, time: float) -> float:
    """Angle below the level after ``time`` of a bar about its end under its weight and a constant torque against it."""
    inertia, torque = _BAR_INERTIA + _BAR_MASS * _LEVER**2, _BAR_MASS * G * _LEVER

    def derivative(state: np.ndarray) -> np.ndarray:
        return np.array([state[1], (torque * math.cos(state[0]) - resisting) / inertia])

    return float(trajectory(derivative, np.zeros(2), [time])[0, 0])


def _torsional_grip(trial: Trial) -> Mapping[str, float]:
    torque = _BAR_MASS * G * _LEVER
    world = _held_bar(trial, _TIP, tuple(torque / (2 * _TIP * load) for load in _LOADS))
    time, held = 0.15, torch.tensor(_LOADS) < 1
    trial.step(world, trial.steps(time))
    # Loads above one turn from the start; the time is short, so that the bar is still far from hanging.
    turned = _dip(world)
    truth = torch.tensor([_swing(torque / load, time) for load in _LOADS if load > 1], dtype=torch.float64)
    trial.step(world, trial.steps(0.35))
    # Bars that should hold may settle first, and must then stand still.
    creep = (_dip(world) - turned)[held].abs() / 0.35
    return {"creep": float(creep.max()), "turning": float((turned[~held] / truth - 1).abs().max())}


def _pivot(trial: Trial) -> Mapping[str, float]:
    """Tips without torsional friction: the bar swings as a pendulum about the grip."""
    world = _held_bar(trial, 0.0, (10.0,))
    thing = world.objects["bar"]
    start = thing.root_pose[0, :3].cpu().clone()
    error, slip, curve = 0.0, 0.0, []
    for time in trial.advance(world, 0.25, every=0.01):
        angle, truth = float(_dip(world)[0]), _swing(0.0, time)
        error = max(error, abs(angle - truth))
        slip = max(slip, float((thing.root_pose[0, :3].cpu() - start).norm()))
        curve.append((time, angle, truth))
    trial.trace("angle below the level", "rad", *zip(*curve, strict=True))
    return {"angle": error, "slip": slip}


# Faces that turn flat ------------------------------------------------------------------------------------------------

# Headings in rad, from along an axis of the world to across it.
_HEADINGS = tuple(math.pi / 8 * number for number in range(5))


def _spin_down(trial: Trial) -> Mapping[str, float]:
    """Boxes, one heading in each environment, spin on the spot; then others slide and spin at once."""
    count, friction, spin, speed = len(_HEADINGS), 0.4, 12.0, 0.8
    # The first environments spin on the spot, the others slide as well; each at another heading to the world's axes.
    thing = block("box", 0.1, smooth_material(friction), Pose((0.0, 0.0, 0.05)))
    world = trial.world(scene(thing, terrain=SMOOTH_GROUND), 2 * count)
    box, headings = world.objects["box"], torch.tensor(_HEADINGS * 2, device=world.device)
    pose = box.root_pose.clone()
    pose[:, 3], pose[:, 6] = (headings / 2).cos(), (headings / 2).sin()
    box.set_root_pose(pose)
    trial.step(world, trial.steps(0.1))
    before = box.root_pose.clone()
    velocity = torch.zeros(2 * count, 6, device=world.device)
    velocity[:, 5] = spin
    velocity[count:, 0], velocity[count:, 1] = speed * headings[count:].cos(), speed * headings[count:].sin()
    box.set_root_velocity(velocity)
    turned = torch.zeros(2 * count, device=world.device)
    for _ in trial.advance(world, 0.6):
        # The sum of velocities, not the angle: a box may turn by more than half a turn.
        turned += trial.time_step * box.root_velocity[:, 5]
    slid = (box.root_pose - before)[:, :2].norm(dim=-1)
    spread = [_spread(turned[:count]), _spread(turned[count:])]
    return {
        "angle": max(spread),
        "way": _spread(slid[count:]),
        "wander": float(slid[:count].max()),
    }


def _spread(values: torch.Tensor) -> float:
    """Greatest distance of a value from the mean, relative."""
    return float((values / values.mean() - 1).abs().max())


_KNOWN_TO = "coefficients of friction are hardly ever known as well; the best engines err by rounding alone"
_LAW = "Johnson, Contact Mechanics, sections 8.3 and 8.4, with the law of PhysicsMaterial"

SCENARIOS = (
    Scenario(
        name="requested_torsional_friction",
        group="Friction",
        question="Does the torsional friction that a material asks for slow what spins on one point, of any shape?",
        truth="I d(omega)/dt = -mu m g on the top of a dome, mu = 20 mm",
        source=_LAW,
        needs=(Capability.TORSIONAL_FRICTION,),
        judges=(Capability.TORSIONAL_FRICTION,),
        run=_spinning_on_domes,
        metrics=tuple(
            Metric(
                name=name,
                unit="",
                tolerance=0.01,
                meaning=f"relative error of a {name}'s deceleration",
                looser_because=_KNOWN_TO,
            )
            for name in ("ball", "box", "cylinder")
        ),
    ),
    Scenario(
        name="requested_rolling_friction",
        group="Friction",
        question="Does the rolling friction that a material asks for slow a ball and a wheel?",
        truth="a = mu g r / (r^2 + I / m), mu = 5 mm",
        source=_LAW,
        needs=(Capability.ROLLING_FRICTION,),
        judges=(Capability.ROLLING_FRICTION,),
        run=_rolling_out,
        metrics=tuple(
            Metric(
                name=name,
                unit="",
                tolerance=0.015,
                meaning=f"relative error of a {name}'s deceleration",
                looser_because=_KNOWN_TO,
            )
            for name in ("ball", "wheel")
        ),
    ),
    Scenario(
        name="torsional_grip",
        group="Grasp",
        question="Do two round fingers keep a bar, held at its end, from turning up to the torque that they resist?",
        truth="it holds while m g l < 2 mu F, mu = 5 mm, and turns as I a = m g l cos - 2 mu F beyond",
        source=_LAW,
        needs=(Capability.TORSIONAL_FRICTION, Capability.IMPLICIT_DRIVES),
        judges=(Capability.TORSIONAL_FRICTION,),
        run=_torsional_grip,
        metrics=(
            Metric(
                name="creep",
                unit="rad/s",
                tolerance=0.01,
                meaning="largest speed at which it turns at loads m g l / (2 mu F) of 0.5, 0.8 and 0.95",
                looser_because="half a degree a second is unseen; the best is at rounding error",
            ),
            Metric(
                name="turning",
                unit="",
                tolerance=0.05,
                meaning="largest relative error of the angle after 0.15 s at loads of 1.25 and 2",
            ),
        ),
    ),
    Scenario(
        name="pivot_in_a_grip",
        group="Grasp",
        question="Does a bar that two fingers hold at its end without torsional friction swing as a pendulum?",
        truth="I a = m g l cos about the fingers, which it does not slip from",
        source="Landau and Lifshitz, Mechanics, 3rd ed., section 11",
        needs=(Capability.IMPLICIT_DRIVES,),
        run=_pivot,
        metrics=(
            Metric(name="angle", unit="rad", tolerance=0.05, meaning="largest error of the angle within 0.25 s"),
            Metric(name="slip", unit="m", tolerance=4e-4, meaning="longest way of the grip within 0.25 s"),
        ),
    ),
    Scenario(
        name="spin_down",
        group="Friction",
        question="Does a box that turns flat on the ground, on the spot or sliding, come as far whatever its heading?",
        truth="five headings, from along an axis of the world to across it, turn and slide alike",
        source="Goyal, Ruina and Papadopoulos, Wear 143, 1991, p. 307: planar sliding with dry friction is isotropic",
        judges=(Capability.FRICTION,),
        run=_spin_down,
        metrics=(
            Metric(
                name="angle",
                unit="",
                tolerance=0.01,
                meaning="largest relative deviation of the angle turned",
                looser_because=_KNOWN_TO,
            ),
            Metric(
                name="way",
                unit="",
                tolerance=0.01,
                meaning="the same of the way slid while it turns",
                looser_because=_KNOWN_TO,
            ),
            Metric(
                name="wander",
                unit="m",
                tolerance=1e-4,
                meaning="longest way of a box that turned on the spot",
                looser_because="a tenth of a millimetre is unseen; the best is at rounding error",
            ),
        ),
    ),
)
