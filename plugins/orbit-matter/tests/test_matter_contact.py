"""What matter lies on, whatever its shape, and matter on matter."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_assets.deformables import line, sheet
from orbit_assets.objects import box
from orbit_core.interfaces import World
from orbit_core.scene import (
    Attachment,
    Box,
    Capsule,
    Cloth,
    Cylinder,
    Geometry,
    HeightField,
    Mesh,
    MeshCollision,
    ObjectSpec,
    PhysicsMaterial,
    Plane,
    Pose,
    Rope,
    Scene,
    Shape,
    Sphere,
    single_link,
)
from orbit_core.world import simulate

CORNERS = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.05, 0.05)])
FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
HILL = HeightField(0.05 - 0.02 * np.hypot(*np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21))), (0.4, 0.4))
SHAPES: dict[str, Geometry] = {
    "box": Box((0.05, 0.05, 0.05)),
    "sphere": Sphere(0.05),
    "capsule": Capsule(0.03, 0.02),
    "cylinder": Cylinder(0.05, 0.05),
    "convex mesh": Mesh(CORNERS, FACES),
    "triangle mesh": Mesh(CORNERS, FACES, MeshCollision.TRIANGLES),
}


@pytest.mark.parametrize("kind", SHAPES)
def test_cloth_comes_to_rest_on_a_solid_of_every_shape(kind: str) -> None:
    """Its middle lies half a thickness above the solid's top, at z = 0.1."""
    body = single_link("solid", Shape(SHAPES[kind]), 1.0, np.eye(3) * 0.01)
    solid = ObjectSpec(name="solid", articulation=body, fixed_base=True, pose=Pose((0.0, 0.0, 0.05)))
    assert _height(Scene(objects=(solid,))) == pytest.approx(0.102, abs=1e-3)


@pytest.mark.parametrize("geometry", [Plane(), HILL])
def test_cloth_comes_to_rest_on_terrain(geometry: Geometry) -> None:
    top = 0.05 if isinstance(geometry, HeightField) else 0.0
    shape = Shape(geometry, Pose((0.0, 0.0, 0.1 - top)))
    assert _height(Scene(terrain=(shape,))) == pytest.approx(0.102, abs=1.5e-3)


def _height(scene: Scene) -> float:
    """Metres to which the middle of a patch of cloth falls, from 2 cm above."""
    patch = Cloth("patch", sheet((0.06, 0.06), (7, 7)), 0.2, Pose((0.0, 0.0, 0.12)), damping=1.0)
    world = simulate(replace(scene, deformables=(patch,)), 1, "mujoco")
    world.step(100)
    height = world.deformables["patch"].positions[0, 24, 2].item()
    world.close()
    return height


def test_a_folded_cloth_keeps_its_layers_in_order() -> None:
    cloth = Cloth("cloth", sheet((0.2, 0.2), (15, 15)), 0.2, Pose((0.0, 0.0, 0.003)), damping=1.0)
    world = simulate(Scene(deformables=(cloth,)), 1, "mujoco")
    points = world.deformables["cloth"].positions.clone()
    over = points[..., 0] > 0.0
    points[..., 2] = torch.where(over, 0.03, points[..., 2])
    points[..., 0] = torch.where(over, -points[..., 0], points[..., 0])
    world.deformables["cloth"].set_state(points)
    world.step(150)
    after = world.deformables["cloth"].positions[0]
    lower, upper = after[~over[0]], after[over[0] & (after[:, 0] < -0.03)]
    nearest = torch.cdist(upper[:, :2], lower[:, :2]).argmin(1)
    gap = upper[:, 2] - lower[nearest, 2]
    world.close()
    assert gap.min() > 0.0, "no particle of the upper layer is under the lower one"
    assert 0.002 < gap.mean() < 0.025


def test_a_rope_lies_across_another() -> None:
    count = 21
    held = (Attachment((0, count - 1)),)
    lower = Rope("lower", line(0.2, count), 0.1, Pose((0.0, 0.0, 0.1)), axial_stiffness=1e4, attachments=held)
    turned = Pose.from_euler(0.0, 0.0, 0.5 * math.pi, (0.0, 0.0, 0.13))
    upper = Rope("upper", line(0.2, count), 0.1, turned, bending_stiffness=1e-2)
    world = simulate(Scene(deformables=(lower, upper), terrain=()), 1, "mujoco")
    world.step(60)
    gap = world.deformables["upper"].positions[0, 10, 2] - world.deformables["lower"].positions[0, 10, 2]
    world.close()
    assert gap.item() == pytest.approx(0.01, abs=1.5e-3)


def test_cloth_rests_on_a_plate_of_many_meshes_in_one_frame() -> None:
    """Each of nine pieces of a split mesh is somewhere within the same ball; none is passed over."""
    places = [(x, y, 0.0) for x in (-0.04, 0.0, 0.04) for y in (-0.04, 0.0, 0.04)]
    pieces = tuple(Shape(Mesh(0.4 * CORNERS + np.array(place), FACES)) for place in places)
    body = single_link("plate", pieces[0], 1.0, np.eye(3) * 0.01)
    body = replace(body, links=(replace(body.links[0], collisions=pieces),))
    plate = ObjectSpec(name="plate", articulation=body, fixed_base=True, pose=Pose((0.0, 0.0, 0.5)))
    cloth = Cloth("cloth", sheet((0.1, 0.1), (9, 9)), 0.2, Pose((0.0, 0.0, 0.523)), damping=1.0)
    world = simulate(Scene(objects=(plate,), deformables=(cloth,)), 1, "mujoco", matter="orbit-matter")
    world.step(40)
    heights = world.deformables["cloth"].positions[0, :, 2]
    world.close()
    torch.testing.assert_close(heights, torch.full_like(heights, 0.522), rtol=0.0, atol=3e-4)


def test_a_triangle_mesh_that_moves_carries_cloth_as_a_box_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """No engine here moves one on a CPU: the engine has a box, and the solver a box or a mesh of its form."""
    free = single_link("lift", Shape(Box((0.05, 0.05, 0.05))), 1.0, np.eye(3) * 0.01)
    lift = ObjectSpec(name="lift", articulation=free, pose=Pose((0.0, 0.0, 0.5)))
    cloth = Cloth("cloth", sheet((0.14, 0.14), (9, 9)), 0.2, Pose((0.0, 0.0, 0.5525)), friction=0.5)
    scene = Scene(objects=(lift,), deformables=(cloth,), terrain=(), gravity=(0.0, 0.0, 0.0))

    def lifted() -> tuple[torch.Tensor, torch.Tensor]:
        """Where the cloth is, and what it weighs, on what rises with g, turns and goes aside."""
        world, weights = simulate(scene, 1, "mujoco", matter="orbit-matter"), []
        for step in range(80):
            speed = 0.005 * (step + 1)
            world.objects["lift"].set_root_velocity(torch.tensor([[speed, 0.0, 9.81 * speed, 0.0, 0.0, 2.0 * speed]]))
            world.step(1)
            weights.append(world.deformables["cloth"].contact_force("lift", "lift")[0, 2].clone())
        found = world.deformables["cloth"].positions[0].clone()
        world.close()
        return found, torch.stack(weights[40:]).mean()

    place, weight = lifted()
    mesh = [(Shape(Mesh(CORNERS, FACES, MeshCollision.TRIANGLES)), 0)]
    monkeypatch.setattr("orbit_matter.colliders._shapes_of", lambda layout: mesh)
    meshed, felt = lifted()
    assert felt.item() == pytest.approx(weight.item(), rel=1e-3)
    torch.testing.assert_close(meshed, place, rtol=0.0, atol=1e-4)
    assert weight.item() == pytest.approx(-0.2 * 0.14**2 * 9.81, rel=0.1)


def test_boxes_that_fall_on_cloth_come_to_rest_on_it() -> None:
    """Of 0.2, 1 and 5 kg, in one world: the matter goes on with each by the mass that it has there."""
    masses = torch.tensor([[0.2], [1.0], [5.0]])
    world = _box_on_cloth(friction=1.0, num_envs=3)
    world.objects["box"].set_masses(masses)
    world.step(240)
    assert (world.objects["box"].root_velocity[:, :3].norm(dim=1) < 0.01).all()
    felt = world.deformables["cloth"].contact_force("box", "box")[:, 2]
    assert felt.tolist() == pytest.approx((9.81 * masses[:, 0]).tolist(), rel=0.02)
    world.close()


def test_what_rubs_nowhere_still_carries() -> None:
    world = _box_on_cloth(friction=0.0, num_envs=1)
    world.step(240)
    assert float(world.deformables["cloth"].contact_force("box", "box")[0, 2]) == pytest.approx(9.81, rel=0.02)
    world.close()


def _box_on_cloth(friction: float, num_envs: int) -> World:
    """A box of 1 kg, 1 cm above a cloth on the ground."""
    material = PhysicsMaterial(friction, friction)
    cloth = Cloth(
        "cloth", sheet((0.15, 0.15), (11, 11)), 0.2, Pose((0.0, 0.0, 0.002)), thickness=0.004, friction=friction
    )
    thing = box("box", (0.08, 0.08, 0.04), mass=1.0, material=material, pose=Pose((0.0, 0.0, 0.034)))
    ground = Shape(Plane(), material=material)
    return simulate(
        Scene(objects=(thing,), deformables=(cloth,), terrain=(ground,)), num_envs, "mujoco", matter="orbit-matter"
    )
