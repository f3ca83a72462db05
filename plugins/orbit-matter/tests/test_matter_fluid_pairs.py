"""Sums over neighbours against the same sums in double precision, one neighbour after another."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import torch
import warp as wp

from orbit_matter.block import BLOCK
from orbit_matter.fluid.pairs import FAR, LANES, Pressing, diverged_from, keep, pressed_by

HALF, LENGTH, SOFT, SHOCK, SMOOTH, FASTEST = 60.0, 0.0083, 7e-7, 2000.0, 0.004, 1.5
LEAN = (0.02, -0.01, 0.14)


@wp.kernel(enable_backward=False)
def sums(
    place: wp.array2d[wp.vec4],
    motion: wp.array2d[wp.vec4],
    neighbours: wp.array3d[int],
    kept: int,
    count: int,
    lean: wp.vec3,
    pressed: wp.array[Pressing],
    diverged: wp.array[wp.vec4],
):
    """Write both sums of each particle of the second environment, of which a block keeps so many rows."""
    lane = wp.tid()
    rows = keep(place, motion, 1, kept)
    for i in range(lane, pressed.shape[0], wp.block_dim()):
        pressed[i] = pressed_by(rows, place, motion, neighbours, 1, i, count, HALF, LENGTH, SOFT, SHOCK, FASTEST)
        diverged[i] = diverged_from(rows, place, motion, neighbours, 1, i, count, HALF, SMOOTH, lean)


def _plain(place: npt.NDArray, motion: npt.NDArray, i: int, listed: list[int]) -> tuple[npt.NDArray, npt.NDArray]:
    pressing, diverging = np.zeros(7), np.zeros(4)
    for j in listed:
        way, flow = place[i, :3] - place[j, :3], motion[j, :3] - motion[i, :3]
        away = float(np.linalg.norm(way))
        t = max(0.0, 1.0 - away * HALF)
        part = t**3 * place[j, 3]
        closing = max(0.0, float(flow @ way)) * LENGTH / (away**2 + SOFT)
        closing = min(closing, FASTEST)
        pressing[:3] += way * part * (motion[i, 3] + motion[j, 3] + SHOCK * closing**2)
        pressing[3:6] += flow * part
        pressing[6] += max(0.0, 1.0 - (away * HALF) ** 2) ** 4
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
        pressed, diverged = wp.zeros(particles, dtype=Pressing), wp.zeros(particles, dtype=wp.vec4)
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
