"""Free bodies on ropes and cloth: solved together with them, followed by the engine."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_assets.deformables import line, sheet
from orbit_assets.objects import box, sphere
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import SceneLayout, World
from orbit_core.scene import Attachment, Cloth, ObjectSpec, Pose, Rope, Scene
from orbit_core.world import simulate
from orbit_matter import stability, substeps
from orbit_matter.part import Part

G = 9.81
ROPE = Rope("rope", line(0.2, 11), 0.1, Pose((0.0, 0.3, 0.1)), damping=0.0)


def hung(rope: Rope, mass: float, **scene: float) -> Scene:
    """A rope from a free block to the world."""
    held = (Attachment((0,), "block", "block"), Attachment((10,)))
    block = box("block", size=(0.02, 0.02, 0.02), mass=mass, pose=Pose((-0.1, 0.3, 0.1)))
    return Scene(objects=(block,), deformables=(replace(rope, attachments=held),), terrain=(), **scene)


def between(name: str, start: tuple[float, ...], end: tuple[float, ...], held: tuple[Attachment, ...]) -> Rope:
    """A straight rope of 11 particles."""
    points = np.linspace(start, end, 11)
    return Rope(name, points, 0.05, damping=5.0, bending_stiffness=0.0, axial_stiffness=2e4, attachments=held)


def world_of(scene: Scene, num_envs: int = 1) -> World:
    return simulate(scene, num_envs, "mujoco", matter="orbit-matter")


@pytest.mark.parametrize("mass", [0.002, 0.09, 5.0])
def test_a_block_of_any_weight_on_a_heavy_rope_keeps_its_pace(mass: float) -> None:
    """4 kg of rope and 2 g of block fall together at the speed of a pendulum's, and none of it flies away."""
    world = world_of(hung(replace(ROPE, linear_density=20.0), mass))
    fastest = 0.0
    for _ in range(100):
        world.step(1)
        fastest = max(fastest, world.objects["block"].root_velocity[0, :3].norm().item())
    apart = (world.objects["block"].root_pose[0, :3] - torch.tensor([0.1, 0.3, 0.1])).norm()
    world.close()
    assert fastest < 4.0 * math.sqrt(2.0 * G * 0.2)
    assert apart < 0.2 * 1.02


def test_the_engine_has_a_body_where_its_rope_ends() -> None:
    world = world_of(hung(ROPE, 0.5))
    block, rope = world.objects["block"], world.deformables["rope"]
    gaps = []
    for _ in range(60):
        world.step(1)
        gaps.append((block.root_pose[0, :3] - rope.positions[0, 0]).norm().item())
    world.close()
    assert max(gaps) < 5e-4, "a step of 5 ms at 2 m/s would be 10 mm"


@pytest.mark.parametrize("radius", [0.015, 0.035])
def test_a_rope_does_not_collide_with_the_ball_that_it_comes_out_of(radius: float) -> None:
    held = (Attachment((0,), "ball", "ball"), Attachment((10,)))
    ball = sphere("ball", radius, mass=0.5, pose=Pose((-0.1, 0.3, 0.1)))
    rope = replace(ROPE, attachments=held, axial_stiffness=2e4)
    world = world_of(Scene(objects=(ball,), deformables=(rope,), terrain=()))
    start = G * 0.2 * 0.5
    energies = []
    for _ in range(100):
        world.step(1)
        pose, velocity = ball_state(world)
        energies.append(0.25 * float(velocity[:3] @ velocity[:3]) + 0.5 * G * (float(pose[2]) - 0.1) + start)
    world.close()
    assert max(energies) < 1.05 * start


def ball_state(world: World) -> tuple[torch.Tensor, torch.Tensor]:
    return world.objects["ball"].root_pose[0], world.objects["ball"].root_velocity[0]


@pytest.mark.parametrize("mass", [0.2, 3.0])
def test_a_body_on_two_ropes_hangs_where_their_pulls_meet(mass: float) -> None:
    """From anchors 0.6 m apart on 0.3 and 0.5 m of rope, that is 0.18 m from the nearer and 0.24 m below them."""
    knot = ObjectSpec(
        name="knot", articulation=box("knot", (0.02, 0.02, 0.02), mass=mass).articulation, pose=Pose((0.18, 0.0, 0.76))
    )
    ropes = (
        between("left", (0.0, 0.0, 1.0), (0.18, 0.0, 0.76), (Attachment((0,)), Attachment((10,), "knot", "knot"))),
        between("right", (0.58, 0.0, 1.0), (0.18, 0.0, 0.76), (Attachment((0,)), Attachment((10,), "knot", "knot"))),
    )
    world = world_of(Scene(objects=(knot,), deformables=ropes, terrain=()))
    world.objects["knot"].set_root_velocity(torch.tensor([[0.0, 0.2, 0.0, 0.0, 0.0, 0.0]]))
    world.step(400)
    at, velocity = world.objects["knot"].root_pose[0, :3], world.objects["knot"].root_velocity[0, :3]
    pulls = sum(world.deformables[rope.name].contact_force("knot", "knot")[0] for rope in ropes)
    world.close()
    assert at[[0, 2]].tolist() == pytest.approx([0.18, 0.76], abs=1e-2)
    assert velocity.norm() < 0.3
    assert pulls[2].item() == pytest.approx(mass * G, rel=0.1)


def test_a_wrench_that_users_set_pulls_a_body_aside() -> None:
    """A tenth of its weight sideways: it swings about 0.1 rad, in 0.9 s."""
    rope = between("rope", (0.0, 0.0, 0.2), (0.0, 0.0, 0.0), (Attachment((0,)), Attachment((10,), "block", "block")))
    block = box("block", size=(0.02, 0.02, 0.02), mass=0.5)
    world = world_of(Scene(objects=(block,), deformables=(replace(rope, linear_density=0.01),), terrain=()))
    world.objects["block"].set_wrenches(torch.tensor([[[0.05 * G, 0.0, 0.0, 0.0, 0.0, 0.0]]]))
    sideways = []
    for _ in range(round(2.0 * 2.0 * math.pi * math.sqrt(0.2 / G) / 0.005)):
        world.step(1)
        sideways.append(world.objects["block"].root_pose[0, 0].item())
    world.close()
    assert np.mean(sideways) == pytest.approx(0.2 * 0.1, rel=0.02)
    assert max(sideways) == pytest.approx(0.2 * 0.2, rel=0.02)


def test_a_block_that_hangs_by_its_corner_turns_and_keeps_its_energy() -> None:
    held = (Attachment((0,), "block", "block"), Attachment((10,)))
    block = box("block", size=(0.06, 0.06, 0.06), mass=0.3, pose=Pose((-0.13, 0.3, 0.07)))
    rope = replace(ROPE, attachments=held, linear_density=0.02, axial_stiffness=2e4)
    world = world_of(Scene(objects=(block,), deformables=(rope,), terrain=()))
    thing, inertia = world.objects["block"], 0.3 * 0.06**2 / 6.0
    start, energies, gaps = 0.3 * G * 0.25, [], []
    for _ in range(150):
        world.step(1)
        pose, velocity = thing.root_pose[0], thing.root_velocity[0]
        corner = pose[:3] + quat_rotate(pose[3:], torch.tensor([0.03, 0.0, 0.03]))
        gaps.append((corner - world.deformables["rope"].positions[0, 0]).norm().item())
        moving = 0.15 * velocity[:3].square().sum() + 0.5 * inertia * velocity[3:].square().sum()
        energies.append((moving + 0.3 * G * (pose[2] - 0.07)).item() / start)
    world.close()
    assert max(gaps) < 2e-3
    assert np.abs(energies).max() < 0.04


@pytest.mark.parametrize("mass", [0.02, 0.5])
def test_a_body_on_the_floor_stays_under_its_rope(mass: float) -> None:
    """The engine's floor carries it; a rope of 20 g hangs slack from above."""
    held = (Attachment((0,), "block", "block"), Attachment((10,)))
    points = np.linspace((0.0, 0.0, 0.02), (0.0, 0.0, 0.21), 11)
    block = box("block", size=(0.04, 0.04, 0.04), mass=mass, pose=Pose((0.0, 0.0, 0.02)))
    world = world_of(
        Scene(objects=(block,), deformables=(replace(ROPE, points=points, pose=Pose(), attachments=held),))
    )
    world.step(200)
    fastest = 0.0
    for _ in range(100):
        world.step(1)
        fastest = max(fastest, world.objects["block"].root_velocity[0, :3].norm().item())
    at = world.objects["block"].root_pose[0, :3]
    world.close()
    assert fastest < 0.05
    assert at.tolist() == pytest.approx([0.0, 0.0, 0.02], abs=2e-3)


@pytest.mark.parametrize("mass", [0.002, 0.3])
def test_weights_at_the_corners_of_a_cloth_swing_with_it(mass: float) -> None:
    held = (Attachment((0, 6)), Attachment((42,), "block", "block"))
    cloth = Cloth("cloth", sheet((0.2, 0.2), (7, 7)), 0.2, Pose((0.0, 0.0, 0.5)), attachments=held)
    corner = tuple(cloth.pose.transform(cloth.rest_positions[42:43])[0].tolist())
    block = box("block", size=(0.02, 0.02, 0.02), mass=mass, pose=Pose(corner))
    world = world_of(Scene(objects=(block,), deformables=(cloth,), terrain=()))
    fastest = 0.0
    for _ in range(120):
        world.step(1)
        fastest = max(fastest, world.objects["block"].root_velocity[0, :3].norm().item())
    gap = (world.objects["block"].root_pose[0, :3] - world.deformables["cloth"].positions[0, 42]).norm()
    world.close()
    assert fastest < 2.0 * math.sqrt(2.0 * G * 0.25)
    assert gap < 2e-3


def test_a_swing_repeats_in_every_environment_after_a_snapshot_and_a_reset() -> None:
    world = world_of(hung(ROPE, 0.05), 3)
    block = world.objects["block"]
    world.step(40)
    saved = world.save_state()
    world.step(40)
    end = block.root_pose.clone()
    assert torch.equal(end[0], end[2])
    world.load_state(saved)
    world.step(40)
    assert torch.equal(block.root_pose, end)
    world.reset(torch.tensor([1]))
    assert torch.equal(block.root_pose[[0, 2]], end[[0, 2]])
    world.step(80)
    assert torch.equal(block.root_pose[1], end[1])
    world.close()


def test_kernels_of_a_cpu_swing_bodies_as_those_of_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    def swung() -> torch.Tensor:
        world = world_of(hung(ROPE, 0.05), 2)
        world.step(40)
        found = world.objects["block"].root_pose.clone()
        world.close()
        return found

    in_rows = swung()
    monkeypatch.setattr(Part, "takes_rows", property(lambda part: False))
    assert torch.equal(swung(), in_rows)


def test_a_state_that_is_written_is_where_a_swing_goes_on_from() -> None:
    world = world_of(hung(ROPE, 0.5))
    block = world.objects["block"]
    world.step(40)
    block.set_root_velocity(torch.zeros(1, 6))
    before = block.root_pose[0, :3].clone()
    world.step(1)
    after = block.root_pose[0, :3].clone()
    world.close()
    assert (after - before).norm() < 3.0 * G * 0.005**2, "the engine still takes the pull of the step before"


def test_what_a_light_link_may_do_and_what_folds_lose_is_reported() -> None:
    layout = SceneLayout.of(hung(ROPE, 0.005))
    (late,) = stability.late_links(layout)
    assert late.subject == "link 'block' of 'block'"
    assert "while the engine holds it" in late.asked
    assert not stability.late_links(SceneLayout.of(hung(ROPE, 0.5)))
    (lossy,) = stability.folding(layout)
    assert lossy.got == "loses up to 60 % in 3 s"
    assert not stability.folding(SceneLayout.of(hung(ROPE, 5.0)))


def test_a_loaded_rope_takes_the_substep_that_its_waves_need() -> None:
    """0.6 of an edge of 2 cm over ``sqrt(T / rho)``, with the tension T of 12 kg and the rope."""
    substep, _ = substeps.chosen(hung(ROPE, 12.0))
    assert substep == pytest.approx(0.6 * 0.02 * (0.1 / (9.81 * 12.02)) ** 0.5)


def test_a_rope_with_a_free_body_takes_a_substep_in_which_no_edge_turns_far() -> None:
    """0.03 of an edge of 2 cm at ``sqrt(g L)``."""
    substep, _ = substeps.chosen(hung(ROPE, 0.01))
    assert substep == pytest.approx(0.03 * 0.02 / (9.81 * 0.2) ** 0.5)
