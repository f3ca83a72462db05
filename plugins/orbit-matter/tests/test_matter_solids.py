"""Elastic solids: their elements, how a surface is embedded, and how worlds hold them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_assets.deformables import ball, cuboid, ring, sheet
from orbit_assets.objects import box
from orbit_core.interfaces import ArgumentError, ConfigurationError, SceneLayout, SimulationError, World
from orbit_core.scene import Attachment, CameraSpec, Channel, Cloth, Fluid, Mesh, Pose, Scene, SoftBody, look_at
from orbit_core.scene.pose import Vector3
from orbit_core.world import simulate
from orbit_matter.solids import element, grid, limits, skin
from orbit_matter.solids.distance import lattice
from orbit_matter.solids.model import build
from orbit_matter.solids.part import SolidPart

MESH = cuboid((0.05, 0.05, 0.05), (2, 2, 2))
BLOCK = SoftBody("block", MESH, 800.0, Pose((0.0, 0.0, 0.026)), 2e5, 0.3)
END = tuple(np.flatnonzero(MESH.vertices[:, 0] < -0.024).tolist())
HELD = replace(BLOCK, name="held", pose=Pose((0.0, 0.2, 0.1)), attachments=(Attachment(END),))
PLATE = box("plate", size=(0.1, 0.1, 0.02), mass=1.0, pose=Pose((0.0, 0.0, 0.01)))
ABOVE = replace(BLOCK, pose=Pose((0.0, 0.0, 0.0455)))
CAMERA = CameraSpec(
    name="eye",
    width=20,
    height=20,
    vertical_fov=0.4,
    pose=look_at(eye=(0.0, -1e-3, 0.5), target=(0.0, 0.0, 0.0)),
    channels=(Channel.DEPTH, Channel.INSTANCE),
)
SCENE = Scene(objects=(PLATE,), deformables=(ABOVE, HELD), sensors=(CAMERA,), physics_dt=0.0025)


# Elements ------------------------------------------------------------------------------------------------------------


def test_an_element_has_exactly_the_six_modes_of_a_rigid_body_without_energy() -> None:
    for fills in (None, np.array([1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.5])):
        points, weights = element.quadrature(fills)
        matrix = element.stiffness(np.array([0.05, 0.02, 0.02]), element.elasticity(1e5, 0.3), points, weights)
        energies = np.linalg.eigvalsh(matrix)
        assert (energies < 1e-9 * energies[-1]).sum() == 6
        assert energies[6] > 1e-5 * energies[-1]


def test_a_uniform_strain_leaves_no_force_on_inner_nodes() -> None:
    part = grid.embed(BLOCK)
    stretch = np.array([[0.01, 0.003, 0.0], [0.0, -0.004, 0.002], [0.001, 0.0, 0.02]])
    forces = (part.assembled() @ (part.nodes @ stretch.T).ravel()).reshape(-1, 3)
    inner = (np.abs(part.nodes) < 0.024).all(axis=1)
    assert inner.sum() == 27
    assert np.abs(forces[inner]).max() < 1e-9 * np.abs(forces).max()


def test_a_bar_has_the_stiffness_of_its_modulus_and_section() -> None:
    part = grid.embed(replace(BLOCK, poissons_ratio=0.0))
    strain = 0.01
    forces = (part.assembled() @ (part.nodes * [strain, 0.0, 0.0]).ravel()).reshape(-1, 3)
    end = part.nodes[:, 0] > 0.0249
    assert forces[end, 0].sum() == pytest.approx(2e5 * strain * 0.05**2)


# Embedding -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mesh", "cells"), [(MESH, 8), (ball(0.05, 3), 8), (cuboid((0.2, 0.02, 0.02)), 4), (ring(0.03, 0.01), 16)]
)
def test_a_surface_is_embedded_with_its_mass_and_its_vertices_in_few_cells(mesh: Mesh, cells: int) -> None:
    part = grid.embed(replace(BLOCK, mesh=mesh))
    assert len(part.cells) == cells
    assert part.masses.sum() == pytest.approx(replace(BLOCK, mesh=mesh).mass)
    assert part.masses.min() > 0.0
    np.testing.assert_allclose(part.weights_of(part.vertices) @ part.nodes, mesh.vertices, atol=1e-12)


def test_a_ring_keeps_its_hole_in_finer_cells() -> None:
    part = grid.embed(replace(BLOCK, mesh=ring(0.03, 0.01), resolution=0.0135))
    assert len(part.cells) == 64
    assert np.hypot(*part.nodes[:, :2].T).min() > 0.01


@pytest.mark.parametrize(
    ("mesh", "volume"),
    [
        (cuboid((0.1, 0.2, 0.3), (1, 2, 3)), 0.006),
        (ball(0.05, 4), 4.0 / 3.0 * np.pi * 0.05**3),
        (ring(0.03, 0.01, (64, 32)), 2.0 * np.pi**2 * 0.03 * 0.01**2),
    ],
)
def test_plain_surfaces_enclose_their_volume(mesh: Mesh, volume: float) -> None:
    assert SoftBody("solid", mesh, 1.0).mass == pytest.approx(volume, rel=0.01)


def test_surfaces_that_are_none_are_refused() -> None:
    with pytest.raises(ArgumentError, match=r"a cuboid is 0\.0 m"):
        cuboid((0.1, 0.0, 0.1))
    with pytest.raises(ArgumentError, match="has 1 particles"):
        cuboid((0.1, 0.1, 0.1), (0, 1, 1))
    with pytest.raises(ArgumentError, match="divided 9 times"):
        ball(0.1, 9)
    with pytest.raises(ArgumentError, match="no hole"):
        ring(0.01, 0.01)


def test_points_of_contact_share_the_area_of_the_surface() -> None:
    found = skin.sampled(MESH.vertices, np.asarray(MESH.faces), 0.00625)
    assert len(found.points) == 386
    assert np.einsum("pii->", found.areas) == pytest.approx(6 * 0.05**2)
    top = found.points[:, 2] > 0.0249
    assert found.areas[top, 2, 2].sum() == pytest.approx(0.05**2), "edges count with one of their sides"
    fine = ball(0.05, 5)
    thinned = skin.sampled(fine.vertices, np.asarray(fine.faces), 0.02)
    assert len(thinned.points) < 0.2 * len(fine.vertices)
    assert np.einsum("pii->", thinned.areas) == pytest.approx(4 * np.pi * 0.05**2, rel=0.01)


def test_written_vertices_turn_and_stretch_all_nodes_exactly() -> None:
    model = build(Scene(deformables=(replace(BLOCK, mesh=ball(0.05, 2)),)), 0.0025)
    part = model.embeddings[0]
    matrix = np.array([[0.0, -1.1, 0.0], [1.0, 0.0, 0.1], [0.0, 0.0, 0.9]])
    written = part.weights_of(part.vertices) @ part.nodes @ matrix.T + 0.3
    np.testing.assert_allclose(model.fits[0] @ written, part.nodes @ matrix.T + 0.3, atol=1e-5)


def test_triangles_that_span_nodes_are_held_between_their_vertices_where_one_thing_holds_these() -> None:
    coarse = cuboid((0.05, 0.05, 0.05), (1, 1, 1))
    top = np.flatnonzero(coarse.vertices[:, 2] > 0.0)
    held = replace(BLOCK, mesh=coarse, attachments=(Attachment(tuple(top.tolist())),))
    model = build(Scene(deformables=(held,)), 0.0025)
    part, own = model.embeddings[0], model.between[0]
    places = part.weights_of(part.between) @ part.nodes
    on_top = model.attached[own] == 1
    assert (on_top == np.isclose(places[:, 2], 0.025)).all()
    # Two cells along an edge have five nodes.
    assert on_top.sum() == 25 - 4
    halves = tuple(Attachment((int(vertex),)) for vertex in top)
    assert build(Scene(deformables=(replace(held, attachments=halves),)), 0.0025).attached[own].sum() == 0
    assert len(grid.embed(replace(BLOCK, mesh=cuboid((0.05, 0.05, 0.05), (4, 4, 4)))).corners) == 0


# Worlds --------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    made = simulate(SCENE, 2, "mujoco", matter="orbit-matter")
    yield made
    made.close()


@pytest.fixture
def fresh(world: World) -> World:
    world.reset()
    return world


def test_a_run_repeats_bit_for_bit_after_a_reset_a_snapshot_and_in_every_environment(fresh: World) -> None:
    block, held = fresh.deformables["block"], fresh.deformables["held"]
    fresh.step(15)
    saved, middle = fresh.save_state(), block.positions.clone()
    fresh.step(15)
    ends = block.positions.clone(), held.positions.clone()
    assert torch.equal(ends[0][0], ends[0][1])
    fresh.load_state(saved)
    assert torch.equal(block.positions, middle)
    fresh.step(15)
    assert torch.equal(block.positions, ends[0])
    fresh.reset()
    fresh.step(30)
    assert torch.equal(block.positions, ends[0])
    assert torch.equal(held.positions, ends[1])


def test_a_block_rests_on_what_feels_its_weight_and_is_seen(fresh: World) -> None:
    block = fresh.deformables["block"]
    fresh.step(150)
    felt = torch.zeros(3)
    for _ in range(20):
        fresh.step(1)
        felt += block.contact_force("plate", "plate")[0] / 20
    assert felt[2].item() == pytest.approx(-9.81 * BLOCK.mass, rel=0.01)
    assert block.positions[0, :, 2].min().item() == pytest.approx(0.02, abs=3e-4)
    assert block.velocities.abs().max() < 5e-3
    eye = fresh.sensors["eye"]
    assert eye.image(Channel.DEPTH)[0, 10, 10, 0].item() == pytest.approx(0.43, abs=2e-3)
    assert eye.image(Channel.INSTANCE)[0, 10, 10, 0] == 1, "after the plate"


def test_a_side_that_the_world_holds_stays_until_it_is_released(fresh: World) -> None:
    held, rest = fresh.deformables["held"], torch.as_tensor(HELD.pose.transform(MESH.vertices), dtype=torch.float32)
    fresh.step(40)
    torch.testing.assert_close(held.positions[0, list(END)], rest[list(END)], rtol=0.0, atol=1e-4)
    assert held.positions[0, :, 2].min() < rest[:, 2].min() - 1e-4, "the other side droops"
    held.release(env_ids=torch.tensor([1]))
    fresh.step(20)
    assert held.positions[1, :, 2].mean() < 0.095
    assert held.positions[0, :, 2].mean() > 0.099


def test_an_environment_moves_alike_whatever_others_are_solved_together_with_it() -> None:
    scene = replace(SCENE, sensors=())
    # Five environments are one group of four and a rest, and one of them lets go, which changes its preconditioner.
    five, one = (simulate(scene, num_envs=n, backend="mujoco", matter_settings={"threads": 1}) for n in (5, 1))
    five.deformables["held"].release(env_ids=torch.tensor([1]))
    for released in (False, True):
        one.reset()
        if released:
            one.deformables["held"].release()
        for _ in range(10):
            one.step()
            if not released:
                five.step()
        alike = [1] if released else [0, 2, 3, 4]
        for name in ("block", "held"):
            alone = one.deformables[name].positions.expand(len(alike), -1, -1)
            assert torch.equal(five.deformables[name].positions[alike], alone)


def test_a_block_follows_the_link_that_it_is_held_by(fresh: World) -> None:
    block = fresh.deformables["block"]
    bottom = np.flatnonzero(MESH.vertices[:, 2] < -0.024).tolist()
    plate = fresh.objects["plate"]
    start, before = block.positions[:, bottom].mean(1), plate.root_pose[:, :3].clone()
    block.anchor(bottom, to=("plate", "plate"))
    plate.set_root_velocity(torch.tensor([[0.3, 0.0, 1.0, 0.0, 0.0, 0.0]]).repeat(2, 1))
    fresh.step(40)
    carried, way = block.positions[:, bottom].mean(1) - start, plate.root_pose[:, :3] - before
    block.release()
    assert way[0, 2] > 0.03
    torch.testing.assert_close(carried, way, rtol=0.0, atol=2e-3)


def test_density_and_stiffness_differ_between_environments(fresh: World) -> None:
    held = fresh.deformables["held"]
    rest = held.positions[0, :, 2].mean().item()
    held.set_parameter("stiffness", torch.tensor([0.25]), torch.tensor([1]))
    fresh.step(60)
    droop = [rest - held.positions[env, :, 2].mean().item() for env in (0, 1)]
    held.set_parameter("stiffness", torch.ones(2))
    assert droop[1] / droop[0] > 2.0
    with pytest.raises(ArgumentError, match="'held' bends as its stiffness says"):
        held.set_parameter("bending", torch.ones(2))


def test_a_mirrored_block_finds_its_shape_again(fresh: World) -> None:
    block = fresh.deformables["block"]
    points = block.positions.clone()
    points[0, :, 0] *= -1.0  # inside out
    points[1, :, :2] *= -1.0  # half a turn
    points[..., 2] += 1.0
    block.set_state(points)
    fresh.step(120)
    x = block.positions.double()
    rest = torch.as_tensor(MESH.vertices)
    assert (torch.cdist(x, x) - torch.cdist(rest, rest)).abs().max() < 1e-5


def test_divergence_names_environment_and_solid_and_the_others_go_on() -> None:
    own = simulate(Scene(deformables=(BLOCK,)), 2, "mujoco", matter="orbit-matter")
    body = own.deformables["block"]
    far = body.positions[1:].clone() + 9.9999e5
    fast = torch.zeros_like(far)
    fast[..., 0] = 9.9e3
    body.set_state(far, fast, torch.tensor([1]))
    with pytest.raises(SimulationError, match="environments 1 diverged in 'block'"):
        own.step(10)
    assert body.positions[0].abs().max() < 1.0
    own.reset(torch.tensor([1]))
    own.step(5)
    assert torch.equal(body.velocities.isfinite().all(), torch.tensor(True))
    own.close()


TOP = replace(BLOCK, name="top", pose=Pose((0.004, 0.0, 0.0965)))
COVER = Cloth("cover", sheet((0.08, 0.08), (9, 9)), 0.3, Pose((0.0, 0.0, 0.13)), thickness=0.003)


def test_solids_carry_each_other_and_cloth_and_all_are_felt_below() -> None:
    pile = Scene(objects=(PLATE,), deformables=(ABOVE, TOP, COVER), physics_dt=0.0025)
    own = simulate(pile, 1, "mujoco", matter="orbit-matter")
    block, top, cover = (own.deformables[name] for name in ("block", "top", "cover"))
    own.step(200)
    felt = sum(block.contact_force("plate", "plate")[0, 2] for _ in range(40) if own.step(1) is None) / 40
    heights = [float(each.positions[0, :, 2].mean()) for each in (block, top)]
    laid = float(cover.positions[0, 40, 2])
    own.close()
    weight = 9.81 * (block.spec.mass + top.spec.mass + COVER.area_density * 0.08**2)
    assert felt == pytest.approx(-weight, rel=0.02)
    assert heights == pytest.approx([0.0445, 0.094], abs=1.5e-3)
    assert laid == pytest.approx(0.121, abs=2e-3), "on top of both"


def test_a_solid_pushes_another_as_hard_as_it_is_pushed() -> None:
    pair = tuple(replace(BLOCK, name=name, pose=Pose((x, 0.0, 0.1))) for name, x in (("left", -0.03), ("right", 0.03)))
    scene = Scene(deformables=pair, terrain=(), gravity=(0.0, 0.0, 0.0), physics_dt=0.0025)
    own = simulate(scene, 1, "mujoco", matter="orbit-matter")
    bodies = own.deformables["left"], own.deformables["right"]
    bodies[0].set_state(bodies[0].positions, torch.tensor([0.5, 0.0, 0.0]).expand_as(bodies[0].positions))
    own.step(80)
    speeds = [float(each.velocities[0, :, 0].mean()) for each in bodies]
    gap = float(bodies[1].positions[0, :, 0].min() - bodies[0].positions[0, :, 0].max())
    own.close()
    assert gap > 0.0
    assert sum(speeds) == pytest.approx(0.5, abs=0.01), "momentum is kept"
    assert speeds[1] > 0.3


def test_distances_to_a_ball_are_those_to_its_middle() -> None:
    spec = replace(BLOCK, mesh=ball(0.05, 4))
    found = lattice(spec, grid.embed(spec))
    index = np.stack(np.meshgrid(*(np.arange(n) for n in found.values.shape), indexing="ij"), -1)
    away = np.linalg.norm(found.low + index * found.spacing, axis=-1)
    np.testing.assert_allclose(found.values, away - 0.05, atol=3e-4)


def test_kernels_of_a_gpu_compute_what_those_of_a_cpu_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def after() -> torch.Tensor:
        own = simulate(replace(SCENE, deformables=(ABOVE, HELD, TOP), sensors=()), 2, "mujoco", matter="orbit-matter")
        own.step(20)
        # From here on the environments have different preconditioners, in one tile of their product.
        own.deformables["held"].release(env_ids=torch.tensor([1]))
        own.step(20)
        found = torch.cat([body.positions for body in own.deformables.values()], dim=1).clone()
        own.close()
        return found

    in_rows = after()
    monkeypatch.setattr(SolidPart, "takes_rows", property(lambda part: False))
    torch.testing.assert_close(after(), in_rows, rtol=0.0, atol=1e-5)


# Mistakes ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("thing", "what"),
    [
        (replace(BLOCK, mesh=Mesh(MESH.vertices, MESH.faces[1:])), "not closed at the edge of vertices"),
        (replace(BLOCK, mesh=Mesh(MESH.vertices, MESH.faces[:, ::-1])), "inside out"),
        (replace(BLOCK, mesh=Mesh(MESH.vertices * [1, 1, 0], MESH.faces)), "no area|plane"),
        (replace(BLOCK, resolution=0.0), "resolution"),
        (replace(BLOCK, damping=-1.0), "damping"),
        (replace(BLOCK, poissons_ratio=0.5), "poissons_ratio"),
    ],
)
def test_a_solid_that_cannot_be_is_refused(thing: SoftBody, what: str) -> None:
    with pytest.raises(ArgumentError, match=what):
        simulate(Scene(deformables=(thing,)), 1, "mujoco", matter="orbit-matter")


@pytest.mark.parametrize(
    ("thing", "what"),
    [
        (replace(BLOCK, youngs_modulus=1e12), "'block' is too stiff .* a physics_dt of 0.0005 s would do"),
        (replace(BLOCK, resolution=0.004), "a resolution of 0.01 m would do"),
        (replace(BLOCK, mesh=Mesh(MESH.vertices * [1, 1, 1e-4], MESH.faces)), "'block' is 5e-06 m thick .* or a Cloth"),
    ],
)
def test_a_solid_that_cannot_be_computed_is_refused_with_what_would_do(thing: SoftBody, what: str) -> None:
    with pytest.raises(ConfigurationError, match=what):
        simulate(Scene(deformables=(thing,)), 1, "mujoco", matter="orbit-matter")


SMALL = cuboid((0.02, 0.02, 0.02), (2, 2, 2))


def _joined(*parts: tuple[Mesh, Vector3]) -> Mesh:
    """Surfaces, each moved by metres, as one mesh."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh, _ in parts)])
    vertices = np.concatenate([mesh.vertices + np.array(way) for mesh, way in parts])
    faces = np.concatenate([np.asarray(mesh.faces) + start for (mesh, _), start in zip(parts, starts, strict=False)])
    return Mesh(vertices, faces)


def test_a_piece_that_is_inside_out_is_refused_and_a_cavity_is_not() -> None:
    inverted = Mesh(SMALL.vertices, SMALL.faces[:, ::-1])
    outside = replace(BLOCK, mesh=_joined((MESH, (0.0, 0.0, 0.0)), (inverted, (0.2, 0.0, 0.0))))
    with pytest.raises(ArgumentError, match="has a piece that is inside out"):
        simulate(Scene(deformables=(outside,)), 1, "mujoco", matter="orbit-matter")
    hollow = replace(BLOCK, mesh=_joined((MESH, (0.0, 0.0, 0.0)), (inverted, (0.0, 0.0, 0.0))))
    assert hollow.volume < BLOCK.volume
    solid = replace(BLOCK, mesh=_joined((MESH, (0.0, 0.0, 0.0)), (SMALL, (0.0, 0.0, 0.0))))
    with pytest.raises(ArgumentError, match="or turn the wall of a cavity inside out"):
        simulate(Scene(deformables=(solid,)), 1, "mujoco", matter="orbit-matter")
    simulate(Scene(deformables=(hollow,)), 1, "mujoco", matter="orbit-matter").close()


@pytest.mark.parametrize(("way", "share"), [(0.0, 1.0), (0.03, 0.4**2 * 0.98)])
def test_pieces_that_overlap_are_refused(way: float, share: float) -> None:
    twice = replace(BLOCK, mesh=_joined((MESH, (0.0, 0.0, 0.0)), (MESH, (way, way, 0.001 if way else 0.0))))
    with pytest.raises(ArgumentError, match="pieces that overlap, which would weigh") as error:
        simulate(Scene(deformables=(twice,)), 1, "mujoco", matter="orbit-matter")
    found = int(str(error.value).split("weigh ")[1].split(" %")[0])
    assert found == pytest.approx(100.0 * share / (2.0 - share), abs=2.0)


def test_a_surface_that_crosses_itself_is_refused() -> None:
    """The middle of a block's upper side is pulled through its floor."""
    vertices = MESH.vertices.copy()
    vertices[np.linalg.norm(vertices - [0.0, 0.0, 0.025], axis=1).argmin(), 2] = -0.1
    with pytest.raises(ArgumentError, match=r"crosses itself: .* inside out"):
        simulate(Scene(deformables=(replace(BLOCK, mesh=Mesh(vertices, MESH.faces)),)), 1, "mujoco")


def test_pieces_that_do_not_touch_are_refused() -> None:
    apart = replace(BLOCK, mesh=_joined((MESH, (0.0, 0.0, 0.0)), (SMALL, (0.3, 0.0, 0.0))))
    with pytest.raises(ConfigurationError, match="'block' is of 2 pieces that do not touch"):
        simulate(Scene(deformables=(apart,)), 1, "mujoco", matter="orbit-matter")


@pytest.mark.parametrize("way", [0.0, 0.02])
def test_solids_that_begin_in_each_other_are_refused(way: float) -> None:
    x, y, z = BLOCK.pose.position
    other = replace(BLOCK, name="other", pose=Pose((x + way, y, z)))
    with pytest.raises(ConfigurationError, match=r"'block' begins .* inside 'other'"):
        simulate(Scene(deformables=(BLOCK, other)), 1, "mujoco", matter="orbit-matter")


def test_a_liquid_that_begins_in_a_solid_is_refused() -> None:
    water = Fluid("water", (0.02, 0.02, 0.02), pose=Pose((0.028, 0.0, 0.026)), spacing=0.01)
    with pytest.raises(ConfigurationError, match="32 of the 64 particles of 'water' are inside soft body 'block'"):
        simulate(Scene(deformables=(water, BLOCK)), 1, "mujoco", matter="orbit-matter")


WALL = box("wall", (0.05, 0.05, 0.05), fixed_base=True, pose=Pose((0.029, 0.0, 0.026)))


@pytest.mark.parametrize(
    ("scene", "what"),
    [
        (Scene(deformables=(BLOCK,), objects=(WALL,)), r"'block' begins 0\.021 m inside link 'wall'"),
        (Scene(deformables=(replace(BLOCK, pose=Pose()),)), r"'block' begins 0\.025 m inside the terrain"),
    ],
)
def test_a_solid_that_begins_in_a_rigid_thing_is_refused(scene: Scene, what: str) -> None:
    with pytest.raises(ConfigurationError, match=what):
        simulate(scene, 1, "mujoco", matter="orbit-matter")


def test_the_build_report_names_what_sinks_into_itself_and_plates_that_are_thin() -> None:
    tall = replace(BLOCK, mesh=Mesh(1000.0 * MESH.vertices, MESH.faces), pose=Pose((0.0, 0.0, 26.0)))
    (found,) = limits.squeezed(SceneLayout.of(Scene(deformables=(tall, replace(HELD, pose=Pose((90.0, 0.0, 1.0)))))))
    assert found.subject == "'block'"
    assert "is its mesh in metres" in found.why
    plates = tuple(box(name, (0.2, 0.2, z), pose=Pose((0.0, 0.0, -z))) for name, z in (("foil", 1e-3), ("slab", 6e-3)))
    (found,) = limits.thin_plates(SceneLayout.of(Scene(objects=plates, deformables=(BLOCK,), terrain=())), 1.25e-3)
    assert found.subject == "link 'foil' of 'foil'"
    assert found.got == "lets those pass that meet it at more than 0.4 m/s"


def test_the_build_report_names_light_bodies() -> None:
    light = replace(SCENE, objects=(box("plate", (0.1, 0.1, 0.02), mass=0.01, pose=PLATE.pose),), sensors=())
    own = simulate(light, 1, "mujoco", matter="orbit-matter")
    said = [str(each) for each in own.build_report]
    own.close()
    assert any("'plate'" in each and "hops" in each and "0.03 kg would do" in each for each in said)


# Hanging and writing -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("when", ["attached", "anchored"])
def test_a_block_that_hangs_by_the_corners_of_its_face_stretches_under_its_weight(when: str) -> None:
    length, modulus, mesh = 0.1, 5e4, cuboid((0.05, 0.05, 0.1), (1, 1, 2))
    low, top = (np.flatnonzero(mesh.vertices[:, 2] * way > 0.04).tolist() for way in (-1, 1))
    held = (Attachment(tuple(top)),) if when == "attached" else ()
    block = SoftBody("block", mesh, 1000.0, Pose((0.0, 0.0, 1.0)), modulus, 0.0, damping=0.05, attachments=held)
    world = simulate(Scene(deformables=(block,), physics_dt=0.0025), 1, "mujoco", matter="orbit-matter")
    hanging = world.deformables["block"]
    if when == "anchored":
        hanging.anchor(top)
    world.step(200)
    stretch = 1.0 - 0.5 * length - float(hanging.positions[0, low, 2].mean())
    # What holds gives way by a tenth more.
    assert stretch == pytest.approx(1000.0 * 9.81 * length**2 / (2.0 * modulus), rel=0.15)
    hanging.release()
    before = hanging.positions[0, top, 2].mean()
    world.step(20)
    assert float(before - hanging.positions[0, top, 2].mean()) > 0.008, "nothing holds it any more"
    world.close()


def test_a_solid_that_is_written_leaves_what_others_stick_to() -> None:
    sliding = tuple(replace(BLOCK, name=name, pose=Pose((x, 0.0, 0.026))) for name, x in (("one", 0.0), ("two", 0.2)))
    scene = Scene(deformables=sliding, physics_dt=0.0025, gravity=(2.0, 0.0, -9.6))
    ends = []
    for written in (False, True):
        world = simulate(scene, 1, "mujoco", matter="orbit-matter")
        world.step(20)
        if written:
            world.deformables["one"].set_state(world.deformables["one"].positions.clone())
        world.step(5)
        ends.append(world.deformables["two"].positions.clone())
        world.close()
    assert torch.equal(*ends)
