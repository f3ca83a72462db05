"""Sums over neighbours against the same sums in double precision, and lists of them that a CPU keeps up to date."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
import warp as wp

from orbit_assets.objects import box
from orbit_core.interfaces import World
from orbit_core.scene import Fluid, Plane, Pose, Scene, Shape
from orbit_core.world import simulate
from orbit_matter.block import BLOCK
from orbit_matter.fluid import fluids, search
from orbit_matter.fluid.pairs import FAR, LANES, diverged_from, keep, pressed_by

HALF, SHOCK, RUBBING, SMOOTH, FASTEST = 60.0, 0.14, 3.0, 0.004, 180.0
LEAN = (0.02, -0.01, 0.14)


@wp.kernel(enable_backward=False)
def sums(
    place: wp.array2d[wp.vec4],
    motion: wp.array2d[wp.vec4],
    neighbours: wp.array3d[int],
    kept: int,
    count: int,
    lean: wp.vec3,
    pressed: wp.array[wp.vec4],
    diverged: wp.array[wp.vec4],
):
    """Write both sums of each particle of the second environment, of which a block keeps so many rows."""
    lane = wp.tid()
    rows = keep(place, motion, 1, kept)
    for i in range(lane, pressed.shape[0], wp.block_dim()):
        pressed[i] = pressed_by(rows, place, motion, neighbours, 1, i, count, HALF, SHOCK, RUBBING, FASTEST)
        diverged[i] = diverged_from(rows, place, motion, neighbours, 1, i, count, HALF, SMOOTH, lean)


def _plain(place: npt.NDArray, motion: npt.NDArray, i: int, listed: list[int]) -> tuple[npt.NDArray, npt.NDArray]:
    pressing, diverging = np.zeros(4), np.zeros(4)
    for j in listed:
        way, flow = place[i, :3] - place[j, :3], motion[j, :3] - motion[i, :3]
        away = float(np.linalg.norm(way))
        t = max(0.0, 1.0 - away * HALF)
        part = t**3 * place[j, 3]
        closing = float(flow @ way) / away**2
        struck = min(max(0.0, closing), FASTEST)
        pressing[:3] += way * part * (motion[i, 3] + motion[j, 3] + SHOCK * struck**2 + RUBBING * closing)
        pressing[3] += max(0.0, 1.0 - (away * HALF) ** 2) ** 4
        lean = float(np.asarray(LEAN) @ way)
        diverging[:3] += way * part
        diverging[3] += part * (float(flow @ way) * motion[i, 3] + SMOOTH * (motion[j, 3] - motion[i, 3] + lean))
    return pressing, diverging


GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs the capability of a GPU")


@pytest.mark.parametrize("count", [1, 7, 8, 61])
@pytest.mark.parametrize(
    ("device", "kept"), [("cpu", 65), pytest.param("cuda", 65, marks=GPU), pytest.param("cuda", 9999, marks=GPU)]
)
def test_sums_over_neighbours_are_those_of_one_after_another(device: str, kept: int, count: int) -> None:
    """A GPU's block keeps no rows where there are 9,999."""
    random = np.random.default_rng(count)
    particles = 64
    place, motion = np.zeros((2, particles + 1, 4)), np.zeros((2, particles + 1, 4))
    place[:, -1, :3] = FAR
    place[1, :-1, :3] = random.uniform(-0.01, 0.01, (particles, 3))
    place[1, :-1, 3] = random.uniform(0.9e-6, 1.1e-6, particles)
    motion[1, :-1] = random.normal(size=(particles, 4))
    listed = [random.permutation(np.delete(np.arange(particles), i))[:count].tolist() for i in range(particles)]
    filled = -(-count // LANES) * LANES
    neighbours = np.full((2, particles, 64), particles, np.int32)
    neighbours[1, :, :count] = listed
    with wp.ScopedDevice(device):
        pressed, diverged = (wp.zeros(particles, dtype=wp.vec4) for _ in range(2))
        rows = [wp.array(each.astype(np.float32), dtype=wp.vec4) for each in (place, motion)]
        # Lists one after another, and side by side.
        listing = wp.array(neighbours)
        if device == "cuda":
            listing = wp.array(neighbours.transpose(0, 2, 1).copy()).transpose((0, 2, 1))
        inputs = [*rows, listing, kept, filled, wp.vec3(*LEAN), pressed, diverged]
        wp.launch(sums, 1 if device == "cpu" else BLOCK, inputs=inputs, block_dim=BLOCK)
    place, motion = (each.astype(np.float32).astype(float) for each in (place, motion))
    truth = [_plain(place[1], motion[1], i, listed[i]) for i in range(particles)]
    for found, expected in ((pressed, [t[0] for t in truth]), (diverged, [t[1] for t in truth])):
        scale = np.abs(expected).max(0)
        np.testing.assert_allclose(found.numpy() / scale, np.asarray(expected) / scale, atol=2e-5)


def _splash() -> World:
    """Return two pools that a thin wall parts, and a drop that falls into one of them, in two environments."""
    fixed = {"mass": 1.0, "fixed_base": True}
    walls = [box("between", size=(0.004, 0.04, 0.06), pose=Pose((0.0, 0.0, 0.03)), **fixed)]
    for side in (-1.0, 1.0):
        walls += [
            box(f"end_{side}", size=(0.02, 0.08, 0.12), pose=Pose((side * 0.052, 0.0, 0.06)), **fixed),
            box(f"side_{side}", size=(0.084, 0.02, 0.12), pose=Pose((0.0, side * 0.03, 0.06)), **fixed),
        ]
    pools = tuple(
        Fluid(name, (0.02, 0.02, 0.02), pose=Pose((x, 0.0, 0.02)), spacing=0.01)
        for name, x in (("left", -0.022), ("right", 0.022))
    )
    drop = Fluid("drop", (0.01, 0.01, 0.01), pose=Pose((0.022, 0.0, 0.1)), spacing=0.01)
    world = simulate(
        Scene(objects=tuple(walls), deformables=(*pools, drop), terrain=(Shape(Plane()),)),
        backend="mujoco",
        num_envs=2,
    )
    falling = world.deformables["drop"]
    velocities = torch.zeros_like(falling.positions)
    velocities[1, :, 2] = -1.5
    falling.set_state(falling.positions.clone(), velocities)
    return world


def _parts(world: World) -> list[Any]:
    return [part._fluid for part in world.engine._matter._parts]


def _lists(fluid: Any) -> list[list[list[int]]]:
    rows = zip(fluid.neighbours.numpy(), fluid.count.numpy(), strict=True)
    return [[row[:count].tolist() for row, count in zip(*each, strict=True)] for each in rows]


@pytest.mark.parametrize("crowded", [False, True])
def test_lists_that_follow_what_moved_are_those_of_a_search_for_all(
    monkeypatch: pytest.MonkeyPatch, crowded: bool
) -> None:
    """Order included, with a wall between particles, and where lists are too short for some."""
    if crowded:
        monkeypatch.setattr(fluids, "NEIGHBOURS", 56)
    world = _splash()
    before: dict[int, npt.NDArray] = {}
    few, full = 0, 0
    for step in range(80):
        world.step()
        for number, part in enumerate(_parts(world)):
            fluid = part._fluid
            followed, searched = _lists(fluid), fluid.searched.numpy().copy()
            with wp.ScopedDevice("cpu"):
                if crowded:
                    part.search_again()
                else:
                    fluid.stale.fill_(1)
                    shape = (fluid.x.shape[0], int(search.SEARCHERS))
                    wp.launch(search.compare, shape, inputs=[fluid], block_dim=BLOCK)
            assert followed == _lists(fluid)
            changed = (searched != before.get(number, searched)).any(-1).mean()
            few, before[number] = few + int(0.0 < changed < 0.25), searched
            full += sum(len(row) == 56 and row[-1] < len(rows) for rows in followed for row in rows)
            if step < 10:
                # Of 64 particles to the left of the wall none sees the 64 to its right, which are as near as others.
                assert not any(64 <= j < 128 for rows in followed for row in rows[:64] for j in row)
                near = np.linalg.norm(searched[:, :64, None] - searched[:, None, 64:128], axis=-1) < fluid.cell
                assert near.any()
    assert few > 20, few
    assert full > 0 or not crowded


def test_a_snapshot_of_a_splash_continues_as_the_run_did() -> None:
    world = _splash()
    for _ in range(20):
        world.step()
    state = world.save_state()
    found: list[list[torch.Tensor]] = []
    for _ in range(2):
        for _ in range(30):
            world.step()
        found.append([liquid.positions.clone() for liquid in world.deformables.values()])
        world.load_state(state)
    for first, again in zip(*found, strict=True):
        assert torch.equal(first, again)


@pytest.mark.parametrize("wide", [False, True])
def test_liquids_that_move_as_one_past_a_thin_divider_lose_each_other(wide: bool) -> None:
    """Two streams go along a wall 3 mm thick that begins between them, few of whose steps search."""
    fixed = {"mass": 1.0, "fixed_base": True}
    half, begin, speed = (0.01, 0.05, 0.02), 0.07, 0.3
    divider = box("divider", size=(0.003, 0.4, 0.2), pose=Pose((0.0, begin + 0.2, 0.2)), **fixed)
    streams = tuple(
        Fluid(name, half, pose=Pose((x, 0.0, 0.2)), spacing=0.01) for name, x in (("left", -0.016), ("right", 0.016))
    )
    scene = Scene(objects=(divider,), deformables=streams, gravity=(0.0, 0.0, 0.0))
    world = simulate(scene, backend="mujoco", num_envs=1)
    for stream in world.deformables.values():
        velocities = torch.zeros_like(stream.positions)
        velocities[..., 1] = speed
        stream.set_state(stream.positions.clone(), velocities)
    (part,) = _parts(world)
    part._is_wide = wide
    fluid, searches, met, near = part._fluid, 0, [], 0
    before, count = fluid.searched.numpy().copy(), fluid.x.shape[1] // 2
    for _ in range(60):
        world.step()
        searches += int((fluid.searched.numpy() != before).any())
        before, x = fluid.searched.numpy().copy(), fluid.x.numpy()[0]
        met.append([(i, j) for i, row in enumerate(_lists(fluid)[0][:count]) for j in row if count <= j < len(x)])
        # A wall that has come between two is looked for after a spacing at the latest, and half of it on a CPU.
        assert np.linalg.norm(fluid.carried.numpy()) < (0.0105 if wide else 0.0055)
        # Behind the wall's edge by more than particles move together between two searches.
        beside = x[:, 1] > begin + 0.013
        assert not any(beside[i] and beside[j] for i, j in met[-1])
        apart = np.linalg.norm(x[:count, None] - x[None, count:], axis=-1)
        near += int(((apart < fluid.cell) & beside[:count, None] & beside[None, count:]).sum())
    assert met[0]
    assert near > 1000, near
    assert 0 < searches < 40, searches
