"""Floors of triangles: level ones are as level as a plane, and a bowl lets a ball roll to and fro."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
import torch

from orbit_assets.objects import box
from orbit_conformance.bodies import SMOOTH, G, scene
from orbit_conformance.contact import marble, positions, smooth_material
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability
from orbit_core.plugin_kit.meshes import height_field_mesh
from orbit_core.scene import HeightField, Mesh, MeshCollision, Pose, Shape

Form = Callable[[HeightField], HeightField | Mesh]
_RADIUS, _SPEED, _SLIDING, _MU = 0.05, 1.0, 1.5, 0.3
# Radians: along the cells' sides, and across their diagonals.
_HEADINGS = (0.0, 0.3, 0.6, 0.9, 1.2, 1.5)
# Radius of the bowl and first distance of the ball's middle from its axis, in metres.
_BOWL, _AMPLITUDE = 1.0, 0.3


def _as_mesh(field: HeightField) -> Mesh:
    return Mesh(*height_field_mesh(field), collision=MeshCollision.TRIANGLES)


def _as_field(field: HeightField) -> HeightField:
    return field


def _level_field() -> HeightField:
    """A level floor of cells of 0.1 m, 4 m wide, that is rough in a corner where nothing comes."""
    heights = np.zeros((41, 41))
    heights[30:, 30:] = np.random.default_rng(1).uniform(0.0, 0.1, (11, 11))
    return HeightField(heights, (4.0, 4.0))


def _level(trial: Trial, form: Form) -> Mapping[str, float]:
    ball = marble("ball", _RADIUS, smooth_material(1.0), Pose((-0.7, -0.3, _RADIUS)))
    boxes = [
        box(f"box{n}", (0.15, 0.15, 0.06), mass=1.0, material=smooth_material(_MU), pose=Pose((x, y, 0.03)))
        for n, (x, y) in enumerate(((-1.6, -1.5), (-0.8, -1.487), (-1.587, -0.8)))
    ]
    floor = Shape(form(_level_field()), material=SMOOTH, name="floor")
    world = trial.world(scene(ball, *boxes, terrain=(floor,)), len(_HEADINGS))
    trial.step(world, trial.steps(0.1))
    angles = torch.tensor(_HEADINGS, device=world.device)
    ahead = torch.stack((angles.cos(), angles.sin()), -1)
    left = torch.stack((-angles.sin(), angles.cos()), -1)
    rolling_ball, *sliding = world.objects.values()
    rolling, pushed = torch.zeros(2, len(angles), 6, device=world.device)
    rolling[:, :2], rolling[:, 3:5] = _SPEED * ahead, _SPEED / _RADIUS * left
    pushed[:, :2] = _SLIDING * ahead
    before = positions(world)[:, 1:, :2]
    rolling_ball.set_root_velocity(rolling)
    for thing in sliding:
        thing.set_root_velocity(pushed)
    trial.step(world, trial.steps(1.2))
    velocity, way = rolling_ball.root_velocity[:, :2], positions(world)[:, 1:, :2] - before
    truth = _SLIDING**2 / (2 * _MU * G)
    return {
        "speed": float(((velocity * ahead).sum(-1) / _SPEED - 1).abs().max()),
        "turn": float((velocity * left).sum(-1).abs().max()) / _SPEED,
        "way": float(((way * ahead[:, None]).sum(-1) / truth - 1).abs().max()),
        "aside": float((way * left[:, None]).sum(-1).abs().max()) / truth,
    }


def _bowl(trial: Trial, form: Form) -> Mapping[str, float]:
    places = np.linspace(-0.4, 0.4, 17)
    x, y = np.meshgrid(places, places)
    field = HeightField(_BOWL - np.sqrt(_BOWL**2 - x**2 - y**2), (0.8, 0.8))
    reach = _BOWL - _RADIUS
    start = Pose((_AMPLITUDE, 0.013, _BOWL - math.sqrt(reach**2 - _AMPLITUDE**2) + 5e-4))
    ball = marble("ball", _RADIUS, smooth_material(1.0), start)
    world = trial.world(scene(ball, terrain=(Shape(form(field), material=SMOOTH, name="bowl"),)))
    period = 2 * math.pi * math.sqrt(7 * reach / (5 * G))
    trial.step(world, trial.steps(period))
    farthest = 0.0
    for _ in trial.advance(world, period, every=0.02):
        farthest = max(farthest, abs(world.objects["ball"].root_pose[0, 0].item()))
    return {"amplitude": abs(farthest / _AMPLITUDE - 1)}


_FLOOR = (
    Metric(
        name="speed",
        unit="",
        tolerance=0.01,
        meaning="largest relative loss of a rolling ball's speed in 1.2 s",
        looser_because="the best engines err by rounding alone",
    ),
    Metric(
        name="turn",
        unit="rad",
        tolerance=0.01,
        meaning="largest turn of its path",
        looser_because="the best engines err by rounding alone",
    ),
    Metric(
        name="way",
        unit="",
        tolerance=0.05,
        meaning="largest relative error of the way of a sliding box",
        looser_because="integrators of first order err by mu g dt / v, 1 % here",
    ),
    Metric(
        name="aside",
        unit="",
        tolerance=0.01,
        meaning="its largest way aside, over the way ahead",
        looser_because="the best engines err by rounding alone",
    ),
)
_AMPLITUDE_KEPT = (
    Metric(
        name="amplitude",
        unit="",
        tolerance=0.05,
        meaning="loss of the amplitude after one period, relative",
        looser_because="the ball meets an edge between facets of 0.05 rad every 50 mm, and loses speed at each",
    ),
)


def _scenario(
    name: str,
    question: str,
    truth: str,
    run: Callable[[Trial], Mapping[str, float]],
    capability: Capability,
    metrics: tuple[Metric, ...],
) -> Scenario:
    return Scenario(
        name=name,
        group="Terrain",
        question=question,
        truth=truth,
        source="Goldstein, Classical Mechanics, 3rd ed., sections 1.5 and 2.4: sliding friction, and rolling",
        run=run,
        needs=(capability,),
        judges=(capability,),
        time_steps=(0.005, 0.0025),
        metrics=metrics,
    )


_PLANE = "constant velocity of a ball that rolls at 1 m/s; v^2 / (2 mu g) straight ahead, v = 1.5 m/s, mu = 0.3"
_PENDULUM = "the same amplitude period by period, for a ball of 0.05 m in a bowl of radius 1 m"
SCENARIOS = (
    _scenario(
        "level_mesh", "Is a level floor of triangles as level as a plane?", _PLANE,
        lambda trial: _level(trial, _as_mesh), Capability.TRIANGLE_MESHES, _FLOOR,
    ),
    _scenario(
        "level_height_field", "Is a level height field as level as a plane?", _PLANE,
        lambda trial: _level(trial, _as_field), Capability.HEIGHT_FIELDS, _FLOOR,
    ),
    _scenario(
        "mesh_bowl", "Does a ball roll on in a bowl of triangles?", _PENDULUM,
        lambda trial: _bowl(trial, _as_mesh), Capability.TRIANGLE_MESHES, _AMPLITUDE_KEPT,
    ),
    _scenario(
        "height_field_bowl", "Does a ball roll on in a bowl that is a height field?", _PENDULUM,
        lambda trial: _bowl(trial, _as_field), Capability.HEIGHT_FIELDS, _AMPLITUDE_KEPT,
    ),
)  # fmt: skip
