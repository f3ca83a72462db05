"""Objects that differ between environments: each environment has its own shape, mass and looks, and no other's."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest
import torch

from orbit_assets.objects import box, cylinder, mesh_object, sphere
from orbit_conformance.bodies import cube
from orbit_conformance.contract.fixtures import Needs
from orbit_core.interfaces import Backend, Capability, World
from orbit_core.scene import CameraSpec, Channel, ContactSensorSpec, Mesh, ObjectSpec, Pose, Scene, look_at
from orbit_core.world import simulate

MakeWorld = Callable[[Scene, int], World]
G = 9.81
RED, GREEN, BLUE, WHITE = ((1.0, 0, 0, 1), (0, 1.0, 0, 1), (0, 0, 1.0, 1), (1.0, 1, 1, 1))
HEIGHTS = (0.05, 0.1, 0.03, 0.02)
"""Of the centres of what :func:`thing` may be, at rest."""
MASSES = (1.0, 2.0, 0.5, 0.7)


def thing(height: float = 0.12) -> ObjectSpec:
    """A small box, a large box, a ball or a disc."""
    choices = (
        box("thing", (0.1, 0.1, 0.1), mass=MASSES[0], color=RED, pose=Pose((0, 0, height))),
        box("thing", (0.2, 0.2, 0.2), mass=MASSES[1], color=GREEN),
        sphere("thing", 0.03, mass=MASSES[2], color=BLUE),
        cylinder("thing", 0.05, 0.04, mass=MASSES[3], color=WHITE),
    )
    return replace(choices[0], variants=tuple(choice.articulation for choice in choices[1:]))


@pytest.fixture
def make_world(backend: Backend, device: torch.device) -> Iterator[MakeWorld]:
    """``make_world(scene, num_envs)`` on the device of ``--device``; closed after the test."""
    made: list[World] = []

    def make(scene: Scene, num_envs: int) -> World:
        made.append(simulate(scene, num_envs, backend.name, device=device))
        return made[-1]

    yield make
    for world in made:
        world.close()


@pytest.fixture(autouse=True)
def _(needs: Needs) -> None:
    needs(Capability.SHAPES_PER_ENVIRONMENT)


def test_each_rests_on_its_own_shape_with_its_own_weight(make_world: MakeWorld) -> None:
    scene = Scene(objects=(thing(),), sensors=(ContactSensorSpec(name="touch", entity="thing"),))
    world = make_world(scene, 6)
    world.step(200)
    kinds = [i % 4 for i in range(6)]
    heights = world.objects["thing"].root_pose[:, 2].cpu()
    torch.testing.assert_close(heights, torch.tensor([HEIGHTS[k] for k in kinds]), atol=1e-3, rtol=0)
    weights = torch.tensor([MASSES[k] * G for k in kinds])
    torch.testing.assert_close(world.sensors["touch"].forces[:, 0, 2].cpu(), weights, rtol=0.01, atol=0)


def test_two_such_objects_vary_independently(make_world: MakeWorld) -> None:
    other = replace(
        box("other", (0.1, 0.1, 0.3), mass=1.0, pose=Pose((1.0, 0, 0.2))),
        variants=(box("other", (0.1, 0.1, 0.2), mass=1.0).articulation, sphere("other", 0.2, mass=1.0).articulation),
    )
    pair = replace(thing(), variants=thing().variants[:1])
    world = make_world(Scene(objects=(pair, other)), 7)
    world.step(200)
    expected = torch.tensor([[HEIGHTS[i % 2], (0.15, 0.1, 0.2)[i % 3]] for i in range(7)])
    torch.testing.assert_close(world.engine.link_poses[:, :, 2].cpu(), expected, atol=2e-3, rtol=0)


def test_things_on_them_rest_on_the_shape_that_is_there(make_world: MakeWorld) -> None:
    """A cube upon a fixed block of two heights, and none where the ball is too small to reach it."""
    block = replace(
        box("block", (0.4, 0.4, 0.2), fixed_base=True),
        variants=(box("block", (0.4, 0.4, 0.6)).articulation, sphere("block", 0.01).articulation),
    )
    world = make_world(Scene(objects=(block, cube(pose=Pose((0.02, 0.01, 0.37))))), 3)
    world.step(300)
    half = float(cube().articulation.root.collisions[0].geometry.half_extents[2])
    heights = world.engine.link_poses[:, 1, 2].cpu()
    assert heights[0] == pytest.approx(0.1 + half, abs=2e-3)
    assert heights[1] == pytest.approx(0.3 + half, abs=2e-3)
    assert heights[2] < 0.1


def test_meshes_may_differ(make_world: MakeWorld, needs: Needs) -> None:
    needs(Capability.CONVEX_MESHES)
    low, high = (mesh_of_box(height) for height in (0.1, 0.3))
    choices = [mesh_object("thing", mesh, mass=1.0, pose=Pose((0, 0, 0.2))) for mesh in (low, high)]
    shared = replace(choices[0], variants=(choices[1].articulation, sphere("thing", 0.07, mass=1.0).articulation))
    world = make_world(Scene(objects=(shared,)), 3)
    world.step(200)
    heights = world.objects["thing"].root_pose[:, 2].cpu()
    torch.testing.assert_close(heights, torch.tensor([0.05, 0.15, 0.07]), atol=1.5e-3, rtol=0)


def test_masses_and_snapshots_are_each_environments_own(make_world: MakeWorld, needs: Needs) -> None:
    needs(Capability.RANDOMIZE_MASS, Capability.SNAPSHOTS)
    scene = Scene(objects=(thing(),), sensors=(ContactSensorSpec(name="touch", entity="thing"),))
    world = make_world(scene, 4)
    saved = world.save_state()
    link, mass, env = (torch.tensor(value, device=world.device) for value in ([0], [[3.0]], [2]))
    world.engine.set_masses(link, mass, env)
    world.step(200)
    expected = G * torch.tensor([MASSES[0], MASSES[1], 3.0, MASSES[3]])
    torch.testing.assert_close(world.sensors["touch"].forces[:, 0, 2].cpu(), expected, rtol=0.01, atol=0)
    world.load_state(saved)
    world.step(200)
    torch.testing.assert_close(
        world.sensors["touch"].forces[:, 0, 2].cpu(), G * torch.tensor(MASSES), rtol=0.01, atol=0
    )


def test_each_turns_by_its_own_inertia(make_world: MakeWorld, needs: Needs) -> None:
    needs(Capability.EXTERNAL_WRENCHES)
    floating = Scene(objects=(thing(),), terrain=(), gravity=(0.0, 0.0, 0.0))
    world = make_world(floating, 5)
    torque, steps = 0.01, 20
    wrench = torch.tensor([[[0.0, 0, 0, torque, 0, 0]]], device=world.device)
    world.engine.set_wrenches(torch.tensor([0], device=world.device), wrench.repeat(5, 1, 1))
    world.step(steps)
    inertias = torch.tensor([thing().alternatives[i % 4].root.inertia[0, 0] for i in range(5)], dtype=torch.float32)
    spins = world.objects["thing"].root_velocity[:, 3].cpu()
    torch.testing.assert_close(spins, torque * steps * floating.physics_dt / inertias, rtol=2e-3, atol=0)


def test_a_camera_sees_each_environments_own(make_world: MakeWorld, needs: Needs) -> None:
    needs(Capability.ALBEDO, Capability.SEGMENTATION)
    camera = CameraSpec(
        name="camera", width=48, height=48, pose=look_at((0.5, 0.3, 0.4), (0, 0, 0.05)),
        channels=(Channel.ALBEDO, Channel.INSTANCE),
    )  # fmt: skip
    world = make_world(Scene(objects=(thing(),), sensors=(camera,)), 5)
    world.step(1)
    some = torch.tensor([3, 1], device=world.device)
    eye = torch.tensor([(*camera.pose.position, *camera.pose.orientation)], device=world.device).expand(2, -1)
    image = world.renderer.render(camera, eye, world.link_poses[some], camera.channels, env_ids=some)
    pictures = world.sensors["camera"].images
    seen = [(pictures[Channel.ALBEDO][i], pictures[Channel.INSTANCE][i], i % 4) for i in range(5)]
    seen += [(image.albedo[row], image.links[row], int(env)) for row, env in enumerate(some)]
    sizes = []
    for albedo, instances, kind in seen:
        mine = instances[..., 0] == 0
        sizes.append(int(mine.sum()))
        assert mine.any()
        color = torch.tensor((RED, GREEN, BLUE, WHITE)[kind][:3]) * 255
        assert (albedo[mine].cpu().float() - color).abs().max() < 2
    assert sizes[1] > sizes[0] > sizes[2]
    assert sizes[5:] == [sizes[3], sizes[1]]


def mesh_of_box(height: float) -> Mesh:
    import trimesh

    solid = trimesh.creation.box((0.1, 0.1, height))
    return Mesh(solid.vertices, solid.faces)
