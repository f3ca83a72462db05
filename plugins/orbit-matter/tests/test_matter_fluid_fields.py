"""Liquids in the hollows of height fields and at their edges."""

from __future__ import annotations

import math
import re

import numpy as np
import numpy.typing as npt
import pytest
import torch
import trimesh
import warp as wp

from orbit_assets.objects import box
from orbit_core.interfaces import ConfigurationError, SceneLayout, World
from orbit_core.scene import Fluid, HeightField, Pose, Scene, Shape
from orbit_core.world import simulate
from orbit_matter.colliders import Colliders
from orbit_matter.fields import closed_surface
from orbit_matter.fluid import maps
from orbit_matter.surfaces import HEIGHT_FIELD, MESH, SPHERE, Shapes, distance

SPACING = 0.01
GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs the capability of a GPU")


def _paraboloid(width: float, rim: float) -> HeightField:
    """Return a bowl of ``r^2 / width`` up to a level rim that is a centimetre wide, all in metres."""
    half = math.sqrt(width * rim) + 0.01
    line = np.linspace(-half, half, 25)
    return HeightField(np.minimum((line**2 + line[:, None] ** 2) / width, rim), (2.0 * half, 2.0 * half))


def _world(field: HeightField, water: Fluid, objects: tuple = (), device: str = "cpu") -> World:
    scene = Scene(objects=objects, deformables=(water,), terrain=(Shape(field),))
    backend = "mujoco" if device == "cpu" else "warp"
    world = simulate(scene, 1, backend, device=device, matter="orbit-matter")
    world.reset()
    return world


@wp.kernel(enable_backward=False)
def look_at(shapes: Shapes, shape: int, at: wp.array[wp.vec3], found: wp.array[wp.vec4]):
    i = wp.tid()
    found[i] = distance(shapes, 0, shape, at[i], 0.02)


def test_liquids_meet_a_closed_mesh_and_everything_else_the_height_field() -> None:
    """Both are the same surface: a millimetre above and below it."""
    random = np.random.default_rng(0)
    field = HeightField(random.uniform(0.0, 0.02, (5, 7)), (0.12, 0.1))
    mesh = closed_surface(field, SPACING)
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert made.is_watertight
    assert made.is_winding_consistent
    h = np.asarray(field.heights)
    # Two triangles a cell, along the diagonal from its first corner.
    means = (2.0 * h[:-1, :-1] + h[:-1, 1:] + h[1:, :-1] + 2.0 * h[1:, 1:]) / 6.0
    assert made.volume == pytest.approx(0.12 * 0.1 * (means.mean() - h.min() + 10.0 * SPACING), rel=1e-6)
    water = Fluid("water", (0.01, 0.01, 0.01), 1000.0, Pose((0.0, 0.0, 0.1)), spacing=SPACING)
    layout = SceneLayout.of(Scene(deformables=(water,), terrain=(Shape(field),)))
    with wp.ScopedDevice("cpu"):
        colliders = Colliders(layout, wp.get_device("cpu"))
        assert colliders.shapes.kind.numpy().tolist() == [[int(HEIGHT_FIELD), int(SPHERE)]]
        assert colliders.wet.kind.numpy().tolist() == [[int(SPHERE), int(MESH)]]
        at = wp.array(np.append(random.uniform(-0.049, 0.049, (500, 2)), np.zeros((500, 1)), axis=1), dtype=wp.vec3)
        found = wp.zeros(500, dtype=wp.vec4)
        wp.launch(look_at, 500, inputs=[colliders.shapes, 0, at, found])
        dry = found.numpy()
        surface = at.numpy() - np.array([0.0, 0.0, 1.0]) * (dry[:, 3] / dry[:, 2])[:, None]
        for side in (1.0, -1.0):
            beside = wp.array(surface + np.array([0.0, 0.0, 0.001 * side]), dtype=wp.vec3)
            wp.launch(look_at, 500, inputs=[colliders.wet, 1, beside, found])
            away = found.numpy()[:, 3] * side
            # At a crease another triangle is nearer than the one below, or an edge.
            assert (away > 0.0).all()
            assert (away < 0.001001).all()
            assert np.median(away / dry[:, 2]) == pytest.approx(0.001, rel=1e-3)


def _filled(layers: int, width: float) -> tuple[Fluid, npt.NDArray[np.float64]]:
    """Return a liquid that fills a paraboloid as high as so many particles, and where (P, 3) they are at first."""
    line = (np.arange(-12, 12) + 0.5) * SPACING
    x, y, z = (axis.ravel() for axis in np.meshgrid(line, line, (np.arange(30) + 0.5) * SPACING, indexing="ij"))
    inside = z > (np.hypot(x, y) + 0.3 * SPACING) ** 2 / width + 0.3 * SPACING
    places = np.stack((x, y, z), axis=-1)[inside]
    places = places[np.argsort(places[:, 2], kind="stable")]
    high = round(0.5 * math.pi * width * (layers * SPACING) ** 2 / (9.0 * SPACING**3))
    half = (1.5 * SPACING, 1.5 * SPACING, 0.5 * high * SPACING)
    return Fluid("water", half, 1000.0, Pose((0.0, 0.0, half[2] + 0.1)), spacing=SPACING), places[: 9 * high]


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=GPU)])
@pytest.mark.parametrize(("layers", "width"), [(5, 0.03), (10, 0.015)])
def test_a_bowl_in_a_height_field_holds_what_is_in_it(layers: int, width: float, device: str) -> None:
    """Volume is ``pi width h^2 / 2``, and its middle two thirds of h up; docs/measured/matter.md has it at rest."""
    water, places = _filled(layers, width)
    world = _world(_paraboloid(width, (layers + 2) * SPACING), water, device=device)
    found, heights = world.deformables["water"], []
    x = torch.as_tensor(places, dtype=torch.float32, device=device)[None]
    found.set_state(x, torch.zeros_like(x))
    for step in range(700):
        world.step()
        if step >= 600:
            heights.append(1.5 * float(found.positions[0, :, 2].mean()))
    x = found.positions[0]
    height = math.sqrt(2.0 * len(x) * SPACING**3 / (math.pi * width))
    assert (x[:, 2] > x[:, :2].square().sum(-1) / width).all()
    assert np.mean(heights) == pytest.approx(height, rel=0.03)
    assert not [each for each in world.engine.build_report if "hollow" in each.asked]
    world.close()


def test_nothing_leaks_through_a_height_field_that_water_is_thrown_at() -> None:
    """At 1.5 m/s sideways and down, against slopes as steep as two."""
    width, rim = 0.03, 0.03
    world = _world(_paraboloid(width, rim), Fluid("water", (0.02, 0.02, 0.01), 1000.0, Pose((0.0, 0.0, 0.05))))
    found = world.deformables["water"]
    velocities = torch.zeros_like(found.positions)
    velocities[..., 0], velocities[..., 2] = 1.5, -1.5
    found.set_state(found.positions.clone(), velocities)
    for _ in range(60):
        world.step()
        x = found.positions[0]
        over = (x[:, :2].abs() < math.sqrt(width * rim) + 0.01).all(-1) & (x[:, 2] > -0.05)
        assert (x[over, 2] > (x[over, :2].square().sum(-1) / width).clamp(max=rim) - 0.001).all()
    world.close()


def test_liquids_run_off_the_edge_of_a_height_field_and_fall() -> None:
    """They begin on a slope of a third; its lower side is at 4 cm."""
    field = HeightField(np.linspace(0.03, 0.0, 9) + np.zeros((9, 1)), (0.08, 0.08))
    water = Fluid("water", (0.015, 0.015, 0.015), 1000.0, Pose((0.0, 0.0, 0.035)), spacing=SPACING)
    world = _world(field, water)
    found = world.deformables["water"]
    for _ in range(80):
        world.step()
        x = found.positions[0]
        over = (x[:, :2].abs() < 0.04).all(-1) & (x[:, 2] > -0.05)
        assert (x[over, 2] > 0.015 - 0.375 * x[over, 0]).all()
    assert (x[:, 2] < -0.1).float().mean() > 0.5
    assert not (x[:, :2].abs() < 0.035).all(-1)[x[:, 2] < 0.0].any()
    world.close()


def test_a_map_that_takes_long_tells_how_far_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(maps, "MANY", 100)
    maps.grid_of.cache_clear()
    water = Fluid("water", (0.01, 0.01, 0.01), pose=Pose((0.0, 0.0, 0.1)), spacing=0.01)
    _world(_paraboloid(0.06, 0.02), water)
    told = capsys.readouterr().err
    assert re.search(
        r"orbit-matter: mapping what a surface gives liquids, [\d,]+ points 10 % 20 % .* 90 % 100 %\n", told
    )


def test_a_liquid_beneath_a_height_field_is_refused() -> None:
    """Its mesh ends ten spacings below it."""
    water = Fluid("water", (0.015, 0.015, 0.015), 1000.0, Pose((0.0, 0.0, -1.0)), spacing=SPACING)
    with pytest.raises(ConfigurationError, match="inside the terrain"):
        _world(_paraboloid(0.03, 0.01), water)


def test_boxes_that_are_sunk_into_a_height_field_press_as_those_that_stand_on_it() -> None:
    heights = np.zeros((9, 9))
    heights[0, 0] = 0.02
    water = Fluid("water", (0.02, 0.02, 0.02), 1000.0, Pose((0.0, 0.0, 0.02)), spacing=SPACING)
    found: list[float] = []
    for middle in (0.04, 0.02):
        places = {"right": (0.025, 0.0), "left": (-0.025, 0.0), "front": (0.0, 0.025), "back": (0.0, -0.025)}
        walls = tuple(
            box(
                name,
                size=(0.01, 0.06, 0.08) if x else (0.04, 0.01, 0.08),
                pose=Pose((x, y, middle)),
                mass=1.0,
                fixed_base=True,
            )
            for name, (x, y) in places.items()
        )
        world = _world(HeightField(heights, (0.12, 0.12)), water, walls)
        world.step(150)
        means = []
        for _ in range(100):
            world.step()
            means.append(float(world.deformables["water"].positions[0, :, 2].mean()))
        found.append(float(np.mean(means)))
        world.close()
    assert found[1] == pytest.approx(found[0], rel=0.025)
    assert found[0] == pytest.approx(0.02, rel=0.03)
