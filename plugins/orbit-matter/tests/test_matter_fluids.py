"""Liquids: their walls, their neighbours, and how worlds hold them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
import torch
import warp as wp

from orbit_assets.deformables import cuboid, sheet
from orbit_assets.objects import box
from orbit_core.interfaces import ArgumentError, ConfigurationError, SceneLayout, SimulationError, World
from orbit_core.scene import (
    Attachment,
    Cloth,
    Cylinder,
    Fluid,
    HeightField,
    MeshCollision,
    Plane,
    Pose,
    Scene,
    Shape,
    Sphere,
)
from orbit_core.world import simulate
from orbit_matter.bodies import free_links
from orbit_matter.fields import bounds_of
from orbit_matter.fluid import search
from orbit_matter.fluid.extent import is_mappable
from orbit_matter.fluid.fluids import build, thickened
from orbit_matter.stability import hollow, passing, rounded, tossed

WATER = Fluid("water", (0.02, 0.02, 0.02), pose=Pose((0.0, 0.0, 0.02)), spacing=0.01)
GROUND = (Shape(Plane()),)


def _around(height: float = 0.08, wall: float = 0.01) -> tuple:
    """Return four walls around the water, on the ground."""
    half, away = 0.5 * height, 0.02 + 0.5 * wall
    long, fixed = 0.04 + 2.0 * wall, {"mass": 1.0, "fixed_base": True}
    return (
        box("right", size=(wall, long, height), pose=Pose((away, 0.0, half)), **fixed),
        box("left", size=(wall, long, height), pose=Pose((-away, 0.0, half)), **fixed),
        box("front", size=(0.04, wall, height), pose=Pose((0.0, away, half)), **fixed),
        box("back", size=(0.04, wall, height), pose=Pose((0.0, -away, half)), **fixed),
    )


def _world(num_envs: int = 1, **changes: object) -> World:
    scene = Scene(objects=_around(), deformables=(WATER,), terrain=GROUND)
    return simulate(replace(scene, **changes), backend="mujoco", num_envs=num_envs)


@pytest.fixture(scope="module")
def settled() -> World:
    world = _world(num_envs=2)
    for _ in range(100):
        world.step()
    return world


def test_water_stays_within_its_walls_and_keeps_its_height(settled: World) -> None:
    x = settled.deformables["water"].positions
    assert (x[..., :2].abs() < 0.02).all()
    assert (x[..., 2] > 0.0).all()
    assert x[..., 2].mean().item() == pytest.approx(0.02, rel=0.04)


def test_neighbours_among_all_particles_are_those_in_the_cells_around(settled: World) -> None:
    part = settled.engine._matter._parts[0]._fluid
    fluid = part._fluid

    def found() -> list[npt.NDArray]:
        lists, counts = fluid.neighbours.numpy().reshape(-1, fluid.neighbours.shape[2]), fluid.count.numpy().ravel()
        return [np.sort(row[:count]) for row, count in zip(lists, counts, strict=True)]

    with wp.ScopedDevice("cpu"):
        part.search_again()
        compared = found()
        fluid.neighbours.zero_(), fluid.count.zero_()
        wp.launch(search.clear, (fluid.x.shape[0], int(search.CLEARERS)), inputs=[fluid])
        for kernel in (search.insert, search.find):
            wp.launch(kernel, fluid.x.shape, inputs=[fluid])
        expected = found()
        part.search_again()  # the order of lists, which bits depend on, is again that of the numbers of particles
    assert max(len(row) for row in expected) > 30
    for row, wanted in zip(compared, expected, strict=True):
        np.testing.assert_array_equal(row, wanted)


def test_equal_environments_stay_equal_to_the_last_bit(settled: World) -> None:
    x = settled.deformables["water"].positions
    assert torch.equal(x[0], x[1])


def test_an_environment_is_the_same_to_the_last_bit_in_a_batch_of_any_size() -> None:
    alone, many = _world(num_envs=1), _world(num_envs=5)
    for world in (alone, many):
        water = world.deformables["water"]
        velocities = torch.zeros_like(water.positions)
        velocities[..., 0] = 0.5
        water.set_state(water.positions.clone(), velocities)
        world.step(8)
    expected = alone.deformables["water"].positions.expand(5, -1, -1)
    assert torch.equal(many.deformables["water"].positions, expected)


def test_a_snapshot_continues_as_the_run_did(settled: World) -> None:
    state = settled.save_state()
    for _ in range(5):
        settled.step()
    first = settled.deformables["water"].positions.clone()
    settled.load_state(state)
    for _ in range(5):
        settled.step()
    assert torch.equal(settled.deformables["water"].positions, first)


def test_a_snapshot_of_more_particles_is_refused(settled: World) -> None:
    before = settled.deformables["water"].positions.clone()
    other = _world(num_envs=2, deformables=(replace(WATER, half_extents=(0.01, 0.02, 0.02)),)).save_state()
    with pytest.raises(ArgumentError, match="the numbers of particles must be the same"):
        settled.load_state(other)
    assert torch.equal(settled.deformables["water"].positions, before)


def test_a_reset_of_one_environment_leaves_the_others(settled: World) -> None:
    before = settled.deformables["water"].positions.clone()
    settled.reset(torch.tensor([1]))
    after = settled.deformables["water"].positions
    assert torch.equal(after[0], before[0])
    rest = torch.as_tensor(WATER.pose.transform(WATER.rest_positions), dtype=torch.float32)
    assert torch.allclose(after[1], rest, atol=1e-6)


def test_a_wall_that_is_taken_away_between_two_steps_presses_no_more() -> None:
    """Particles at rest keep their walls from one step to the next, but for what moved."""
    world = _world()
    for _ in range(40):
        world.step()
    matter = world.engine._matter
    fluid, links = matter._parts[0]._fluid._fluid, matter._colliders.links[0]
    right = world.layout.entity("right").links.start

    def touched() -> int:
        count = fluid.walls.numpy()[..., None] > np.arange(fluid.shape.shape[2])
        return int((count & (links[fluid.shape.numpy()] == right)).sum())

    before, drift = touched(), fluid.drift.numpy().copy()
    assert before > 8
    world.step()
    assert (fluid.drift.numpy() > drift).any()
    assert touched() == before
    pose = world.objects["right"].root_pose.clone()
    pose[:, 0] += 0.1
    world.objects["right"].set_root_pose(pose)
    world.step()
    assert touched() == 0


def test_sides_that_are_thinner_than_a_particle_hold_water_that_is_thrown_at_them() -> None:
    world = _world(objects=_around(wall=0.002))
    water = world.deformables["water"]
    velocities = torch.zeros_like(water.positions)
    velocities[..., 0] = 2.0
    water.set_state(water.positions.clone(), velocities)
    for _ in range(12):
        world.step()
    x = water.positions[0]
    assert not ((x[:, 0] > 0.022) & (x[:, 2] < 0.08)).any()


def _plate(collision: MeshCollision) -> Shape:
    return Shape(replace(cuboid((0.4, 0.4, 0.02)), collision=collision), Pose((0.0, 0.0, -0.01)))


@pytest.mark.parametrize(
    "floor",
    [
        Shape(Plane()),
        Shape(HeightField(np.zeros((9, 9)), (0.4, 0.4))),
        Shape(Cylinder(0.2, 0.02), Pose((0.0, 0.0, -0.02))),
        Shape(Sphere(20.0), Pose((0.0, 0.0, -20.0))),
        _plate(MeshCollision.CONVEX_HULL),
        _plate(MeshCollision.TRIANGLES),
    ],
    ids=["plane", "height field", "cylinder", "sphere", "hull", "triangles"],
)
def test_water_rests_on_a_floor_of_any_shape(floor: Shape) -> None:
    world = _world(terrain=(floor,))
    for _ in range(150):
        world.step()
    water = world.deformables["water"]
    assert water.positions[..., 2].mean().item() == pytest.approx(0.02, rel=0.03)
    assert water.positions[..., 2].min() > 0.0025
    assert water.velocities.square().sum(-1).mean().sqrt() < 0.01


def test_two_boxes_that_make_one_floor_press_as_one() -> None:
    fixed = {"mass": 1.0, "fixed_base": True}
    one = (box("floor", size=(0.2, 0.2, 0.02), pose=Pose((0.0, 0.0, -0.01)), **fixed),)
    two = tuple(
        box(name, size=(0.1, 0.2, 0.02), pose=Pose((x, 0.0, -0.01)), **fixed)
        for name, x in (("west", -0.05), ("east", 0.05))
    )
    heights = []
    for floor in (one, two):
        world = _world(objects=(*floor, *_around()), terrain=())
        for _ in range(60):
            world.step()
        heights.append(float(world.deformables["water"].positions[0, :, 2].mean()))
    assert heights[0] == pytest.approx(heights[1], rel=0.01)


def test_a_denser_liquid_weighs_more(settled: World) -> None:
    del settled
    scene = Scene(objects=_around(), deformables=(replace(WATER, density=2000.0),), terrain=())
    floor = box("floor", size=(0.2, 0.2, 0.02), pose=Pose((0.0, 0.0, -0.01)), mass=1.0, fixed_base=True)
    world = simulate(replace(scene, objects=(*scene.objects, floor)), backend="mujoco", num_envs=1)
    force = 0.0
    for step in range(160):
        world.step()
        force += float(world.deformables["water"].contact_force("floor", "floor")[0, 2]) if step >= 80 else 0.0
    assert -force / 80.0 == pytest.approx(2000.0 * 9.81 * 0.04**3, rel=0.03)


def test_free_bodies_are_moved_by_liquids_too() -> None:
    raft = box("raft", size=(0.02, 0.02, 0.02), mass=0.02, pose=Pose((0.0, 0.0, 0.06)))
    layout = SceneLayout.of(Scene(objects=(*_around(), raft), deformables=(WATER,), terrain=GROUND))
    assert [layout.links[link].name for link in free_links(layout)] == ["raft"]
    assert not tossed(layout)


def test_a_body_that_weighs_few_particles_is_reported_with_the_spacing_that_would_do() -> None:
    raft = box("raft", size=(0.02, 0.02, 0.02), mass=0.004, pose=Pose((0.0, 0.0, 0.06)))
    (found,) = tossed(SceneLayout.of(Scene(objects=(raft,), deformables=(WATER,), terrain=GROUND)))
    assert "weighs 4 particles of 'water': a spacing of 0.0074 m would do" in found.why
    assert not tossed(SceneLayout.of(Scene(objects=(raft,), deformables=(replace(WATER, spacing=0.007),))))


def test_hollows_without_a_map_are_reported() -> None:
    layout = _world(terrain=()).layout
    small, large = (cuboid((edge, edge, 0.02), (2, 2, 2)).vertices for edge in (0.1, 2.0))
    assert hollow(layout, [("a cup", small)]) == ()
    (found,) = hollow(layout, [("a cup", small), ("a pool", large)])
    assert found.subject == "a pool"
    assert "2 x 2 x 0.02 m is too large for a map at a spacing of 0.01 m" in found.why


@pytest.mark.parametrize(("relief", "edge", "subjects"), [
    (0.1, 2.0, ["the terrain's height field"]), (0.1, 0.2, []), (0.0, 2.0, []),
])  # fmt: skip
def test_height_fields_that_are_too_large_for_a_map_are_reported(
    relief: float, edge: float, subjects: list[str]
) -> None:
    heights = np.full((3, 3), -0.2)
    heights[1] += relief
    scene = Scene(deformables=(WATER,), terrain=(Shape(HeightField(heights, (edge, edge))),))
    found = hollow(SceneLayout.of(scene), ())
    assert [each.subject for each in found] == subjects
    for each in found:
        assert "2 x 2 x 0.1 m is too large for a map at a spacing of 0.01 m" in each.why
        fits = float(each.why.split(", ")[-1].split(" x ")[0])
        for side, is_small in ((fits - 0.05, True), (fits + 0.05, False)):
            assert is_mappable(bounds_of(HeightField(heights, (side, side))), 0.01) == is_small


def test_cloth_in_a_scene_of_liquid_is_reported_as_passed_through() -> None:
    cloth = Cloth("cloth", sheet((0.1, 0.1), (5, 5)), area_density=0.2, pose=Pose((0.0, 0.0, 0.02)))
    (found,) = passing(SceneLayout.of(Scene(deformables=(WATER, cloth), terrain=GROUND)))
    assert (found.subject, found.asked) == ("'water'", "contact with 'cloth'")
    assert not passing(SceneLayout.of(Scene(deformables=(cloth,), terrain=GROUND)))


@pytest.mark.parametrize(
    ("objects", "pose", "culprit"),
    [
        (("wall", 1.0, True), (0.0, 0.0, 0.02), "link 'wall' of 'wall'"),
        (("brick", 0.1, False), (0.0, 0.0, 0.02), "link 'brick' of 'brick'"),
        (None, (0.0, 0.0, 0.01), "the terrain"),
    ],
)
def test_liquid_inside_a_solid_or_the_ground_is_refused(objects: tuple | None, pose: tuple, culprit: str) -> None:
    things = ()
    if objects is not None:
        name, mass, fixed = objects
        things = (box(name, size=(0.01, 0.1, 0.04), mass=mass, pose=Pose((0.015, 0.0, 0.02)), fixed_base=fixed),)
    with pytest.raises(ConfigurationError, match=f"16 of the 64 particles of 'water' are inside {culprit}"):
        _world(num_envs=2, objects=things, deformables=(replace(WATER, pose=Pose(pose)),))


def test_two_liquids_at_one_place_are_refused() -> None:
    oil = replace(WATER, name="oil", pose=Pose((0.02, 0.0, 0.02)))
    with pytest.raises(ConfigurationError, match="32 of the 64 particles of 'oil' are inside 'water'"):
        build(Scene(deformables=(WATER, oil)))
    drop = replace(WATER, name="drop", half_extents=(0.004, 0.004, 0.004))
    for both in ((WATER, drop), (drop, WATER)):
        with pytest.raises(ConfigurationError, match="1 of the 1 particles of 'drop' are inside 'water'"):
            build(Scene(deformables=both))
    assert build(Scene(deformables=(WATER, replace(oil, pose=Pose((0.04, 0.0, 0.02)))))) is not None


def _afloat(viscosity: float, half: tuple[float, float, float]) -> World:
    """Return a lump of liquid without weight."""
    lump = replace(WATER, half_extents=half, viscosity=viscosity, pose=Pose())
    return _world(objects=(), terrain=(), deformables=(lump,), gravity=(0.0, 0.0, 0.0), physics_dt=0.0025)


@pytest.mark.parametrize("viscosity", [1e-3, 10.0])
def test_a_lump_that_turns_keeps_its_angular_momentum(viscosity: float) -> None:
    world = _afloat(viscosity, (0.03, 0.03, 0.03))
    liquid = world.deformables["water"]
    x = liquid.positions.clone()
    liquid.set_state(x, torch.linalg.cross(torch.tensor([0.0, 0.0, 3.0]).expand_as(x), x))

    def spin() -> float:
        return float(torch.linalg.cross(liquid.positions[0].double(), liquid.velocities[0].double())[:, 2].sum())

    before = spin()
    world.step(20)
    assert spin() == pytest.approx(before, rel=1e-3)


@pytest.mark.parametrize("viscosity", [1.0, 5.0])
def test_a_sheared_lump_slows_down_as_its_viscosity_says(viscosity: float) -> None:
    """The first mode of a layer with two free surfaces, ``sin(pi z / H)``, decays at ``nu (pi / H)^2``."""
    world = _afloat(viscosity, (0.08, 0.03, 0.03))
    liquid = world.deformables["water"]
    x = liquid.positions.clone()
    mode = torch.sin(x[..., 2] * np.pi / 0.06)
    inner = x[..., 0].abs() < 0.025
    liquid.set_state(x, torch.stack((0.01 * mode, torch.zeros_like(mode), torch.zeros_like(mode)), -1))
    steps = round(40 / viscosity)
    amplitudes = [float((liquid.velocities[..., 0] * mode)[inner].mean()) for _ in range(2) if not world.step(steps)]
    rate = np.log(amplitudes[0] / amplitudes[1]) / (0.0025 * steps)
    assert rate == pytest.approx(viscosity / 1000.0 * (np.pi / 0.06) ** 2, rel=0.15)


def test_a_liquid_thinner_than_its_particles_allow_is_reported(settled: World) -> None:
    (found,) = (a for a in settled.build_report if "viscosity" in a.asked)
    assert (found.subject, found.asked, found.got) == ("'water'", "a viscosity of 0.001 Pa s", "0.15 Pa s")
    thick = build(Scene(deformables=(replace(WATER, viscosity=1.0),)))
    assert thickened(Scene(deformables=(replace(WATER, viscosity=1.0),)), thick) == ()


@pytest.mark.parametrize(("density", "viscosity"), [(300.0, 1e-3), (1000.0, 1.0)])
def test_two_liquids_that_collide_keep_their_momentum(density: float, viscosity: float) -> None:
    """Each took its own density and viscosity for both: a third of the momentum of one appeared from nowhere."""
    x, y = 0.021, 0.004
    one = replace(WATER, pose=Pose((-x, y, 0.0)))
    other = replace(WATER, name="other", density=density, viscosity=viscosity, pose=Pose((x, -y, 0.0)))
    world = _world(objects=(), terrain=(), deformables=(one, other), gravity=(0.0, 0.0, 0.0))
    for spec, speed in ((one, 0.5), (other, -0.5)):
        liquid = world.deformables[spec.name]
        velocities = torch.tensor([speed, 0.0, 0.0]).expand_as(liquid.positions)
        liquid.set_state(liquid.positions.clone(), velocities.clone())

    def momentum() -> torch.Tensor:
        velocities = {spec: world.deformables[spec.name].velocities[0].double().mean(0) for spec in (one, other)}
        return sum(spec.density / one.density * velocity for spec, velocity in velocities.items())

    before = momentum()
    world.step(30)
    assert world.deformables["other"].velocities[0, :, 0].mean() > -0.3
    assert (momentum() - before).norm() < 1e-3


def test_a_liquid_whose_particles_are_larger_than_its_box_is_refused_and_one_of_part_layers_is_reported() -> None:
    with pytest.raises(ArgumentError, match=r"'water'\].spacing is 0.1: give 0.08 m at most, twice the shortest edge"):
        _world(deformables=(replace(WATER, spacing=0.1),))
    film = SceneLayout.of(Scene(deformables=(replace(WATER, half_extents=(0.02, 0.02, 0.003)),)))
    (found,) = rounded(film)
    assert (found.subject, found.asked, found.got) == ("'water'", "0.0096 kg", "0.016 kg")
    assert not rounded(SceneLayout.of(Scene(deformables=(WATER,))))


def test_parameters_that_a_liquid_lacks_are_refused(settled: World) -> None:
    water = settled.deformables["water"]
    for name in ("stiffness", "bending", "friction"):
        with pytest.raises(ArgumentError, match=f"'water' is a liquid, which has no {name}"):
            water.set_parameter(name, torch.ones(2))
    with pytest.raises(ConfigurationError, match="'water' is a Fluid: only the pressure of a SoftBody"):
        water.contact_pressure("right", "right")


def test_a_liquid_that_is_too_thick_is_refused_with_the_viscosity_that_would_do() -> None:
    with pytest.raises(ConfigurationError, match=r"'water' needs .* its viscosity may be 406 Pa s"):
        build(Scene(deformables=(replace(WATER, viscosity=1e4),), physics_dt=0.005))
    assert build(Scene(deformables=(replace(WATER, viscosity=400.0),), physics_dt=0.005)) is not None


def test_divergence_names_the_liquid_and_its_environment_and_the_others_go_on() -> None:
    world = _world(num_envs=3)
    water = world.deformables["water"]
    positions, velocities = water.positions.clone(), torch.zeros_like(water.positions)
    # High above the ground, and about to fall faster than anything may.
    positions[1, :, 2] += 1e5
    velocities[1, :, 2] = -9999.9
    water.set_state(positions, velocities)
    with pytest.raises(SimulationError, match="environments 1 diverged in 'water'"):
        world.step(10)
    world.reset(torch.tensor([1]))
    for _ in range(5):
        world.step()
    assert torch.equal(water.positions[0], water.positions[2])
    assert water.positions.abs().max() < 0.2


def test_liquids_of_two_spacings_are_refused() -> None:
    other = replace(WATER, name="oil", spacing=0.005, pose=Pose((0.2, 0.0, 0.02)))
    with pytest.raises(ConfigurationError, match=r"one spacing.*'water' 0.01 m, 'oil' 0.005 m"):
        build(Scene(deformables=(WATER, other)))


def test_nothing_holds_a_liquid(settled: World) -> None:
    with pytest.raises(ConfigurationError, match="'water' is a liquid, which nothing holds"):
        build(Scene(deformables=(replace(WATER, attachments=(Attachment((0,)),)),)))
    with pytest.raises(ConfigurationError, match="'water' is a liquid, which nothing holds"):
        settled.deformables["water"].anchor([0])


def test_liquid_flows_as_on_a_cpu_where_walls_and_searches_are_as_on_a_gpu() -> None:
    """Within a hundredth of a spacing, by which particles may move and keep their walls, on a CPU for longer."""
    found: list[torch.Tensor] = []
    for wide in (False, True):
        world = _world()
        world.engine._matter._parts[0]._fluid._is_wide = wide
        for _ in range(20):
            world.step()
        found.append(world.deformables["water"].positions.clone())
    assert (found[0] - _world().deformables["water"].positions).abs().max() > 1e-4
    torch.testing.assert_close(found[0], found[1], rtol=0.0, atol=1e-4)
