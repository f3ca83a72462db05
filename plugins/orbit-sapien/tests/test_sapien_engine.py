"""What is SAPIEN's own: pair coefficients, isolation, the grid, the shared ground, cooking, tendons, settings."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from orbit_core import backends
from orbit_core.interfaces import (
    TERRAIN,
    AssetError,
    ConfigurationError,
    Engine,
    SceneLayout,
    SimulationError,
    UnsupportedCapabilityError,
)
from orbit_core.scene import (
    Articulation,
    Box,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    Mesh,
    MeshCollision,
    ObjectSpec,
    PhysicsMaterial,
    Plane,
    Pose,
    RobotSpec,
    Scene,
    Shape,
)
from orbit_core.world import simulate
from orbit_sapien.config import SapienConfig
from orbit_sapien.isolation import color, grid_offset
from orbit_sapien.materials import PairRule


def thing(name: str, *shapes: Shape, height: float = 0.05, x: float = 0.0) -> ObjectSpec:
    link = Link(name, 1.0, inertia=np.eye(3) * 0.01, collisions=shapes)
    return ObjectSpec(name=name, articulation=Articulation(name, (link,)), pose=Pose((x, 0.0, height)))


def box(friction: float = 1.0, restitution: float = 0.0) -> Shape:
    return Shape(Box((0.05, 0.05, 0.05)), material=PhysicsMaterial(friction, friction, restitution=restitution))


def ground(friction: float = 1.0) -> Shape:
    return Shape(Plane(), material=PhysicsMaterial(friction, friction))


def engine(scene: Scene, num_envs: int = 1, **settings: object) -> Engine:
    plugin = backends.backend("sapien")
    config = backends.backend_config(plugin, settings)
    return plugin.create_engine(SceneLayout.of(scene), num_envs, torch.device("cpu"), config)


def test_averages_of_a_scene_that_allows_it_are_the_larger_values() -> None:
    rule = PairRule(SceneLayout.of(Scene(objects=(thing("a", box(0.2)), thing("b", box(0.9))), terrain=(ground(0.5),))))
    asked = rule.asked("dynamic")
    given = rule.given(asked)
    for one in range(3):
        for other in range(one):
            assert (given[one] + given[other]) / 2 == pytest.approx(max(asked[one], asked[other]))


def test_equal_coefficients_are_given_as_they_are() -> None:
    rule = PairRule(SceneLayout.of(Scene(objects=(thing("a", box(0.7)), thing("b", box(0.7))), terrain=(ground(0.7),))))
    np.testing.assert_allclose(rule.given(rule.asked("static")), 0.7)


def test_a_pair_that_cannot_be_met_is_reported() -> None:
    things = tuple(thing(f"cube{index}", box(value), x=index) for index, value in enumerate((0.0, 0.0, 0.5, 2.0)))
    report = engine(Scene(objects=things)).build_report
    assert any("friction" in line.asked and "averages" in line.why for line in report)


def test_the_grid_does_not_depend_on_the_number_and_colours_lie_apart() -> None:
    places = np.array([grid_offset(index, 1.0)[:2] for index in range(500)])
    assert len(np.unique(places, axis=0)) == 500
    colors = np.array([color(np.append(place, 0.0), 1.0) for place in places])
    for value in range(31):
        same = places[colors == value]
        distances = np.linalg.norm(same[:, None] - same[None], axis=-1) + 1e9 * np.eye(len(same))
        assert distances.min() > 5


@pytest.mark.parametrize("shared_ground_above", [64, 2])
def test_bodies_in_the_same_place_of_different_environments_do_not_meet(shared_ground_above: int) -> None:
    """Each cube is put where the next environment's stands, in PhysX's world."""
    made = engine(Scene(objects=(thing("cube", box()),)), 4, shared_ground_above=shared_ground_above)
    _, scenes = made.native
    assert len(scenes) == 4
    spacing = torch.tensor(np.stack([grid_offset(index, SapienConfig().env_spacing) for index in range(4)]))
    target = (spacing[[1, 2, 3, 0]] - spacing).float()
    pose = torch.cat((target[:, :2], torch.full((4, 1), 0.05), torch.tensor([[1.0, 0, 0, 0]] * 4)), -1)
    made.write_root_state(0, pose, None)
    made.step(50)
    torch.testing.assert_close(made.link_poses[:, 0], pose, rtol=0, atol=1e-3)


def test_a_shared_ground_has_one_friction() -> None:
    made = engine(Scene(objects=(thing("cube", box()),)), 4, shared_ground_above=2)
    with pytest.raises(UnsupportedCapabilityError, match="shared_ground_above=4"):
        made.set_friction(torch.tensor([TERRAIN]), torch.ones(4, 1))


def test_leaving_the_cell_over_a_shared_ground_is_an_error() -> None:
    made = engine(Scene(objects=(thing("cube", box()),)), 4, shared_ground_above=2)
    far = torch.tensor([[100.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]])
    made.write_root_state(0, far, None, torch.tensor([2]))
    with pytest.raises(SimulationError, match=r"\b2\b.*env_spacing"):
        made.step(1)


@pytest.mark.parametrize("faces", [[[0, 1, 2]], np.zeros((0, 3), np.int64)])
def test_a_mesh_that_does_not_cook_is_named(faces: list[list[int]]) -> None:
    flat = Mesh(np.zeros((3, 3)), np.array(faces), MeshCollision.TRIANGLES)
    broken = dataclasses.replace(ground(), geometry=flat, name="rubble")
    with pytest.raises(AssetError, match="rubble"):
        engine(Scene(terrain=(broken,)))


def hull(*points: tuple[float, float, float]) -> Shape:
    return Shape(Mesh(np.array(points), np.zeros((0, 3), np.int64)))


def test_a_hull_that_does_not_cook_is_named_with_its_link() -> None:
    broken = hull((0.0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (np.nan, 0, 0.1))
    with pytest.raises(AssetError, match="splinter"):
        engine(Scene(objects=(thing("splinter", broken),)))


def test_a_flat_hull_is_reported_for_its_thickness() -> None:
    """PhysX makes boxes 2 mm thick of what has no volume."""
    flat = hull((0.0, 0, 0), (0.1, 0, 0), (0, 0.1, 0))
    report = engine(Scene(objects=(thing("sheet", flat),))).build_report
    assert any("sheet" in line.subject and "hull" in line.asked for line in report), report


def test_a_simplified_hull_is_reported() -> None:
    points = np.random.default_rng(0).normal(size=(2000, 3))
    points *= 0.1 / np.linalg.norm(points, axis=-1, keepdims=True)
    hull = Shape(Mesh(points, np.zeros((0, 3), np.int64)))
    report = engine(Scene(objects=(thing("stone", hull, height=0.2),))).build_report
    assert any("stone" in line.subject and "hull" in line.asked for line in report)


def sagging_chain() -> RobotSpec:
    """Two level links of 0.5 m and 1.02 kg, held by drives: the first has 10 N m to bear."""
    half, mass = 0.25, 1.02
    inertia = np.diag([1e-4, mass * half**2 / 3, mass * half**2 / 3])
    links = [Link(name, mass, (half, 0.0, 0.0), inertia) for name in ("first", "second")]
    joints = [
        Joint(f"to_{child}", JointType.REVOLUTE, parent, child, Pose((x, 0.0, 0.0)), axis=(0.0, 1.0, 0.0))
        for parent, child, x in (("base", "first", 0.0), ("first", "second", 2 * half))
    ]
    body = Articulation("chain", (Link("base", 1.0, inertia=np.eye(3) * 0.01), *links), tuple(joints))
    drives = ImplicitPd(joints=(".*",), stiffness=1e4, damping=500.0)
    return RobotSpec(name="chain", articulation=body, pose=Pose((0, 0, 1)), fixed_base=True, actuators=(drives,))


def test_a_stiff_drive_sags_as_much_as_its_declaration_says() -> None:
    for iterations, expected in ((24, 1.42), (48, 1.20)):
        scene = Scene(robots=(sagging_chain(),), physics_dt=0.005)
        world = simulate(scene, 1, "sapien", {"position_iterations": iterations})
        world.step(600)
        sag = world.robots["chain"].joint_positions[0, 0].item()
        assert 1e3 * sag == pytest.approx(expected, abs=0.05), "declared in backend.py and README.md"
        world.close()


def test_settings_are_checked() -> None:
    wrongs = (
        {"tier": "best"}, {"position_iterations": 0}, {"workers": -1}, {"denoiser": "magic"}, {"samples_per_pixel": 0},
        {"shadow_size": -1}, {"contact_offset": 0.0},
    )  # fmt: skip
    for wrong in wrongs:
        with pytest.raises(ConfigurationError, match=next(iter(wrong))):
            SapienConfig(**wrong)


def test_another_device_is_refused() -> None:
    plugin = backends.backend("sapien")
    with pytest.raises(ConfigurationError, match="'cpu' or 'cuda', not on 'meta'"):
        plugin.create_engine(SceneLayout.of(Scene()), 1, torch.device("meta"), SapienConfig())
