"""Walls of liquids: sums over their cells against the same sums in double precision, one cell after another."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import torch
import warp as wp

from orbit_matter.fluid.walls import Filled, filled_by, lattice_of_box

SPACING, HALF, LENGTH, SOFT = 0.01, 1.0 / 0.026, 0.013, 1.69e-6
PULL, FLOW = (0.5, -0.2, -9.81), (0.3, 0.1, 0.7)
ONE, TWO = (-1.0, 0.0, 0.0, 0.009), (0.0, 1.0, 0.0, 0.004)
GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs the capability of a GPU")


@wp.kernel(enable_backward=False)
def sums(
    at: wp.array[wp.vec3], half: wp.vec3, pull: wp.vec3, flow: wp.vec3, one: wp.vec4, two: wp.vec4, skip: float,
    found: wp.array[Filled], volumes: wp.array[float],
):  # fmt: skip
    """Write the sums over a box's cells around each point in its frame."""
    i = wp.tid()
    cells = lattice_of_box(at[i], half, SPACING)
    volumes[i] = cells.volume
    found[i] = filled_by(
        cells.at, cells.cell, cells.inside, cells.last, HALF, LENGTH, SOFT, pull, flow, one, two, skip, 0.0
    )  # fmt: skip


def _cells(p: npt.NDArray, half: npt.NDArray) -> npt.NDArray:
    """Return the (C, 3) middles of a box's cells and of those behind the faces that a point is in front of."""
    sizes = 2.0 * half / np.maximum(np.round(2.0 * half / SPACING), 1.0)
    rows = [np.arange(-20, 20 + round(2.0 * h / size)) for h, size in zip(half, sizes, strict=True)]
    index = np.stack(np.meshgrid(*rows, indexing="ij"), -1).reshape(-1, 3)
    count = np.round(2.0 * half / sizes)
    behind = np.where(p > half, index < 0, np.where(p < -half, index >= count, False))
    inside = (index >= 0) & (index < count)
    seen = (inside | behind).all(1) & (behind.sum(1) <= 1)
    return (index[seen] + 0.5) * sizes - half


def _plain(p: npt.NDArray, half: npt.NDArray, skip: float) -> npt.NDArray:
    x = p - _cells(p, half)
    away = np.linalg.norm(x, axis=1)
    part = np.maximum(0.0, 1.0 - away * HALF) ** 3
    packed = np.maximum(0.0, 1.0 - (away * HALF) ** 2) ** 4
    behind = [(x @ np.array(plane[:3]) > plane[3]).astype(float) for plane in (ONE, TWO)]
    part, packed = part * (1.0 - skip * behind[0]), packed * (1.0 - skip * behind[0])
    pulled = part * (x @ np.array(PULL))
    shocked = part * (np.maximum(0.0, x @ np.array(FLOW)) * LENGTH / (away**2 + SOFT)) ** 2
    along = [over * (x @ np.array(plane[:3])) for over, plane in zip(behind, (ONE, TWO), strict=True)]
    corners = [float((each * weight).sum()) for each in along for weight in (part, pulled)]
    return np.array([*(x.T @ part), *(x.T @ pulled), packed.sum(), *corners, *(x.T @ shocked)])


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=GPU)])
@pytest.mark.parametrize("skip", [0.0, 1.0])
@pytest.mark.parametrize("half", [(0.05, 0.04, 0.03), (0.003, 0.05, 0.05), (0.05, 0.006, 0.02)])
def test_sums_over_cells_are_those_of_one_after_another(half: tuple[float, ...], skip: float, device: str) -> None:
    """Points are in front of faces, edges and corners of a box, of a thin one, and of one of odd size."""
    random = np.random.default_rng(0)
    size = np.array(half)
    points = random.uniform(-1.0, 1.0, (64, 3)) * (size + 0.02)
    points = points[(np.abs(points) > size + 0.001).any(1)]
    with wp.ScopedDevice(device):
        found, volumes = wp.zeros(len(points), dtype=Filled), wp.zeros(len(points), dtype=float)
        inputs = [wp.array(points.astype(np.float32), dtype=wp.vec3), wp.vec3(*half), wp.vec3(*PULL), wp.vec3(*FLOW)]
        inputs += [wp.vec4(*ONE), wp.vec4(*TWO), skip, found, volumes]
        wp.launch(sums, len(points), inputs=inputs)
        got = found.numpy()
    expected = np.array([_plain(p, size, skip) for p in points.astype(np.float32).astype(float)])
    scale = np.abs(expected).max(0)
    # What is behind the first plane was left out where it is skipped.
    assert (scale > 0.0).tolist() == [not (skip and 7 <= k < 9) for k in range(14)]
    assert (np.abs(got - expected) <= 2e-5 * scale).all()
    assert volumes.numpy() == pytest.approx(np.prod(2.0 * size / np.maximum(np.round(2.0 * size / SPACING), 1.0)))
