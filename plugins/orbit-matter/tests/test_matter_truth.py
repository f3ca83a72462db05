"""Cloth and rope against closed forms, on two engines, at the solver's default cost."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch

from orbit_core.assets.deformables import line, sheet
from orbit_core.assets.objects import box
from orbit_core.interfaces import World
from orbit_core.scene import Attachment, Cloth, PhysicsMaterial, Plane, Pose, Rope, Scene, Shape
from orbit_core.world import simulate

G = 9.81
Make = Callable[..., World]
UPRIGHT = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
"""Turns x down."""


@pytest.fixture(scope="module", params=["mujoco", "bullet"])
def backend(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def make(backend: str) -> Iterator[Make]:
    made: list[World] = []

    def build(scene: Scene, num_envs: int = 1, **settings: Any) -> World:
        made.append(simulate(scene, num_envs, backend, matter="orbit-matter", matter_settings=settings))
        made[-1].reset()
        return made[-1]

    yield build
    for world in made:
        world.close()


@pytest.mark.parametrize("count", [7, 13, 21])
def test_a_hanging_cloth_keeps_its_length_at_every_mesh(make: Make, count: int) -> None:
    held = Attachment(tuple(range(0, count * count, count)))
    pose = Pose((0.0, 0.0, 1.0), UPRIGHT)
    cloth = Cloth("cloth", sheet((0.3, 0.3), (count, count)), 0.2, pose=pose, damping=2.0, attachments=(held,))
    world = make(Scene(deformables=(cloth,), terrain=()))
    world.step(300)
    heights = world.deformables["cloth"].positions[0, :, 2]
    assert (heights.max() - heights.min()).item() == pytest.approx(0.3, rel=0.01)


def test_a_stretched_cloth_follows_its_modulus_and_poissons_ratio(make: Make) -> None:
    """Strain F / (w E t) along, and nu times that across, with a weight that is the cloth's own lower part."""
    stiffness, ratio, density, length, width = 40.0, 0.3, 0.4, 0.4, 0.1
    held = Attachment(tuple(range(0, 17 * 5, 17)))
    pose = Pose((0.0, 0.0, 1.0), UPRIGHT)
    mesh = sheet((length, width), (17, 5))
    cloth = Cloth("strip", mesh, density, pose, stiffness, ratio, damping=3.0, attachments=(held,))
    world = make(Scene(deformables=(cloth,), terrain=()), substep=0.0005)
    world.step(400)
    points = world.deformables["strip"].positions[0].reshape(5, 17, 3)
    longer = (points[2, 0, 2] - points[2, -1, 2]).item() - length
    assert longer == pytest.approx(0.5 * density * G * length**2 / stiffness, rel=0.1)
    narrower = width - (points[-1, 8, 1] - points[0, 8, 1]).norm().item()
    assert narrower == pytest.approx(ratio * width * 0.5 * density * G * length / stiffness, rel=0.15)


def test_a_cantilevered_cloth_droops_as_an_elastica(make: Make) -> None:
    """Peirce's test: B theta'' = -w (L - s) cos(theta), theta(0) = 0, theta'(L) = 0."""
    length, density, stiffness, count = 0.1, 0.2, 1e-4, 11
    spacing = length / (count - 1)
    mesh = sheet((length + spacing, 0.03), (count + 1, 4))
    held = Attachment(tuple(row * (count + 1) + column for row in range(4) for column in (0, 1)))
    cloth = Cloth(
        "strip", mesh, density, bending_stiffness=stiffness, poissons_ratio=0.0, damping=3.0, attachments=(held,)
    )
    world = make(Scene(deformables=(cloth,), terrain=()))
    world.step(500)
    tip = world.deformables["strip"].positions[0].reshape(4, count + 1, 3)[1:3, -1].mean(0)
    assert -tip[2].item() == pytest.approx(_droop(length, density * G, stiffness), rel=0.1)


def _droop(length: float, weight: float, stiffness: float) -> float:
    """Metres that the tip of an elastica falls, by shooting at the curvature that the free end wants to be zero."""

    def fall(curvature: float) -> tuple[float, float]:
        angle, drop, step = 0.0, 0.0, length / 2000
        for number in range(2000):
            curvature -= step * weight * (length - (number + 0.5) * step) * math.cos(angle) / stiffness
            angle += step * curvature
            drop += step * math.sin(angle)
        return curvature, drop

    low, high = 0.0, weight * length**2 / stiffness
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if fall(middle)[0] > 0.0 else (middle, high)
    return fall(low)[1]


def test_a_rope_hangs_in_a_catenary(make: Make) -> None:
    """z = a cosh(x / a), 2 a sinh(span / 2 a) = length: within 1 mm of 0.6 m."""
    length, span, count = 0.6, 0.4, 51
    along = np.linspace(0.0, length, count)
    slope = math.sqrt(1.0 - (span / length) ** 2)
    v = np.stack((along * span / length - 0.5 * span, 0.0 * along, -np.minimum(along, length - along) * slope), axis=-1)
    held = (Attachment((0, count - 1)),)
    rope = Rope("rope", v, 0.1, bending_stiffness=1e-6, axial_stiffness=5000.0, damping=3.0, attachments=held)
    world = make(Scene(deformables=(rope,), terrain=()))
    world.step(800)
    points = world.deformables["rope"].positions[0].numpy()
    low, high = 0.05, 10.0
    for _ in range(80):
        a = 0.5 * (low + high)
        low, high = (a, high) if 2 * a * math.sinh(span / (2 * a)) > length else (low, a)
    truth = a * (np.cosh(points[:, 0] / a) - math.cosh(span / (2 * a)))
    assert np.abs(points[:, 2] - truth).max() < 1e-3


def test_a_hanging_rope_swings_in_the_period_of_a_chain(make: Make) -> None:
    """First mode of a hanging chain: 4 pi sqrt(L / g) / 2.405 (Lamb, Dynamics, 1914), the zero of Bessel's J0."""
    length, count = 0.5, 41
    pose = Pose((0.0, 0.0, 1.0), UPRIGHT)
    held = (Attachment((0,)),)
    points = line(length, count) + np.array([0.5 * length, 0, 0])
    rope = Rope("rope", points, 0.1, pose, bending_stiffness=0.0, damping=0.0, attachments=held)
    world = make(Scene(deformables=(rope,), terrain=(), physics_dt=0.0025))
    body = world.deformables["rope"]
    mode = torch.special.bessel_j0(2.405 * torch.linspace(1.0, 0.0, count, dtype=torch.float64).sqrt()).float()
    start = body.positions.clone()
    start[0, :, 1] += 0.01 * mode
    body.set_state(start)
    tips = []
    for _ in range(800):
        world.step(1)
        tips.append(body.positions[0, -1, 1].item())
    signs = np.sign(tips)
    crossings = np.flatnonzero(signs[:-1] != signs[1:])
    moments = [k + tips[k] / (tips[k] - tips[k + 1]) for k in crossings]
    period = 2.0 * (moments[-1] - moments[0]) / (len(moments) - 1) * 0.0025
    assert period == pytest.approx(4.0 * math.pi * math.sqrt(length / G) / 2.40483, rel=0.02)


@pytest.mark.parametrize(("tangent", "slides"), [(0.38, False), (0.6, True)])
def test_cloth_on_a_slope_holds_and_slides_by_coulombs_law(make: Make, tangent: float, slides: bool) -> None:
    friction, angle = 0.4, math.atan(tangent)
    turn = Pose.from_euler(0.0, angle, 0.0)
    ground = Shape(Plane(), turn, PhysicsMaterial(friction, friction))
    mesh = sheet((0.1, 0.1), (6, 6))
    above = turn.transform(np.array([[0.0, 0.0, 0.002]]))[0]
    pose = Pose(tuple(above), turn.orientation)
    cloth = Cloth("cloth", mesh, 0.2, pose, friction=friction, damping=0.0)
    world = make(Scene(deformables=(cloth,), terrain=(ground,)))
    body = world.deformables["cloth"]
    world.step(40)
    before, velocity = body.positions[0].mean(0), body.velocities[0].mean(0).norm()
    world.step(80)
    if slides:
        acceleration = (body.velocities[0].mean(0).norm() - velocity).item() / 0.4
        assert acceleration == pytest.approx(G * (math.sin(angle) - friction * math.cos(angle)), rel=0.03)
    else:
        assert (body.positions[0].mean(0) - before).norm() < 1e-4


def test_a_free_cloth_keeps_its_momentum(make: Make) -> None:
    cloth = Cloth("cloth", sheet((0.2, 0.2), (9, 9)), 0.2, damping=0.0)
    world = make(Scene(deformables=(cloth,), terrain=(), gravity=(0.0, 0.0, 0.0)))
    body = world.deformables["cloth"]
    torch.manual_seed(0)
    velocities = torch.randn(1, 81, 3) * 0.3 + torch.tensor([1.0, 0.0, 0.5])
    body.set_state(body.positions.clone(), velocities)
    weights = _masses(cloth)
    before = weights @ body.velocities[0]
    world.step(100)
    assert torch.allclose(weights @ body.velocities[0], before, rtol=1e-3, atol=1e-5)


def _masses(cloth: Cloth) -> torch.Tensor:
    faces = np.asarray(cloth.mesh.faces)
    a, b, c = (cloth.rest_positions[faces[:, k]] for k in range(3))
    shares = np.zeros(len(cloth.rest_positions))
    np.add.at(shares, faces, (cloth.area_density * np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0)[:, None])
    return torch.as_tensor(shares, dtype=torch.float32)


def test_what_lies_on_a_box_is_felt_by_it_with_its_weight(make: Make) -> None:
    cloth = Cloth("cloth", sheet((0.1, 0.1), (9, 9)), 0.5, Pose((0.0, 0.0, 0.104)))
    block = box("block", size=(0.2, 0.2, 0.1), mass=1.0, pose=Pose((0.0, 0.0, 0.05)))
    world = make(Scene(objects=(block,), deformables=(cloth,)))
    world.step(100)
    forces = []
    for _ in range(50):
        world.step(1)
        forces.append(world.deformables["cloth"].contact_force("block", "block")[0])
    mean = torch.stack(forces).mean(0)
    assert mean[2].item() == pytest.approx(-cloth.mass * G, rel=0.02)
    assert mean[:2].abs().max() < 0.02 * cloth.mass * G
    assert world.objects["block"].root_pose[0, 2].item() == pytest.approx(0.05, abs=1e-3)


def test_a_rope_that_hangs_from_a_link_pulls_it_with_its_weight(make: Make) -> None:
    """Two ways: the block falls at the pace of both, and feels what holds the rope."""
    points = line(0.2, 11) + np.array([0.1, 0, 0])
    rope = Rope("rope", points, 0.5, Pose((0.0, 0.0, 0.6), UPRIGHT), attachments=(Attachment((0,), "block", "block"),))
    block = box("block", size=(0.05, 0.05, 0.05), mass=0.5, pose=Pose((0.0, 0.0, 0.6)), fixed_base=True)
    world = make(Scene(objects=(block,), deformables=(rope,), terrain=()))
    world.step(100)
    forces = []
    for _ in range(50):
        world.step(1)
        forces.append(world.deformables["rope"].contact_force("block", "block")[0])
    assert torch.stack(forces).mean(0)[2].item() == pytest.approx(-rope.mass * G, rel=0.02)


def test_a_block_and_the_rope_on_it_fall_together(make: Make) -> None:
    """Momentum over both ways: in free fall nothing pulls, and a kick of the block is shared with the rope."""
    points = line(0.2, 11) + np.array([0.1, 0, 0])
    rope = Rope("rope", points, 1.0, attachments=(Attachment((0,), "block", "block"),), damping=0.0)
    block = box("block", size=(0.05, 0.05, 0.05), mass=0.5, pose=Pose())
    world = make(Scene(objects=(block,), deformables=(rope,), terrain=(), gravity=(0.0, 0.0, 0.0), physics_dt=0.002))
    kick = torch.tensor([[-0.5, 0.0, 0.0, 0.0, 0.0, 0.0]])
    world.objects["block"].set_root_velocity(kick)
    world.step(250)
    weights = torch.full((11,), rope.mass / 10)
    weights[0] = weights[-1] = 0.5 * rope.mass / 10
    momentum = 0.5 * world.objects["block"].root_velocity[0, :3] + weights @ world.deformables["rope"].velocities[0]
    assert momentum[0].item() == pytest.approx(-0.25, rel=0.05)
    assert world.deformables["rope"].velocities[0].mean(0)[0].item() < -0.2, "the block pulls the rope along"
