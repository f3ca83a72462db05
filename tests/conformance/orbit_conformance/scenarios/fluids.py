"""Liquids that rest, slosh, run out, spread, carry and are weighed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np
import torch

from orbit_assets.objects import box, sphere
from orbit_conformance.bodies import G
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_conformance.scenarios.ropes import GROUP
from orbit_core.interfaces import Capability, World
from orbit_core.scene import Articulation, Box, Fluid, Link, ObjectSpec, Pose, Scene, Shape
from orbit_core.scene.pose import Vector3

DENSITY, SPACING = 1000.0, 0.01
"""Water, in particles of a gram."""
WALL = 0.01
"""Thickness of a tank's walls in metres: a particle is as wide."""
COARSE = "what was asked for of liquids; it holds for six layers of particles, and finer ones do better"
"""A reason for a :attr:`Metric.looser_because`."""


def _water(size: Vector3, at: Vector3 = (0.0, 0.0, 0.0)) -> Fluid:
    """Return water that fills a box of full ``size`` whose floor's middle is ``at``."""
    x, y, z = at
    half = (0.5 * size[0], 0.5 * size[1], 0.5 * size[2])
    return Fluid("water", half, DENSITY, Pose((x, y, z + half[2])), spacing=SPACING)


def _slab(name: str, size: Vector3, at: Vector3) -> ObjectSpec:
    return box(name, size=size, mass=1.0, pose=Pose(at), fixed_base=True)


def _walls(length: float, width: float, height: float, bottom: float = 0.0) -> tuple[ObjectSpec, ...]:
    """Return the four sides of a tank of an inner length and width, each a thing of its own."""
    z, long = bottom + 0.5 * height, length + 2.0 * WALL
    x, y = 0.5 * (length + WALL), 0.5 * (width + WALL)
    return (
        _slab("right", (WALL, width, height), (x, 0.0, z)),
        _slab("left", (WALL, width, height), (-x, 0.0, z)),
        _slab("front", (long, WALL, height), (0.0, y, z)),
        _slab("back", (long, WALL, height), (0.0, -y, z)),
    )


def _tank(length: float, width: float, height: float) -> tuple[ObjectSpec, ...]:
    floor = _slab("floor", (length + 2.0 * WALL, width + 2.0 * WALL, WALL), (0.0, 0.0, -0.5 * WALL))
    return (floor, *_walls(length, width, height))


def _scene(objects: tuple[ObjectSpec, ...], water: Fluid) -> Scene:
    return Scene(objects=objects, deformables=(water,), terrain=())


def _force(world: World, name: str, axis: int) -> float:
    return float(world.deformables["water"].contact_force(name, name)[0, axis])


def _rest(trial: Trial) -> Mapping[str, float]:
    """Water stands in a tank; its force on the floor and on two sides is the mean of the last half second."""
    length, width, depth = 0.12, 0.08, 0.06
    world = trial.world(_scene(_tank(length, width, 0.12), _water((length, width, depth))))
    water = world.deformables["water"]
    forces: list[tuple[float, float, float]] = []
    heights: list[float] = []
    for time in trial.advance(world, 2.0):
        if time > 1.5:
            forces.append((_force(world, "floor", 2), _force(world, "right", 0), _force(world, "front", 1)))
            heights.append(2.0 * float(water.positions[0, :, 2].mean()))
    down, right, front = np.mean(forces, axis=0)
    pressed = 0.5 * DENSITY * G * depth**2
    sides = (right / (pressed * width), front / (pressed * length))
    return {
        "volume": abs(float(np.mean(heights)) / depth - 1.0),
        "floor": abs(-float(down) / (DENSITY * G * length * width * depth) - 1.0),
        "sides": max(abs(float(side) - 1.0) for side in sides),
    }


def _sloshing(trial: Trial) -> Mapping[str, float]:
    """The first mode is set in motion by its velocities, and its half periods are counted."""
    length, depth = 0.16, 0.06
    world = trial.world(_scene(_tank(length, 0.06, 0.12), _water((length, 0.06, depth))))
    trial.step(world, trial.steps(0.3))
    water = world.deformables["water"]
    k = math.pi / length
    omega = math.sqrt(G * k * math.tanh(k * depth))
    x, z = k * (water.positions[..., 0] + 0.5 * length), k * water.positions[..., 2]
    speed = 0.008 * G * k / omega / math.cosh(k * depth)
    wave = torch.stack((x.sin() * z.cosh(), torch.zeros_like(x), -x.cos() * z.sinh()), dim=-1)
    water.set_state(water.positions.clone(), water.velocities + speed * wave)
    middles = np.array([float(water.positions[0, :, 0].mean()) for _ in trial.advance(world, 1.4)])
    before = np.flatnonzero((middles[:-1] > 0.0) != (middles[1:] > 0.0))
    crossings = before + middles[before] / (middles[before] - middles[before + 1])
    frequency = 0.5 * (len(crossings) - 1) / ((crossings[-1] - crossings[0]) * trial.time_step)
    swings = [np.abs(middles[a : b + 1]).max() for a, b in pairwise(before)]
    lost = 1.0 - (swings[-1] / swings[0]) ** (1.0 / (len(swings) - 1))
    return {"frequency": abs(2.0 * math.pi * float(frequency) / omega - 1.0), "lost": float(lost)}


def _outflow(trial: Trial) -> Mapping[str, float]:
    """Water runs out of a square hole in the floor, between 85 and 45 % of its depth."""
    side, depth, hole, bottom = 0.10, 0.11, 0.04, 0.08
    wide, far = 0.5 * (side - hole) + WALL, 0.25 * (side + hole) + 0.5 * WALL
    z = bottom - 0.5 * WALL
    floor = (
        _slab("left_floor", (wide, side + 2.0 * WALL, WALL), (-far, 0.0, z)),
        _slab("right_floor", (wide, side + 2.0 * WALL, WALL), (far, 0.0, z)),
        _slab("back_floor", (hole, wide, WALL), (0.0, -far, z)),
        _slab("front_floor", (hole, wide, WALL), (0.0, far, z)),
    )
    water = _water((side, side, depth), (0.0, 0.0, bottom))
    world = trial.world(_scene((*floor, *_walls(side, side, 0.15, bottom)), water))
    particles = world.deformables["water"]
    depths, times = [], []
    for time in trial.advance(world, 0.7):
        inside = int((particles.positions[0, :, 2] > bottom - WALL).sum())
        depths.append(inside * SPACING**3 / side**2)
        times.append(time)
    first = int(np.argmax(np.array(depths) < 0.85 * depth))
    last = int(np.argmax(np.array(depths) < 0.45 * depth)) or len(depths) - 1
    fallen = 2.0 * side**2 * (math.sqrt(depths[first]) - math.sqrt(depths[last]))
    coefficient = fallen / (hole**2 * math.sqrt(2.0 * G) * (times[last] - times[first]))
    return {"coefficient": abs(coefficient / 0.62 - 1.0)}


FRONT = ((1.219, 1.474), (1.997, 2.292), (2.547, 2.995))
"""Times in ``sqrt(a / 2 g)`` and places in ``a`` of the front of a column that is twice as high as long."""


def _dam_break(trial: Trial) -> Mapping[str, float]:
    length = 0.06
    floor = _slab("floor", (0.4, 0.06, WALL), (0.1, 0.0, -0.5 * WALL))
    sides = (
        _slab("left", (WALL, 0.06, 0.2), (-0.5 * (length + WALL), 0.0, 0.1)),
        _slab("front", (0.4, WALL, 0.2), (0.1, 0.5 * (0.04 + WALL), 0.1)),
        _slab("back", (0.4, WALL, 0.2), (0.1, -0.5 * (0.04 + WALL), 0.1)),
    )
    world = trial.world(_scene((floor, *sides), _water((length, 0.04, 2.0 * length))))
    water = world.deformables["water"]
    unit = math.sqrt(0.5 * length / G)
    places, times = [], []
    for time in trial.advance(world, FRONT[-1][0] * unit + 0.02):
        # The front is where the foremost particles end, a row of them across the tank.
        ahead = water.positions[0, :, 0].topk(4).values.mean() + 0.5 * SPACING
        places.append((float(ahead) + 0.5 * length) / length)
        times.append(time / unit)
    found = np.interp([time for time, _ in FRONT], times, places)
    return {"front": float(max(abs(at / truth - 1.0) for at, (_, truth) in zip(found, FRONT, strict=True)))}


def _draught(trial: Trial) -> Mapping[str, float]:
    """A raft of half of water's density is laid on water."""
    side, thick, tank, depth = 0.08, 0.04, 0.14, 0.07
    raft = box("raft", size=(side, side, thick), mass=0.5 * DENSITY * side**2 * thick, pose=Pose((0.0, 0.0, 0.095)))
    world = trial.world(_scene((*_tank(tank, tank, 0.16), raft), _water((tank, tank, depth))))
    bottoms = [
        float(world.objects["raft"].root_pose[0, 2]) - 0.5 * thick for time in trial.advance(world, 2.0) if time > 1.2
    ]
    # What the raft displaces rises around it.
    draught = tank**2 * (depth - float(np.mean(bottoms))) / (tank**2 - side**2)
    return {"draught": abs(draught / (0.5 * thick) - 1.0), "swing": float(np.ptp(bottoms))}


def _weighed(trial: Trial) -> Mapping[str, float]:
    """A free cup of water stands on a plate."""
    side, height, wall, bottom = 0.06, 0.08, 0.006, 0.012
    outer, half = side + 2.0 * wall, 0.5 * wall

    def part(size: Vector3, at: Vector3) -> Shape:
        return Shape(Box((0.5 * size[0], 0.5 * size[1], 0.5 * size[2])), Pose(at))

    away, z = 0.5 * side + half, 0.5 * height
    shapes = (
        part((outer, outer, wall), (0.0, 0.0, -half)),
        part((wall, outer, height), (away, 0.0, z)),
        part((wall, outer, height), (-away, 0.0, z)),
        part((side, wall, height), (0.0, away, z)),
        part((side, wall, height), (0.0, -away, z)),
    )
    link = Link("cup", 0.2, inertia=np.eye(3) * 4e-4, collisions=shapes)
    cup = ObjectSpec(name="cup", articulation=Articulation("cup", (link,)), pose=Pose((0.0, 0.0, bottom)))
    plate = _slab("plate", (0.2, 0.2, bottom - wall), (0.0, 0.0, 0.5 * (bottom - wall)))
    water = _water((side, side, 0.06), (0.0, 0.0, bottom))
    world = trial.world(_scene((plate, cup), water))
    forces, heights = [], []
    for time in trial.advance(world, 1.5):
        if time > 1.0:
            forces.append(_force(world, "cup", 2))
            heights.append(float(world.objects["cup"].root_pose[0, 2]))
    weight = DENSITY * G * side**2 * 0.06
    return {"weight": abs(-float(np.mean(forces)) / weight - 1.0), "hop": float(np.ptp(heights))}


def _splash(trial: Trial) -> Mapping[str, float]:
    """A lump of glycerol falls on a floor, and its middle is followed for half a second after it has come down."""
    side, fall = 0.03, 0.2
    middle = Pose((0.0, 0.0, fall + 0.5 * side))
    lump = Fluid("glycerol", (0.5 * side, 0.5 * side, 0.5 * side), 1260.0, middle, viscosity=1.0, spacing=0.5 * SPACING)
    world = trial.world(_scene((_slab("floor", (2.0, 2.0, 0.02), (0.0, 0.0, -0.01)),), lump))
    glycerol = world.deformables["glycerol"]
    down = math.sqrt(2.0 * fall / G)
    heights = np.array([
        float(glycerol.positions[0, :, 2].mean()) for time in trial.advance(world, down + 0.5) if time > down
    ])  # fmt: skip
    lowest = np.minimum.accumulate(heights)
    energy = 0.5 * float(glycerol.velocities[0].square().sum(-1).mean())
    return {"rebound": float((heights - lowest).max()) / fall, "energy": energy / (G * fall)}


def _submerged(trial: Trial) -> Mapping[str, float]:
    """Water is poured on a fixed ball, and stands around it; forces and heights are means of the last 0.8 s."""
    radius, side, depth = 2.0 * SPACING, 0.12, 0.14
    middle, volume = 0.4 * depth, 4.0 / 3.0 * math.pi * radius**3
    ball = sphere("ball", radius, mass=1.0, pose=Pose((0.0, 0.0, middle)), fixed_base=True)
    water = _water((side, side, depth), (0.0, 0.0, middle + radius + 0.5 * SPACING))
    world = trial.world(_scene((*_tank(side, side, 0.36), ball), water))
    up, heights = [], []
    for time in trial.advance(world, 2.4):
        if time > 1.6:
            up.append(_force(world, "ball", 2))
            heights.append(float(world.deformables["water"].positions[0, :, 2].mean()))
    # The ball's place is empty: heights of the water and of the ball, by their volumes, are those of a full tank.
    level = math.sqrt(2.0 * (float(np.mean(heights)) * depth + middle * volume / side**2))
    return {
        "buoyancy": abs(float(np.mean(up)) / (DENSITY * G * volume) - 1.0),
        "volume": abs((level - volume / side**2) / depth - 1.0),
    }


def _settling(trial: Trial) -> Mapping[str, float]:
    """A ball is let go on honey, and timed from 0.6 to 0.45 of its depth."""
    radius, side, depth, honey, viscosity = 2.0 * SPACING, 0.12, 0.18, 1400.0, 10.0
    heavier, volume = 1600.0, 4.0 / 3.0 * math.pi * radius**3
    # First corrections are 2.1044 radii over a tube's, and 1.9033 over half a square's side (Happel and Bart, 1974).
    a = radius / (0.5 * side) * 1.9033 / 2.1044
    slowed = (1.0 - 0.75857 * a**5) / (1.0 - 2.105 * a + 2.0865 * a**3 - 1.7068 * a**5 + 0.72603 * a**6)
    truth = 2.0 / 9.0 * heavier * G * radius**2 / (viscosity * slowed)
    ball = sphere(
        "ball", radius, mass=(honey + heavier) * volume, pose=Pose((0.0, 0.0, depth + radius + 0.3 * SPACING))
    )
    half = (0.5 * side, 0.5 * side, 0.5 * depth)
    liquid = Fluid("honey", half, honey, Pose((0.0, 0.0, half[2])), viscosity=viscosity, spacing=SPACING)
    world = trial.world(_scene((*_tank(side, side, 0.26), ball), liquid))
    seen: list[tuple[float, float]] = []
    for time in trial.advance(world, 3.5):
        height = float(world.objects["ball"].root_pose[0, 2])
        if height < 0.6 * depth:
            seen.append((time, height))
        if height < 0.45 * depth:
            break
    # A ball that stays above has no speed.
    speed = (seen[0][1] - seen[-1][1]) / (seen[-1][0] - seen[0][0]) if len(seen) > 1 else 0.0
    return {"speed": abs(speed / truth - 1.0)}


def _metric(name: str, tolerance: float, meaning: str, unit: str = "", reason: str = COARSE) -> Metric:
    return Metric(name=name, unit=unit, tolerance=tolerance, meaning=meaning, looser_because=reason)


def _scenario(
    name: str, question: str, truth: str, source: str, run: Callable[[Trial], Mapping[str, float]], *metrics: Metric
) -> Scenario:
    return Scenario(
        name=name,
        question=question,
        truth=truth,
        source=source,
        run=run,
        metrics=metrics,
        group=GROUP,
        needs=(Capability.FLUIDS,),
        judges=(Capability.FLUIDS,),
        time_steps=(0.005, 0.0025),
        substeps=(0.00125, 0.000625),
    )


SCENARIOS: tuple[Scenario, ...] = (
    _scenario(
        "fluid_rest",
        "Does water that stands keep its volume and press as its depth says?",
        "weight on the floor, rho g H^2 / 2 per width on a side",
        "Batchelor, An Introduction to Fluid Dynamics, section 1.4",
        _rest,
        _metric("volume", 0.02, "relative error of twice the height of its middle after 2 s"),
        _metric("floor", 0.01, "relative error of the force on the floor"),
        _metric("sides", 0.01, "relative error of the force on two sides, the larger"),
    ),
    _scenario(
        "fluid_sloshing",
        "Does water slosh at its first frequency?",
        "sqrt(g k tanh(k H)) / 2 pi = 2.01 Hz with k = pi / L",
        "Lamb, Hydrodynamics, 6th ed., section 257",
        _sloshing,
        _metric("frequency", 0.05, "relative error over the first periods"),
        _metric("lost", 0.15, "part of its amplitude that it loses in half a period"),
    ),
    _scenario(
        "fluid_outflow",
        "Does water run out of a hole as fast as Torricelli and the contraction of its jet say?",
        "0.62 A sqrt(2 g H)",
        "Batchelor, An Introduction to Fluid Dynamics, section 6.3",
        _outflow,
        _metric("coefficient", 0.1, "relative error of the coefficient of discharge"),
    ),
    _scenario(
        "fluid_dam_break",
        "Does the front of a column that collapses run as measured?",
        "1.47, 2.29 and 3.00 lengths at 1.22, 2.00 and 2.55 sqrt(a / 2 g), height twice the length",
        "Martin and Moyce, Phil. Trans. R. Soc. A 244, 1952, figure 3",
        _dam_break,
        _metric("front", 0.1, "largest relative error of its place"),
    ),
    _scenario(
        "fluid_draught",
        "Does a raft float as deep as Archimedes says?",
        "half its height at half of water's density",
        "Batchelor, An Introduction to Fluid Dynamics, section 4.1",
        _draught,
        _metric("draught", 0.05, "relative error after 2 s"),
        _metric("swing", 0.002, "that it goes up and down, largest minus smallest height", "m"),
    ),
    _scenario(
        "fluid_weighed",
        "Does a cup feel the weight of the water in it, and stand still?",
        "rho g V",
        "Batchelor, An Introduction to Fluid Dynamics, section 4.1",
        _weighed,
        _metric("weight", 0.02, "relative error of the force on the cup"),
        _metric("hop", 0.0005, "that the cup goes up and down, largest minus smallest height", "m"),
    ),
    _scenario(
        "fluid_splash",
        "Does a lump of glycerol that falls on a floor stay there and come to rest?",
        "a layer of it loses its speed as exp(-pi^2 nu t / (4 d^2)), in 0.05 s where d is 1 cm; nothing throws it up",
        "Batchelor, An Introduction to Fluid Dynamics, section 4.3",
        _splash,
        _metric("rebound", 0.05, "way that its middle rises again, as a part of its fall"),
        _metric("energy", 0.01, "energy of its motion 0.5 s after it came down, as a part of that of its fall"),
    ),
    _scenario(
        "fluid_submerged",
        "Does a ball under water feel the weight of the water that it displaces?",
        "rho g V",
        "Batchelor, An Introduction to Fluid Dynamics, section 4.1",
        _submerged,
        _metric("buoyancy", 0.05, "relative error of the force on a ball that is four particles wide"),
        _metric("volume", 0.02, "relative error of the water's volume after it was poured, by its mean height"),
    ),
    _scenario(
        "fluid_settling",
        "Does a ball sink in honey as fast as Stokes and the walls of its tank say?",
        "2 (rho_b - rho) g a^2 / (9 mu K), K = 2.38 in a square tank three times as wide as the ball",
        "Haberman and Sayre, David Taylor Model Basin report 1143, 1958; Happel and Bart, Appl. Sci. Res. 29, 1974",
        _settling,
        _metric(
            "speed",
            0.3,
            "relative error of the speed in the middle of the tank",
            reason="friction along the lines between particles is too large where they are in disorder, and too small "
            "where layers slide over each other; it is set between the two",
        ),
    ),
)
