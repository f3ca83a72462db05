"""Walls of liquids: sums over their cells against the same sums in double precision, one cell after another."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import torch
import warp as wp

from orbit_matter.fluid.walls import Filled, filled_by, lattice_of_box, layered_by, layers_of_box

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


@wp.kernel(enable_backward=False)
def both_sums(
    at: wp.array[wp.vec3], half: wp.vec3, pull: float, blow: float, one: wp.vec3, two: wp.vec3, skip: float,
    exact: wp.array[Filled], layered: wp.array[Filled],
):  # fmt: skip
    """Write the sums over a box's cells and over its layers, in the axes of the nearest face."""
    i = wp.tid()
    cells, layers = lattice_of_box(at[i], half, SPACING), layers_of_box(at[i], half, SPACING)
    n = wp.vec3(layers.axes[0, 2], layers.axes[1, 2], layers.axes[2, 2])
    first = layers.axes @ wp.vec3(one[0], one[1], 0.0)
    second = layers.axes @ wp.vec3(two[0], two[1], 0.0)
    got = filled_by(
        cells.at, cells.cell, cells.inside, cells.last, HALF, LENGTH, SOFT, n * pull, n * blow,
        wp.vec4(first[0], first[1], first[2], one[2] * SPACING),
        wp.vec4(second[0], second[1], second[2], two[2] * SPACING), skip, 0.0
    )  # fmt: skip
    back = wp.transpose(layers.axes)
    for m in range(3):
        k = wp.where(m == 2, 11, 3 * m)
        turned = back @ wp.vec3(got[k], got[k + 1], got[k + 2])
        for axis in range(3):
            got[k + axis] = turned[axis]
    exact[i] = got
    layered[i] = layered_by(
        layers.depth, layers.thick, layers.low, layers.high, SPACING, HALF * SPACING, LENGTH / SPACING,
        SOFT / (SPACING * SPACING), wp.vec3(0.0, 0.0, pull), blow, one, two, skip, 0.0
    )  # fmt: skip


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=GPU)])
@pytest.mark.parametrize("skip", [0.0, 1.0])
@pytest.mark.parametrize("half", [(0.05, 0.04, 0.03), (0.03, 0.02, 0.002)])
def test_layers_are_the_cells_where_a_particle_stands_in_their_row(
    half: tuple[float, ...], skip: float, device: str
) -> None:
    """Particles are in front of the middle of each cell of the upper and the lower face, at all heights."""
    random = np.random.default_rng(0)
    places = [(np.arange(round(2.0 * h / SPACING)) + 0.5) * SPACING - h for h in half[:2]]
    points = np.stack(np.meshgrid(*places, indexing="ij"), -1).reshape(-1, 2)
    side = random.choice([-1.0, 1.0], len(points))
    points = np.column_stack((points, side * (half[2] + random.uniform(0.002, 0.02, len(points)))))
    with wp.ScopedDevice(device):
        exact, layered = wp.zeros(len(points), dtype=Filled), wp.zeros(len(points), dtype=Filled)
        # Other walls begin between two rows: one below a particle's own row, one above the next.
        planes = [wp.vec3(1.0, 0.0, 0.5), wp.vec3(0.0, -1.0, 1.5)]
        inputs = [wp.array(points.astype(np.float32), dtype=wp.vec3), wp.vec3(*half), -9.81, 0.7, *planes, skip]
        wp.launch(both_sums, len(points), inputs=[*inputs, exact, layered])
        wanted, got = exact.numpy(), layered.numpy()
    scale = np.abs(wanted).max(0)
    # A blow along the normal presses along it only in layers.
    columns = [*range(11), 13]
    assert (np.abs(got - wanted)[:, columns] <= 2e-4 * scale.max()).all()
    assert (np.abs(got - wanted)[:, columns] <= 2e-3 * scale[columns] + 1e-9).all()


@pytest.mark.parametrize("end", [-0.25, 0.0, 0.25, 0.75, 1.0])
def test_layers_that_end_between_rows_press_as_what_fills_them(end: float) -> None:
    """The truth is the integral over a half-plane of two layers, 1 and 2 spacings below the particle."""
    x = np.arange(-2.59, 2.6, 0.02)
    along, across = np.meshgrid(x, x[x < end])
    wanted = np.zeros(2)
    for z in (1.0, 2.0):
        part = np.maximum(0.0, 1.0 - np.sqrt(along**2 + across**2 + z**2) / 2.6) ** 3 * 0.02**2
        wanted += [z * part.sum(), -(across * part).sum()]
    # A box that is wide along the first axis and ends along the second one.
    half, point = (0.2, 0.1, 0.05), (0.0, 0.1 - end * SPACING, 0.055)
    with wp.ScopedDevice("cpu"):
        exact, layered = wp.zeros(1, dtype=Filled), wp.zeros(1, dtype=Filled)
        inputs = [wp.array([point], dtype=wp.vec3), wp.vec3(*half), 0.0, 0.0, wp.vec3(), wp.vec3(), 0.0]
        wp.launch(both_sums, 1, inputs=[*inputs, exact, layered])
        got = layered.numpy()[0]
    assert abs(got[2] / SPACING - wanted[0]) < 0.025
    assert abs(abs(got[1]) / SPACING - wanted[1]) < 0.025
