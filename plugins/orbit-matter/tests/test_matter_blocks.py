"""Operations that the threads of a block do together, on a GPU with all of its threads and on a CPU with one."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

from orbit_matter.block import BLOCK, rank_in_block, sum_of_block
from orbit_matter.solids.kernels import LANES
from orbit_matter.solids.product import ENVS, ROWS, multiply

GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs the capability of a GPU")
DEVICES = pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=GPU)])


@wp.kernel(enable_backward=False)
def product(
    rows: wp.array2d[float],
    inverse: wp.array2d[float],
    preset: wp.array2d[int],
    out: wp.array2d[float],
    first: int,
    padded: int,
    count: int,
    attached: int,
):
    """Multiply the second of two solids."""
    group, tile, _lane = wp.tid()
    multiply(rows, inverse, preset, out, ENVS * group, 1, first, ROWS * tile, padded, count, 0, attached)


@wp.kernel(enable_backward=False)
def together(numbers: wp.array[float], sums: wp.array[float], ranks: wp.array[wp.vec2i]):
    """Write the sum of a block's numbers, and how many before each and of all are positive."""
    i = wp.tid()
    sums[i] = sum_of_block(numbers[i])
    ranks[i] = rank_in_block(wp.where(numbers[i] > 0.0, 1, 0))


@DEVICES
def test_a_product_takes_the_matrix_that_each_environment_chose(device: str) -> None:
    """150 environments are two tiles and a part, of which the first has one matrix and the second both."""
    random, envs, first, count, padded = np.random.default_rng(0), 150, LANES, 75, 3 * LANES
    matrices = random.normal(size=(2, count, count))
    blocks = np.zeros((2, padded, count))
    blocks[:, :count] = matrices
    packed = blocks.reshape(2, padded // LANES, LANES, count).transpose(0, 1, 3, 2).reshape(-1, LANES)
    residuals = np.zeros((envs, first + padded))
    residuals[:, first : first + count] = random.normal(size=(envs, count))
    preset = np.zeros((envs, 2), np.int32)
    preset[64:, 1] = random.integers(0, 2, envs - 64)
    with wp.ScopedDevice(device):
        rows, inverse = (wp.array(each.astype(np.float32)) for each in (residuals, packed))
        out = wp.full(residuals.shape, 7.0, dtype=float)
        inputs = [rows, inverse, wp.array(preset), out, first, padded, count, len(packed) // 2]
        tiles = (-(-envs // int(ENVS)), -(-padded // int(ROWS)), 1 if device == "cpu" else BLOCK)
        wp.launch(product, tiles, inputs=inputs, block_dim=BLOCK)
        found = out.numpy()
    expected = np.einsum("nij,nj->ni", matrices[preset[:, 1]], residuals[:, first : first + count])
    np.testing.assert_allclose(found[:, first : first + count], expected, atol=2e-5)
    assert (found[:, :first] == 7.0).all(), "what is of another solid stays"
    assert (found[:, first + count :] == 0.0).all()


@DEVICES
def test_a_block_adds_up_and_counts_the_numbers_of_its_threads(device: str) -> None:
    threads = 1 if device == "cpu" else BLOCK
    numbers = np.random.default_rng(0).normal(size=threads).astype(np.float32)
    with wp.ScopedDevice(device):
        sums, ranks = wp.zeros(threads, dtype=float), wp.zeros(threads, dtype=wp.vec2i)
        wp.launch(together, threads, inputs=[wp.array(numbers), sums, ranks], block_dim=BLOCK)
        found, places = sums.numpy(), ranks.numpy()
    assert found[0] == pytest.approx(numbers.astype(float).sum(), abs=1e-4)
    assert (found == found[0]).all()
    positive = numbers > 0.0
    np.testing.assert_array_equal(places[:, 0], np.cumsum(positive) - positive)
    assert (places[:, 1] == positive.sum()).all()
