"""Pairs of shapes that rebound, on both backends that step MuJoCo's model."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_assets.objects import box, sphere
from orbit_core.backends import backend_names
from orbit_core.interfaces import World
from orbit_core.scene import (
    Articulation,
    Joint,
    JointType,
    Link,
    ObjectSpec,
    PhysicsMaterial,
    Plane,
    Pose,
    Scene,
    Shape,
    Sphere,
)
from orbit_core.world import simulate

BACKENDS = [name for name in ("mujoco", "warp") if name in backend_names()]
RADIUS = 0.05


def material(restitution: float, friction: float = 0.0) -> PhysicsMaterial:
    return PhysicsMaterial(friction, friction, 0.0, 0.0, restitution)


def floor(restitution: float, pose: Pose | None = None) -> Shape:
    return Shape(Plane(), pose or Pose(), material(restitution), name="floor")


def thrown(backend: str, ball: ObjectSpec, ground: Shape, num_envs: int = 1, **settings: object) -> World:
    """A world without weight whose ball flies down at 2 m/s and ahead at 1 m/s."""
    scene = Scene(objects=(ball,), terrain=(ground,), gravity=(0.0, 0.0, 0.0))
    world = simulate(scene, num_envs, backend, settings=settings)
    velocity = torch.tensor([[1.0, 0.0, -2.0, 0.0, 0.0, 0.0]], device=world.device)
    world.objects["ball"].set_root_velocity(velocity.repeat(num_envs, 1))
    return world


def ball(restitution: float, friction: float = 0.0) -> ObjectSpec:
    return sphere("ball", RADIUS, mass=1.0, material=material(restitution, friction), pose=Pose((0.0, 0.0, 0.08)))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("own", "ground"), [(0.9, 0.3), (0.3, 0.9), (0.9, 0.0)])
def test_a_pair_rebounds_with_the_larger_restitution(backend: str, own: float, ground: float) -> None:
    world = thrown(backend, ball(own), floor(ground))
    world.step(20)
    assert world.objects["ball"].root_velocity[0, 2].item() == pytest.approx(1.8, abs=0.02)


@pytest.mark.parametrize("backend", BACKENDS)
def test_friction_of_a_rebounding_pair_is_each_environments_own(backend: str) -> None:
    world = thrown(backend, ball(0.5, 0.1), floor(0.0), 3)
    thing = world.objects["ball"]
    thing.set_friction(torch.tensor([[0.04]], device=world.device), env_ids=torch.tensor([1], device=world.device))
    saved = world.save_state()
    for _ in range(2):
        world.step(20)
        lost = 1.0 - thing.root_velocity[:, 0].cpu()
        torch.testing.assert_close(lost, 3.0 * torch.tensor([0.1, 0.04, 0.1]), rtol=0.03, atol=0.0)
        world.load_state(saved)


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_varies_and_the_fourth_order_integrator_rebound_by_a_spring_and_say_so(backend: str) -> None:
    varying = replace(ball(0.8), variants=(sphere("ball", 0.04, mass=1.0, material=material(0.8)).articulation,))
    for world in (thrown(backend, varying, floor(0.0), 2), thrown(backend, ball(0.8), floor(0.0), integrator="rk4")):
        (line,) = [line for line in world.build_report if "restitution" in line.asked]
        assert line.got.startswith("a rebound of 8 steps")
        world.step(40)
        assert world.objects["ball"].root_velocity[:, 2].cpu() == pytest.approx(1.6, abs=0.15)


def test_links_that_pass_through_each_other_make_no_pair() -> None:
    shape = Shape(Sphere(RADIUS), material=material(0.5))
    links = [Link(name, 1.0, inertia=1e-3 * np.eye(3), collisions=(shape,)) for name in "abcd"]
    joints = [
        Joint(one.name + other.name, JointType.CONTINUOUS, one.name, other.name)
        for one, other in itertools.pairwise(links)
    ]
    for self_collisions, pairs in ((False, 4), (True, 7)):  # each with the floor; then a with c and d, b with d
        robot = Articulation("robot", tuple(links), tuple(joints), self_collisions=self_collisions)
        spec = ObjectSpec(name="robot", articulation=robot, pose=Pose((0.0, 0.0, 1.0)))
        world = simulate(Scene(objects=(spec,), terrain=(floor(0.0),)), 1, "mujoco")
        assert world.native[0].npair == pairs


@pytest.mark.parametrize("restitution", [0.5, 0.95])
def test_a_lively_box_holds_on_a_slope(restitution: float) -> None:
    slope = Pose.from_axis_angle((0.0, 1.0, 0.0), math.radians(15.0))
    held = box("box", (0.1, 0.1, 0.1), mass=1.0, material=material(restitution, 0.8), pose=slope @ Pose((0, 0, 0.05)))
    world = simulate(Scene(objects=(held,), terrain=(floor(0.0, slope),)), 1, "mujoco")
    world.step(100)
    before = world.objects["box"].root_pose[:, :3].clone()
    world.step(100)
    assert (world.objects["box"].root_pose[:, :3] - before).norm() < 1e-4  # m in half a second
