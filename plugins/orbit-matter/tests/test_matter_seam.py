"""What worlds, snapshots, pictures and mistakes come to with cloth and rope."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from orbit_assets.deformables import corners, line, sheet
from orbit_assets.objects import box
from orbit_core.dynamics.transforms import quat_rotate, quat_rotate_inverse
from orbit_core.interfaces import ArgumentError, ConfigurationError, UnknownNameError, UnsupportedCapabilityError, World
from orbit_core.scene import (
    Attachment,
    CameraSpec,
    Channel,
    Cloth,
    Fluid,
    KeyPoint,
    Mesh,
    Pose,
    Region,
    Rope,
    Scene,
    SoftBody,
    look_at,
)
from orbit_core.world import simulate
from orbit_matter import substeps
from orbit_matter.part import Part

COUNTS = (9, 9)
CLOTH = Cloth("cloth", sheet((0.2, 0.2), COUNTS), 0.2, Pose((0.0, 0.0, 0.15)), key_points=corners(COUNTS))
ROPE = Rope("rope", line(0.2, 11), 0.1, Pose((0.0, 0.3, 0.1)))
BLOCK = box("block", size=(0.1, 0.1, 0.1), mass=0.5, pose=Pose((0.0, 0.0, 0.05)))
CAMERA = CameraSpec(
    name="eye",
    width=40,
    height=40,
    vertical_fov=0.8,
    pose=look_at(eye=(0.0, -1e-3, 0.65), target=(0.0, 0.0, 0.0)),
    channels=(Channel.RGB, Channel.DEPTH, Channel.NORMALS, Channel.INSTANCE, Channel.SEMANTIC),
)
SCENE = Scene(objects=(BLOCK,), deformables=(CLOTH, ROPE), sensors=(CAMERA,))


@pytest.fixture(scope="module", params=["orbit-matter", "native"])
def solver(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def world(solver: str) -> Iterator[World]:
    made = simulate(SCENE, 3, "mujoco", matter=solver)
    yield made
    made.close()


@pytest.fixture
def fresh(world: World) -> World:
    world.reset()
    return world


def test_a_run_repeats_bit_for_bit_after_a_reset_a_snapshot_and_in_every_environment(fresh: World) -> None:
    body = fresh.deformables["cloth"]
    fresh.step(30)
    saved, middle = fresh.save_state(), body.positions.clone()
    fresh.step(30)
    end = body.positions.clone()
    assert torch.equal(end[0], end[1])
    assert torch.equal(end[0], end[2])
    fresh.load_state(saved)
    assert torch.equal(body.positions, middle)
    fresh.step(30)
    assert torch.equal(body.positions, end)
    fresh.reset()
    fresh.step(60)
    assert torch.equal(body.positions, end)


def test_kernels_of_a_cpu_compute_the_bits_of_those_of_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    def fallen() -> torch.Tensor:
        world = simulate(SCENE, 2, "mujoco", matter="orbit-matter")
        world.step(50)
        found = world.deformables["cloth"].positions.clone()
        world.close()
        return found

    in_rows = fallen()
    monkeypatch.setattr(Part, "takes_rows", property(lambda part: False))
    assert torch.equal(fallen(), in_rows)


def test_a_reset_of_one_environment_leaves_the_others_alone(fresh: World) -> None:
    fresh.step(20)
    before = fresh.deformables["cloth"].positions.clone()
    fresh.reset(torch.tensor([1]))
    after = fresh.deformables["cloth"].positions
    assert torch.equal(after[[0, 2]], before[[0, 2]])
    rest = CLOTH.pose.transform(CLOTH.rest_positions)
    torch.testing.assert_close(after[1], torch.as_tensor(rest, dtype=torch.float32))


def test_cloth_drapes_over_a_block_and_covers_less(fresh: World) -> None:
    body = fresh.deformables["cloth"]
    flat = body.covered_area[0].item()
    assert flat == pytest.approx(0.04, rel=0.04)
    fresh.step(120)
    points = body.positions[0]
    assert points[:, 2].min() > 0.0, "nothing falls through the ground"
    inside = (points[:, :2].abs() < 0.045).all(1)
    assert points[inside, 2].min() > 0.099, "nor through the block"
    assert body.covered_area[0].item() < 0.98 * flat
    assert body.key_point("middle")[0, 2].item() == pytest.approx(0.102, abs=0.002)
    over = Region((0.06, 0.06, 0.05), Pose((0.0, 0.0, 0.05)), "block", "block")
    assert 0.2 < body.share_inside(over)[0].item() < 0.9


def test_particles_are_anchored_to_a_link_carried_and_released(fresh: World) -> None:
    body = fresh.deformables["rope"]
    body.anchor([0], to=("block", "block"), env_ids=torch.tensor([0]))
    start, pose = body.positions[:, 0].clone(), fresh.objects["block"].root_pose.clone()
    place = quat_rotate_inverse(pose[0, 3:], start[0] - pose[0, :3])
    pose[:, 2] += 0.01
    fresh.objects["block"].set_root_pose(pose)
    fresh.step(20)
    now = fresh.objects["block"].root_pose[0]
    torch.testing.assert_close(body.positions[0, 0], now[:3] + quat_rotate(now[3:], place), rtol=0, atol=1e-3)
    moved = body.positions[:, 0] - start
    assert moved[1:, 2].max() < 0.0
    body.release()
    fresh.step(60)
    assert body.positions[0, 0, 2] < 0.05


def test_parameters_differ_between_environments(fresh: World) -> None:
    body = fresh.deformables["cloth"]
    body.set_parameter("density", torch.tensor([1.0, 2.0, 1.0]))
    body.set_parameter("bending", torch.tensor([20.0]), torch.tensor([2]))
    fresh.step(150)
    forces = torch.stack([_stepped(fresh, body) for _ in range(50)]).mean(0)
    assert forces[1, 2].item() == pytest.approx(2.0 * forces[0, 2].item(), rel=0.2)
    assert not torch.equal(body.positions[0], body.positions[2])
    body.set_parameter("density", torch.ones(3))
    body.set_parameter("bending", torch.ones(3))


def _stepped(world: World, body) -> torch.Tensor:
    world.step(1)
    return body.contact_force("block", "block").clone()


def test_pictures_show_cloth_in_colour_depth_normals_and_segmentation(fresh: World) -> None:
    fresh.step(1)
    eye = fresh.sensors["eye"]
    depth, instance = eye.image(Channel.DEPTH)[0, ..., 0], eye.image(Channel.INSTANCE)[0, ..., 0]
    semantic, normals = eye.image(Channel.SEMANTIC)[0, ..., 0], eye.image(Channel.NORMALS)[0]
    assert depth[20, 20].item() == pytest.approx(0.5, abs=2e-3)
    assert instance[20, 20] == 1, "after the block"
    assert (instance == 2).any() == False, "the rope lies beside the picture"  # noqa: E712
    assert eye.semantic_labels[int(semantic[20, 20])] == "cloth"
    assert normals[20, 20, 2] > 0.99
    red, green, blue = eye.image(Channel.RGB)[0, 20, 20].tolist()
    assert red > green
    assert red > blue
    shown = (instance == 1).sum().item() * (2 * 0.5 * np.tan(0.4) / 40) ** 2
    assert shown == pytest.approx(0.04, rel=0.1)


def test_contact_sensors_feel_matter(solver: str) -> None:
    held = replace(CLOTH, pose=Pose((0.0, 0.0, 0.104)))
    from orbit_core.scene import ContactSensorSpec

    scene = Scene(objects=(BLOCK,), deformables=(held,), sensors=(ContactSensorSpec(name="touch", entity="block"),))
    own = simulate(scene, 1, "mujoco", matter=solver)
    own.step(200)
    force = own.sensors["touch"].forces[0, 0, 2].item()
    own.close()
    assert force == pytest.approx(0.5 * 9.81, rel=0.03), "in balance: ground and cloth together carry its weight"


@pytest.mark.parametrize(
    ("thing", "what"),
    [
        (replace(CLOTH, attachments=(Attachment((81,)),)), "particle 81: it has 81"),
        (replace(CLOTH, key_points=(KeyPoint("far", (-1,)),)), "key point 'far'"),
        (replace(CLOTH, attachments=(Attachment((0,), "blok", "x"),)), "'blok'"),
        (replace(CLOTH, attachments=(Attachment((0,), "block", "x"),)), "link 'x'"),
        (replace(CLOTH, area_density=0.0), "area_density"),
        (replace(CLOTH, poissons_ratio=1.0), "poissons_ratio"),
        (replace(ROPE, points=np.zeros((3, 2))), "points"),
        (replace(ROPE, radius=float("nan")), "radius"),
        (replace(ROPE, radius=1.0), "radius is 1.0: give 0.2 m at most"),
        (replace(ROPE, points=np.zeros((1, 3))), "1 particles: give two"),
        (replace(CLOTH, attachments=(Attachment(()),)), "holds no particles"),
        (replace(CLOTH, attachments=(Attachment((0,), link="block"),)), "of no entity"),
        (replace(CLOTH, attachments=(Attachment((0,), "block"),)), "to no link of 'block'"),
        (replace(CLOTH, key_points=(KeyPoint("odd", (0, 1), (0.5, 0.6)),)), "sum up to 1.1"),
        (replace(CLOTH, name="block"), "has the name of a robot or an object"),
        (replace(CLOTH, key_points=(KeyPoint("a", (0,)), KeyPoint("a", (1,)))), "named 'a'"),
        (replace(CLOTH, attachments=(Attachment((3,)), Attachment((3,), "block", "block"))), "hold particle 3"),
        (replace(CLOTH, membrane_stiffness=1e-4), "give 0.001"),
        (replace(CLOTH, mesh=Mesh(CLOTH.rest_positions, np.vstack((CLOTH.mesh.faces, (0, 1, 2))))), "has no area"),
        (replace(CLOTH, mesh=Mesh(CLOTH.rest_positions, np.tile(CLOTH.mesh.faces, (2, 1)))), "a triangle twice"),
        (replace(CLOTH, mesh=Mesh(CLOTH.rest_positions, CLOTH.mesh.faces[2:66])), "is in no triangle"),
        (replace(ROPE, points=np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0, 0]])), "particles 1 and 2"),
        (Fluid("water", (0.1, 0.1, -0.1)), "three lengths above 0"),
        (Fluid("water", (0.1, 0.1, 0.1), spacing=1e-5), "8e.12 particles"),
        (Fluid("water", (1e7, 0.1, 0.1), spacing=1.0), r"1e\+06 m at most"),
        (replace(CLOTH, name=""), r"deformables\[.*\] has no name"),
        (replace(ROPE, name=" "), r"deformables\[.*\] has no name"),
        (replace(CLOTH, key_points=(KeyPoint("", (0,)),)), "key point 0 of 'cloth' has no name"),
        (replace(CLOTH, key_points=(KeyPoint("a", (1, 1)),)), "'a' of 'cloth' names a particle twice"),
        (replace(ROPE, points=1e9 * ROPE.points), r"beyond 1e\+06 m"),
        (replace(ROPE, points=1e200 * ROPE.points), r"beyond 1e\+06 m"),
        (SoftBody("block of foam", CLOTH.mesh, 100.0), "no volume"),
    ],
)
def test_what_cannot_be_is_refused_by_name(thing: Cloth | Rope | SoftBody | Fluid, what: str) -> None:
    with pytest.raises(ArgumentError, match=what):
        simulate(Scene(objects=(BLOCK,), deformables=(thing,)), 1, "mujoco")


def test_what_the_solver_cannot_do_is_refused_with_the_reason() -> None:
    soft = SoftBody("soft", _tetrahedron(), 1000.0)
    with pytest.raises(UnsupportedCapabilityError, match="soft bodies"):
        simulate(Scene(deformables=(soft,)), 1, "sapien", matter="native")
    with pytest.raises(UnsupportedCapabilityError, match="fluids"):
        simulate(Scene(deformables=(Fluid("water", (0.1, 0.1, 0.1)),)), 1, "mujoco", matter="native")
    with pytest.raises(UnsupportedCapabilityError, match="cloth"):
        simulate(Scene(deformables=(CLOTH,)), 1, "sapien", matter="native")
    with pytest.raises(UnknownNameError, match="orbit-matter"):
        simulate(Scene(deformables=(CLOTH,)), 1, "mujoco", matter="orbit-mater")
    bent = Mesh(CLOTH.rest_positions + np.outer(np.abs(CLOTH.rest_positions[:, 0]), (0, 0, 1)), CLOTH.mesh.faces)
    with pytest.raises(ConfigurationError, match="not flat"):
        simulate(Scene(deformables=(replace(CLOTH, mesh=bent),)), 1, "mujoco")
    with pytest.raises(ConfigurationError, match="'substep' are a matter solver's"):
        simulate(Scene(deformables=(CLOTH,)), 1, "mujoco", matter="native", matter_settings={"substep": 1e-3})
    with pytest.raises(ConfigurationError, match="substep"):
        simulate(Scene(deformables=(CLOTH,)), 1, "mujoco", matter_settings={"substep": 0.0})


def _tetrahedron() -> Mesh:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    return Mesh(vertices, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))


def test_kernels_that_are_compiled_first_are_told_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import warp as wp

    from orbit_matter import kernels, rows
    from orbit_warpkit import loading

    loaded: list[str] = []
    monkeypatch.setattr(loading.wp, "load_module", lambda module, **rest: loaded.append(module.__name__))
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    (tmp_path / wp.get_module(rows.__name__).get_module_identifier(1)).mkdir()
    loading.load_kernels("matter", (kernels, rows), wp.get_device("cpu"))
    assert loaded == ["orbit_matter.kernels", "orbit_matter.rows"]
    told = capsys.readouterr().err
    assert "matter: compiling kernels, once on this machine: orbit_matter.kernels (1 of 1) ..." in told
    assert "rows" not in told


def test_calls_that_mean_nothing_are_refused(fresh: World) -> None:
    body = fresh.deformables["cloth"]
    with pytest.raises(ArgumentError, match="points of 'cloth' are held to"):
        body.anchor([0], to="block")  # pyright: ignore[reportArgumentType]
    for region, what in (
        (Region((0.1, 0.1, -0.1)), "half_extents"),
        (Region((0.1, 0.1, 0.1), entity="block"), "give both, or neither"),
        (None, "give a Region"),
    ):
        with pytest.raises(ArgumentError, match=what):
            body.share_inside(region)  # pyright: ignore[reportArgumentType]


def test_what_sinks_by_its_weight_is_reported() -> None:
    own = simulate(Scene(deformables=(replace(CLOTH, area_density=1e3),)), 1, "mujoco", matter="orbit-matter")
    assert [(line.asked, line.got) for line in own.build_report if line.subject == "'cloth'"] == [
        ("resting on things", "sinks into them or through")
    ]
    own.close()


@pytest.mark.parametrize("held", [True, False])
def test_cloth_that_would_not_bear_a_free_body_is_reported(held: bool) -> None:
    """Half of 1 kg at each side of a cloth that is held there: told of unless it lies free, or the substep is short."""
    cloth = replace(CLOTH, attachments=(Attachment((0, 1)),) if held else ())
    scene = Scene(objects=(box("load", (0.1, 0.1, 0.1), mass=1.0),), deformables=(cloth,))
    told = [line.asked for line in substeps.report(scene, 8e-4, 1)]
    assert ("bearing 'load', should it lie on it" in told) == held
    assert not [line for line in substeps.report(scene, 1e-5, 1) if "load" in line.asked]


def test_a_substep_without_end_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="give 1e-06 s or more"):
        simulate(SCENE, 1, "mujoco", matter="orbit-matter", matter_settings={"substep": 1e-12})


def test_particles_too_light_to_be_computed_are_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"the particles of 'cloth' weigh 4\.9e-11 kg"):
        simulate(Scene(deformables=(replace(CLOTH, area_density=1e-7),)), 1, "mujoco", matter="orbit-matter")


def test_more_particles_than_memory_are_refused_with_how_many_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orbit_core.world.checks.free_bytes", lambda device: 100_000)
    with pytest.raises(ConfigurationError, match=r"at most 8 fit.*81 particles in each, of which 62 fit"):
        simulate(Scene(deformables=(CLOTH,)), 10, "mujoco", matter="orbit-matter")


def test_a_device_that_the_solver_lacks_is_refused() -> None:
    from orbit_core.backends import matter_solver
    from orbit_core.interfaces import Capabilities, Capability, SceneLayout, unsupported
    from orbit_core.world.matter import coupled

    engine = SimpleNamespace(device=torch.device("cuda"), num_envs=1)
    solver = matter_solver("orbit-matter")
    lacking = Capabilities({Capability.GPU: unsupported("it is slow there")})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(solver), "capabilities", lambda self: lacking)
        with pytest.raises(UnsupportedCapabilityError, match="'orbit-matter' does not compute on 'cuda'"):
            coupled(engine, SceneLayout.of(Scene(deformables=(CLOTH,))), solver, None)  # pyright: ignore[reportArgumentType]


def test_divergence_names_environment_and_deformable_and_the_others_go_on(solver: str) -> None:
    from orbit_core.interfaces import SimulationError

    own = simulate(Scene(deformables=(CLOTH,)), 2, "mujoco", matter=solver)
    body = own.deformables["cloth"]
    fast = torch.zeros(1, 81, 3)
    fast[..., 0] = 9.9e3
    body.set_state(body.positions[1:].clone() + 9.9999e5, fast, torch.tensor([1]))
    with pytest.raises(SimulationError, match="environments 1 diverged in 'cloth'"):
        own.step(10)
    assert body.positions[0].abs().max() < 1.0
    own.reset(torch.tensor([1]))
    own.step(1)
    own.close()


@pytest.mark.parametrize(
    ("size", "counts", "what"),
    [
        ((0.0, 0.2), (5, 5), "0.0 m"),
        ((0.2, float("nan")), (5, 5), "nan m"),
        ((0.2, 0.2), (1, 5), "1 particles"),
        ((0.2, 0.2), (2.5, 5), "2.5 particles"),
    ],
)
def test_a_sheet_or_line_that_is_none_is_refused(size: tuple, counts: tuple, what: str) -> None:
    with pytest.raises(ArgumentError, match=what):
        sheet(size, counts)
    with pytest.raises(ArgumentError, match=what):
        line(min(size, key=lambda length: length > 0.0), min(counts))
