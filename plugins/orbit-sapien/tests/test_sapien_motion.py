"""Velocities are those of the motion: under load, after a blow, and of what was just written."""

from __future__ import annotations

import math

import pytest
import torch

from orbit_assets.objects import box
from orbit_core.scene import Plane, Pose, Scene, Shape
from orbit_core.world import simulate
from orbit_sapien.motion import moved_velocities

_DT = 0.005


@pytest.mark.parametrize("masses", [(1.0, 10.0), (1.0, 1.0, 1.0, 1.0, 1.0)])
def test_a_loaded_body_moves_as_its_velocity_tells(masses: tuple[float, ...]) -> None:
    """PhysX's own velocities are 0.02 m/s off in these stacks."""
    boxes = tuple(
        box(f"box{number}", size=(0.1, 0.1, 0.1), mass=mass, pose=Pose((0.0, 0.0, 0.05 + 0.1 * number)))
        for number, mass in enumerate(masses)
    )
    world = simulate(Scene(objects=boxes, terrain=(Shape(Plane()),), physics_dt=_DT), 1, "sapien")
    world.step(200)
    for _ in range(50):
        before = world.link_poses[..., :3].clone()
        world.step(1)
        moved = (world.link_poses[..., :3] - before) / _DT
        told = torch.stack([thing.root_velocity[:, :3] for thing in world.objects.values()], 1)
        torch.testing.assert_close(told, moved, rtol=0, atol=2e-4)
    world.close()


def body(speed: float, height: float, rate: float = 0.0, angle: float = 0.0) -> torch.Tensor:
    """(1, 1, 13) of a body that moves and turns along z."""
    half = angle / 2
    return torch.tensor([[[math.cos(half), 0, 0, math.sin(half), 0, 0, height, 0, 0, speed, 0, 0, rate]]]).double()


def test_the_motion_tells_linear_and_angular_velocities_about_any_centre() -> None:
    """A quarter turn about z in a second, about a point 1 m from the centre of mass."""
    found = moved_velocities(
        body(0.01, 0.0), body(0.02, 0.5, 0.02, math.pi / 2), torch.tensor([[[1.0, 0, 0]]]).double(), 1.0
    )
    expected = torch.tensor([[[-1.0, 1.0, 0.5, 0.0, 0.0, math.pi / 2]]]).double()
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-6)


def test_a_struck_body_has_the_velocity_after_the_blow() -> None:
    center = torch.zeros(1, 1, 3).double()
    found = moved_velocities(body(-3.0, 0.01), body(1.5, 0.0), center, _DT)
    assert found[0, 0, 2] == 1.5
