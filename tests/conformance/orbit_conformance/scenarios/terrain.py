"""Scenarios of terrain: rays and feet on it, level floors, and bowls."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import torch

from orbit_assets.objects import box
from orbit_assets.terrain import (
    Boxes,
    Flat,
    Gap,
    Pit,
    Rough,
    Slope,
    Span,
    Stairs,
    SteppingStones,
    TerrainForm,
    TerrainGrid,
    Waves,
)
from orbit_assets.terrain.grid import Array
from orbit_conformance.bodies import SMOOTH, G, marble, positions, scene, smooth_material
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability
from orbit_core.plugin_kit.meshes import height_field_mesh
from orbit_core.scene import (
    Articulation,
    HeightField,
    Joint,
    JointType,
    Link,
    Mesh,
    MeshCollision,
    Pose,
    RobotSpec,
    Shape,
    Sphere,
)

# Metres: height from which rays are cast down.
_ABOVE = 3.0
# Metres: where the surface bends by more over a resolution, samples round off an edge; such places are left out.
_BEND = 5e-4
# Metres, of a foot.
_RADIUS = 0.03
GRID = TerrainGrid(
    kinds=(
        Flat(), Rough(platform=0.6), Slope(platform=0.6), Slope(platform=0.6, down=True), Stairs(platform=0.6),
        Stairs(platform=0.6, down=True), SteppingStones(platform=0.6, side=Span(0.6, 0.4), apart=Span(0.1, 0.2)),
        Boxes(platform=0.6), Gap(platform=0.6, width=Span(0.2, 0.5)), Pit(platform=0.6),
        Waves(platform=0.6, amplitude=Span(0.05, 0.1), count=1),
    ),
    levels=2, cell_size=3.0, resolution=0.05, border=1.0,
)  # fmt: skip
# Few triangles, which some engines collide one by one.
COARSE = replace(
    GRID,
    kinds=(Rough(platform=0.6, spacing=0.25), Slope(platform=0.5), Stairs(platform=0.5, run=0.25)),
    levels=1,
    difficulty=(1.0, 1.0),
    resolution=0.125,
    form=TerrainForm.MESH,
)
# Fewer still, and wide enough for a foot.
FACETS = replace(COARSE, kinds=(Rough(platform=0.6, spacing=1.0), Slope(platform=0.6)), border=0.25)


def _smooth(grid: TerrainGrid, places: Array, reach: float) -> np.ndarray:
    """(n,) whether the surface bends nowhere within ``reach`` m of places (n, 2)."""
    middle = grid.height(*places.T)
    fine = np.ones(len(places), bool)
    for shift in reach * np.array(((1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, -1.0))):
        sides = [grid.height(*(places + sign * shift).T) for sign in (1.0, -1.0)]
        fine &= np.abs(sides[0] + sides[1] - 2.0 * middle) < _BEND
        # A step of a staircase bends nowhere but at its edge; steep places are left out as well.
        fine &= np.abs(sides[0] - middle) < 2.0 * reach
    return fine


def _rays(trial: Trial, grid: TerrainGrid) -> Mapping[str, float]:
    world = trial.world(scene(terrain=grid.shapes()), num_envs=2)
    half = 0.5 * np.asarray(grid.size) + 0.5 * grid.border
    # Places off the grid's points, where interpolation matters.
    places = np.random.default_rng(1).uniform(-half, half, (4000, 2))
    places = places[_smooth(grid, places, grid.resolution)]
    origins = torch.tensor(np.column_stack((places, np.full(len(places), _ABOVE))), dtype=torch.float32)
    origins = origins.to(world.device).expand(2, -1, 3).contiguous()
    down = torch.tensor([0.0, 0.0, -1.0], device=world.device).expand_as(origins).contiguous()
    heights = _ABOVE - world.engine.cast_rays(origins, down, 10.0).distances.double().cpu().numpy()
    exact = grid.height(*origins[0, :, :2].double().cpu().numpy().T)
    return {"height": float(np.abs(heights - exact).max())}


def _stand(grid: TerrainGrid) -> Array:
    """(n, 2) two places on each cell of the last level where a foot stands on one surface."""
    random, chosen = np.random.default_rng(2), []
    for center in grid.centers[-1]:
        tries = center + random.uniform(-0.45, 0.45, (200, 2)) * grid.cell_size
        chosen.append(tries[_smooth(grid, tries, _RADIUS + grid.resolution)][:2])
    return np.concatenate(chosen)


def _rest_height(grid: TerrainGrid, place: Array) -> float:
    """Height of a ball's middle when it touches the surface from above: the surface, grown by the ball's radius."""
    grown = np.linspace(-_RADIUS, _RADIUS, 121)
    x, y = np.meshgrid(grown, grown)
    cap = np.sqrt(np.maximum(_RADIUS**2 - x**2 - y**2, 0.0))
    height = grid.height(place[0] + x, place[1] + y)
    return float(np.where(x**2 + y**2 <= _RADIUS**2, height + cap, -np.inf).max())


def _feet(places: Array, heights: Array) -> RobotSpec:
    """Build balls of 1 kg, each on a separate upright rail, a millimetre above their place of rest."""
    links = [Link("rails", 1.0, (0.0, 0.0, 0.0), np.eye(3))]
    ball = np.eye(3) * 0.4 * _RADIUS**2
    links += [
        Link(f"foot{n}", 1.0, (0.0, 0.0, 0.0), ball, collisions=(Shape(Sphere(_RADIUS)),)) for n in range(len(places))
    ]
    joints = tuple(
        Joint(
            f"rail{n}", JointType.PRISMATIC, "rails", f"foot{n}", parent_pose=Pose((float(x), float(y), float(z))),
            axis=(0.0, 0.0, 1.0), lower_limit=-1.0, upper_limit=1.0, damping=20.0,
        )
        for n, ((x, y), z) in enumerate(zip(places, heights, strict=True))
    )  # fmt: skip
    feet = Articulation("feet", tuple(links), joints)
    # On fixed rails no foot can roll off a slope.
    return RobotSpec(name="feet", articulation=feet, fixed_base=True, home={".*": 1e-3})


def _standing(trial: Trial, grid: TerrainGrid) -> Mapping[str, float]:
    places = _stand(grid)
    heights = np.array([_rest_height(grid, place) for place in places])
    world = trial.world(scene(_feet(places, heights), terrain=grid.shapes()))
    trial.step(world, trial.steps(1.0))
    return {"height": float(world.robots["feet"].joint_positions.abs().max())}


def _scenario(
    name: str,
    question: str,
    truth: str,
    run: Callable[[Trial], Mapping[str, float]],
    needs: tuple[Capability, ...],
    metric: Metric,
) -> Scenario:
    return Scenario(
        name=name,
        group="Terrain",
        question=question,
        truth=truth,
        source="the functions that make the terrain (orbit_assets.terrain.grid)",
        run=run,
        needs=needs,
        judges=needs,
        time_steps=(),
        metrics=(metric,),
    )


_SURFACE = "the height that each cell's own function gives, where it does not bend within a resolution"
_HEIGHT = Metric(
    name="height",
    unit="m",
    tolerance=1.5e-4,
    meaning="largest error of the height where a ray meets the ground",
)
_FOOT = "the surface grown by the foot's radius, for a ball of 1 kg on an upright rail"
_FOOT_HEIGHT = replace(
    _HEIGHT,
    tolerance=1e-3,
    meaning="largest error of a foot's height after a second",
    looser_because="engines without compliance of their own sink by micrometres, others by tenths of a millimetre",
)


Form = Callable[[HeightField], HeightField | Mesh]
_FLOOR_RADIUS, _SPEED, _SLIDING, _MU = 0.05, 1.0, 1.5, 0.3
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
    ball = marble("ball", _FLOOR_RADIUS, smooth_material(1.0), Pose((-0.7, -0.3, _FLOOR_RADIUS)))
    boxes = [
        box(f"box{n}", (0.15, 0.15, 0.06), mass=1.0, material=smooth_material(_MU), pose=Pose((x, y, 0.03)))
        # Boxes start across cell borders at different offsets, which is where prisms and edges are felt.
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
    rolling[:, :2], rolling[:, 3:5] = _SPEED * ahead, _SPEED / _FLOOR_RADIUS * left
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
    reach = _BOWL - _FLOOR_RADIUS
    # A little off the middle line, so that the ball does not run along the mesh's own edges.
    start = Pose((_AMPLITUDE, 0.013, _BOWL - math.sqrt(reach**2 - _AMPLITUDE**2) + 5e-4))
    ball = marble("ball", _FLOOR_RADIUS, smooth_material(1.0), start)
    world = trial.world(scene(ball, terrain=(Shape(form(field), material=SMOOTH, name="bowl"),)))
    # A rolling ball swings by sqrt(7/5) slower than a sliding point.
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


def _floor_scenario(
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
        "rays_on_terrain",
        "Do rays measure slopes, stairs, stones, gaps and waves right?",
        _SURFACE,
        lambda trial: _rays(trial, GRID),
        (Capability.RAY_CASTS, Capability.HEIGHT_FIELDS),
        _HEIGHT,
    ),
    _scenario(
        "rays_on_terrain_mesh",
        "Do rays measure terrain right that is a mesh?",
        _SURFACE,
        lambda trial: _rays(trial, COARSE),
        (Capability.RAY_CASTS, Capability.TRIANGLE_MESHES),
        replace(_HEIGHT, tolerance=1e-5, looser_because="single precision rounds the squares of metres"),
    ),
    _scenario(
        "feet_on_terrain",
        "Does a foot stand on terrain where its surface is?",
        _FOOT,
        lambda trial: _standing(trial, GRID),
        (Capability.HEIGHT_FIELDS,),
        _FOOT_HEIGHT,
    ),
    _scenario(
        "feet_on_terrain_mesh",
        "Does a foot stand where the surface is of terrain that is a mesh?",
        _FOOT,
        lambda trial: _standing(trial, FACETS),
        (Capability.TRIANGLE_MESHES,),
        _FOOT_HEIGHT,
    ),
    _floor_scenario(
        "level_mesh",
        "Is a level floor of triangles as level as a plane?",
        _PLANE,
        lambda trial: _level(trial, _as_mesh),
        Capability.TRIANGLE_MESHES,
        _FLOOR,
    ),
    _floor_scenario(
        "level_height_field",
        "Is a level height field as level as a plane?",
        _PLANE,
        lambda trial: _level(trial, _as_field),
        Capability.HEIGHT_FIELDS,
        _FLOOR,
    ),
    _floor_scenario(
        "mesh_bowl",
        "Does a ball roll on in a bowl of triangles?",
        _PENDULUM,
        lambda trial: _bowl(trial, _as_mesh),
        Capability.TRIANGLE_MESHES,
        _AMPLITUDE_KEPT,
    ),
    _floor_scenario(
        "height_field_bowl",
        "Does a ball roll on in a bowl that is a height field?",
        _PENDULUM,
        lambda trial: _bowl(trial, _as_field),
        Capability.HEIGHT_FIELDS,
        _AMPLITUDE_KEPT,
    ),
)
