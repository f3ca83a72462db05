"""MuJoCo's own solids: what is particular to them; scenarios hold the rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_assets.deformables import ball, cuboid, ring
from orbit_assets.objects import box
from orbit_core.interfaces import ConfigurationError, SimulationError, UnsupportedCapabilityError, World
from orbit_core.scene import Attachment, CameraSpec, Channel, Pose, RayCasterSpec, Scene, SoftBody, look_at
from orbit_core.world import simulate
from orbit_mjmodel.solids import CORNERS, embed, skin

MESH = cuboid((0.05, 0.05, 0.05), (2, 2, 2))
END = tuple(np.flatnonzero(MESH.vertices[:, 0] < -0.024).tolist())
BLOCK = SoftBody("block", MESH, 800.0, Pose.from_euler(0.3, 0.2, 0.1, (0.0, 0.0, 1.0)), 2e5, 0.3)
HELD = replace(BLOCK, name="held", pose=Pose((0.0, 0.2, 1.0)), attachments=(Attachment(END),))


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    made = simulate(Scene(deformables=(BLOCK, HELD), terrain=()), 2, "mujoco", matter="native")
    yield made
    made.close()


@pytest.fixture
def fresh(world: World) -> World:
    world.reset()
    return world


def test_a_grid_has_the_mass_of_its_solid_its_middle_and_its_inertia() -> None:
    for mesh, moment in ((MESH, 0.05**2 / 12.0), (ball(0.05, 2), 0.05**2 / 5.0)):
        spec = replace(BLOCK, mesh=mesh)
        grid = embed(spec)
        assert grid.masses.sum() == pytest.approx(spec.mass, rel=1e-9)
        middle = grid.masses @ grid.nodes / spec.mass
        assert middle == pytest.approx(np.zeros(3), abs=1e-4)
        assert grid.masses @ grid.nodes**2 / spec.mass == pytest.approx(np.full(3, moment), rel=0.05)


def test_a_bent_cell_resists_as_a_beam_does_and_not_as_one_that_locks() -> None:
    """Ends that turn towards each other, without shear: the energy of a curvature is ``E I k^2 L / 2``."""
    spec = replace(BLOCK, mesh=cuboid((0.02, 0.02, 0.02), (1, 1, 1)), resolution=0.02, poissons_ratio=0.0)
    grid = embed(spec)
    x, z = (CORNERS[:, axis] * 0.02 - 0.01 for axis in (0, 2))
    curvature = 0.1
    bent = np.stack((-curvature * x * z, np.zeros(8), np.zeros(8)), axis=1).ravel()
    energy = 0.5 * bent @ grid.stiffness[0] @ bent
    assert energy == pytest.approx(0.5 * spec.youngs_modulus * 0.02**4 / 12.0 * curvature**2 * 0.02, rel=1e-6)


def test_a_solid_is_where_it_is_put_and_moves_as_it_is_told(fresh: World) -> None:
    """A stretch and a turn, which a grid can take whole, in one environment alone."""
    body = fresh.deformables["block"]
    shape = torch.tensor([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.3], [0.0, 0.1, 1.2]])
    points = torch.as_tensor(MESH.vertices).float() @ shape.T + torch.tensor([0.1, 0.2, 1.5])
    moving = points @ shape
    body.set_state(points[None], moving[None], torch.tensor([1]))
    torch.testing.assert_close(body.positions[1], points, rtol=0, atol=1e-6)
    torch.testing.assert_close(body.velocities[1], moving, rtol=0, atol=1e-5)
    assert body.velocities[0].abs().max() == 0.0


def test_what_a_grid_cannot_take_is_taken_as_near_as_it_can(fresh: World) -> None:
    """One vertex of a face is pulled out: its cells follow within a part of the way, and the others stay."""
    body = fresh.deformables["block"]
    points = body.positions[:1].clone()
    corner = int(np.abs(MESH.vertices - 0.025).sum(axis=1).argmin())
    points[0, corner] += 0.01
    body.set_state(points, env_ids=torch.tensor([0]))
    assert (body.positions[0] - points[0]).abs().max().item() < 1e-5, "a corner of the mesh is a node"


def test_held_ends_stay_and_what_is_let_go_falls_with_its_snapshot(fresh: World) -> None:
    held, free = fresh.deformables["held"], fresh.deformables["block"]
    before = held.positions[:, list(END)].clone()
    saved = fresh.save_state()
    fresh.step(20)
    torch.testing.assert_close(held.positions[:, list(END)], before, rtol=0, atol=1e-3)
    assert (free.positions[:, :, 2].mean(1) - 1.0 + 0.5 * 9.81 * 0.1**2).abs().max().item() < 3e-3
    after = [body.positions.clone() for body in (held, free)]
    fresh.load_state(saved)
    fresh.step(20)
    for body, was in zip((held, free), after, strict=True):
        assert torch.equal(body.positions, was)
    fresh.load_state(saved)
    held.release()
    fresh.step(20)
    assert (before[..., 2] - held.positions[:, list(END), 2]).min().item() > 0.03


def test_stiffness_and_density_differ_between_environments(fresh: World) -> None:
    """The second end sags less where the material is ten times as stiff, and where it is a tenth as heavy."""
    held = fresh.deformables["held"]

    def sag() -> torch.Tensor:
        fresh.reset()
        held.anchor(END)
        fresh.step(100)
        return 1.0 - held.positions[:, :, 2].amin(1) - 0.025

    held.set_parameter("stiffness", torch.tensor([1.0, 10.0]))
    sags = sag()
    assert sags[0] > 5.0 * sags[1] > 0.0
    held.set_parameter("stiffness", torch.ones(2))
    held.set_parameter("density", torch.tensor([1.0, 0.1]))
    sags = sag()
    assert sags[0] > 5.0 * sags[1] > 0.0
    held.set_parameter("density", torch.ones(2))


def test_links_that_hold_a_solid_bear_its_weight_once() -> None:
    """Vertices that share a node are held by it together."""
    holder = box("holder", size=(0.02, 0.1, 0.1), mass=1.0, pose=Pose((-0.035, 0.0, 1.0)), fixed_base=True)
    held = replace(BLOCK, pose=Pose((0.0, 0.0, 1.0)), damping=0.02, attachments=(Attachment(END, "holder", "holder"),))
    own = simulate(Scene(objects=(holder,), deformables=(held,), terrain=()), 1, "mujoco", matter="native")
    own.step(200)
    force = own.deformables["block"].contact_force("holder", "holder")[0]
    report = {line.asked: line.got for line in own.build_report}
    own.close()
    assert force[2].item() == pytest.approx(-held.mass * 9.81, rel=1e-3)
    assert report["held vertices"] == "the nodes nearest to them held"


def test_rays_do_not_meet_solids_and_pictures_show_them() -> None:
    eye = box("eye", size=(0.02, 0.02, 0.02), mass=0.1, pose=Pose((0.0, 0.0, 1.2)), fixed_base=True)
    down = RayCasterSpec(
        name="down", entity="eye", frame="eye", directions=((0.0, 0.0, -1.0),), pose=Pose((0.0, 0.0, -0.05))
    )
    camera = CameraSpec(
        name="camera", width=16, height=16, vertical_fov=0.1, channels=(Channel.DEPTH,),
        pose=look_at(eye=(0.0, -1.0, 1.0), target=(0.0, 0.0, 1.0)),
    )  # fmt: skip
    still = replace(BLOCK, pose=Pose((0.0, 0.0, 1.0)))
    own = simulate(Scene(objects=(eye,), deformables=(still,), sensors=(down, camera)), 1, "mujoco", matter="native")
    assert own.sensors["down"].distances[0, 0].item() == pytest.approx(1.15, abs=1e-3)
    assert own.sensors["camera"].image(Channel.DEPTH)[0, 8, 8, 0].item() == pytest.approx(0.975, abs=2e-3)
    own.close()


def test_a_solid_with_a_hole_says_that_it_does_not_meet_itself() -> None:
    own = simulate(Scene(deformables=(replace(BLOCK, mesh=ring(0.03, 0.01)),)), 1, "mujoco", matter="native")
    asked = {line.asked for line in own.build_report}
    own.close()
    assert "contact with itself" in asked


def test_the_skin_of_a_thin_plate_does_not_reach_through_it() -> None:
    spec = replace(BLOCK, mesh=cuboid((0.2, 0.2, 0.004), (2, 2, 1)))
    points, tetrahedra = skin(spec)
    assert np.abs(points[:, 2]).max() <= 0.002
    corners = points[tetrahedra]
    assert np.linalg.det(corners[:, 1:] - corners[:, :1]).min() > 0.0


def test_solids_that_mujoco_would_not_solve_are_refused_with_a_remedy() -> None:
    with pytest.raises(ConfigurationError, match=r"'block' is too stiff for MuJoCo's own solids.*at most 0.0\d+ s"):
        simulate(Scene(deformables=(replace(BLOCK, youngs_modulus=1e11),)), 1, "mujoco", matter="native")
    with pytest.raises(ConfigurationError, match=r"'block' would have .* unknowns.*a resolution of 0.00\d+ m would do"):
        simulate(Scene(deformables=(replace(BLOCK, resolution=0.001),)), 1, "mujoco", matter="native")


def test_engines_without_solids_of_their_own_name_those_that_have_them() -> None:
    with pytest.raises(UnsupportedCapabilityError, match="soft body 'block'") as caught:
        simulate(Scene(deformables=(BLOCK,)), 1, "sapien", matter="native")
    assert "mujoco" in str(caught.value)


def test_a_solid_that_diverges_is_named_with_its_environment(fresh: World) -> None:
    fresh.engine.native[1].bind("qvel")[1, 0] = 1e6
    with pytest.raises(SimulationError, match=r"1.*'block'"):
        fresh.step(2)
    fresh.reset()
