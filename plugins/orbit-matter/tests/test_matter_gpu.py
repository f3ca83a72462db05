"""On a GPU launches go over particles and not over environments; what they compute is the same."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from orbit_assets.deformables import cuboid, line, sheet
from orbit_assets.objects import box
from orbit_core.interfaces import World
from orbit_core.scene import Attachment, Cloth, Fluid, Plane, Pose, Rope, Scene, Shape, SoftBody
from orbit_core.world import simulate

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs the capability of a GPU")

CLOTH = Cloth("cloth", sheet((0.2, 0.2), (13, 13)), 0.2, Pose((0.0, 0.0, 0.104)))
ROPE = Rope("rope", line(0.2, 11), 0.1, Pose((0.0, 0.3, 0.1)), attachments=(Attachment((0,)),))
BLOCK = box("block", size=(0.1, 0.1, 0.1), mass=0.5, pose=Pose((0.0, 0.0, 0.05)))
SCENE = Scene(objects=(BLOCK,), deformables=(CLOTH, ROPE))
SOFT = SoftBody("soft", cuboid((0.05, 0.05, 0.05), (2, 2, 2)), 800.0, Pose((0.0, 0.0, 0.124)), 2e5, 0.3)
# Off the middle: where edges meet edges exactly, rounding tells which points touch: 0.01 um became 0.08 mm.
UPPER = replace(SOFT, name="upper", pose=Pose((0.004, 0.003, 0.1735)))
SIDE = tuple(range(9))
HELD = replace(SOFT, name="held", pose=Pose((0.0, 0.2, 0.1)), attachments=(Attachment(SIDE),))
OVER = replace(SOFT, name="over", pose=Pose((0.004, 0.203, 0.1495)))
SOLIDS = Scene(objects=(BLOCK,), deformables=(SOFT, UPPER, HELD, OVER), physics_dt=0.0025)


def world_on(device: str, scene: Scene = SCENE, num_envs: int = 3) -> World:
    return simulate(scene, num_envs, "warp", device=device, matter="orbit-matter")


def solids_after_steps(device: str, num_envs: int, scene: Scene = SOLIDS) -> torch.Tensor:
    """Return the vertices of blocks that touch each other, and of one that hangs until some environments release it."""
    world = world_on(device, scene, num_envs)
    world.step(20)
    world.deformables["held"].release(env_ids=torch.arange(1, num_envs, 2, device=device))
    world.step(20)
    found = torch.cat([body.positions for body in world.deformables.values()], dim=1).cpu()
    world.close()
    return found


def test_cloth_drapes_and_rope_swings_as_on_a_cpu() -> None:
    """Sums of forces take any order on a GPU, so that rounding differs; 0.3 s later it has not grown past 0.1 mm."""
    places = []
    for device in ("cpu", "cuda"):
        world = world_on(device)
        world.step(60)
        places.append({name: body.positions.cpu().clone() for name, body in world.deformables.items()})
        world.close()
    for name in ("cloth", "rope"):
        torch.testing.assert_close(places[1][name], places[0][name], rtol=0.0, atol=1e-4)


def test_a_recorded_step_goes_on_from_a_snapshot_and_from_a_reset_of_one_environment() -> None:
    world = world_on("cuda")
    body = world.deformables["cloth"]
    world.step(20)
    saved, middle = world.save_state(), body.positions.clone()
    world.step(20)
    end = body.positions.clone()
    world.load_state(saved)
    assert torch.equal(body.positions, middle)
    world.step(20)
    torch.testing.assert_close(body.positions, end, rtol=0.0, atol=1e-4)
    others = body.positions[[0, 2]].clone()
    world.reset(torch.tensor([1], device="cuda"))
    torch.testing.assert_close(body.positions[1, :, 2], torch.full_like(body.positions[1, :, 2], 0.104))
    assert torch.equal(body.positions[[0, 2]], others)
    world.close()


def test_a_box_feels_the_weight_of_its_cloth() -> None:
    world = world_on("cuda")
    world.step(200)
    forces = []
    for _ in range(50):
        world.step(1)
        forces.append(world.deformables["cloth"].contact_force("block", "block").clone())
    weight = torch.stack(forces).mean(0)[:, 2]
    torch.testing.assert_close(weight.cpu(), torch.full((3,), -0.2 * 0.04 * 9.81), rtol=0.02, atol=0.0)
    world.close()


def test_where_one_environment_diverges_the_others_go_on() -> None:
    """Nothing looks whether one does, which would wait for the GPU."""
    world = world_on("cuda")
    body = world.deformables["cloth"]
    fast = torch.zeros(1, 169, 3, device="cuda")
    fast[..., 0] = 9.9e3
    body.set_state(body.positions[1:2].clone() + 9.9999e5, fast, torch.tensor([1], device="cuda"))
    world.step(10)
    assert not body.positions[1].abs().max() < 1e6
    assert body.positions[[0, 2]].abs().max() < 1.0
    world.reset(torch.tensor([1], device="cuda"))
    world.step(1)
    assert body.positions.abs().max() < 1.0
    world.close()


def test_solids_touch_hang_and_fall_as_on_a_cpu() -> None:
    """Noise of 0.1 um before each step on a CPU moves the nodes by 4 um at most in the end."""
    torch.testing.assert_close(solids_after_steps("cuda", 3), solids_after_steps("cpu", 3), rtol=0.0, atol=2e-5)


def test_solids_repeat_to_the_bit_however_many_environments_share_a_preconditioner() -> None:
    """70 environments are two tiles of the product, the second of which is not full."""
    # Without those that touch a rigid body, whose own contacts may take any order.
    scene = replace(SOLIDS, deformables=(HELD, OVER))
    one = solids_after_steps("cuda", 70, scene)
    assert torch.equal(solids_after_steps("cuda", 70, scene), one)
    assert torch.equal(one[::2], one[:1].expand(35, -1, -1))
    assert torch.equal(one[1::2], one[1:2].expand(35, -1, -1))
    assert torch.equal(solids_after_steps("cuda", 3, scene), one[:3])
    assert (one[1] - one[0]).abs().max() > 0.01, "what was released has fallen"


WATER = Fluid("water", (0.03, 0.03, 0.02), pose=Pose((0.3, 0.0, 0.02)), spacing=0.01)
DEEP = replace(WATER, half_extents=(0.08, 0.08, 0.04), pose=Pose((0.3, 0.0, 0.04)))
HONEY = replace(WATER, name="honey", density=1400.0, viscosity=5.0, pose=Pose((0.3, 0.0, 0.06)))


@pytest.mark.parametrize("liquids", [(WATER,), (DEEP,), (WATER, HONEY)])
def test_liquids_flow_as_on_a_cpu(liquids: tuple[Fluid, ...]) -> None:
    """The second one has 2,048 particles: more than the memory of a block holds."""
    scene = Scene(objects=(BLOCK,), deformables=liquids, terrain=(Shape(Plane()),))
    places = []
    for device in ("cpu", "cuda"):
        world = world_on(device, scene, 2)
        begin = {name: liquid.positions.clone() for name, liquid in world.deformables.items()}
        world.step(10)
        for name, liquid in world.deformables.items():
            assert (liquid.positions - begin[name]).abs().max() > 1e-3
        places.append(torch.cat([liquid.positions for liquid in world.deformables.values()], dim=1).cpu())
        world.close()
    # Neighbours are in no order on a GPU, so that sums are rounded otherwise.
    torch.testing.assert_close(places[1], places[0], rtol=0.0, atol=1e-4)
