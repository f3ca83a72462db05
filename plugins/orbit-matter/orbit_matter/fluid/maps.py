"""Maps of what meshes, height fields and unions of convex pieces give a particle of liquid, looked up by its place.

A wall presses as liquid that fills it would (``walls.py``). What fills a hollow mesh around a particle is found on a
grid in the mesh's frame, by rays: a ray is filled from where it enters the mesh to where it leaves it, and beyond where
it leaves through a face that is opposite to one around, as a thin wall holds as a thick one does. So every side of a
hollow acts, and its curvature, as in the maps of Koschier and Bender, "Density maps for improved SPH boundary handling"
(2017), and of Bender, Kugelstadt, Weiler and Koschier, "Volume maps: an implicit boundary representation for SPH"
(2019).

A point of the grid keeps its nearest wall, of which the half-space behind it has a closed form, and what there is more
or less than this half-space. Sums between points are linear in the latter only, and a point takes no part where the
particle is on another side of a wall: walls may be thinner than the grid is fine.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportInvalidTypeForm=false
# ruff: noqa: UP018, RUF046 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import functools
import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from orbit_matter.colliders import Colliders
from orbit_matter.fluid.extent import FINENESS, is_mappable, points_of
from orbit_matter.fluid.fluids import SMOOTHING, kernel_of
from orbit_matter.fluid.walls import SOFT, layered_by, layers_behind
from orbit_matter.surfaces import mesh_distance
from orbit_warpkit.loading import tell

FloatArray = npt.NDArray[np.floating]

RAYS = 144
"""Directions around a point; half of them end in a flat wall that is close."""
FIRST = wp.constant(36)
"""Rays after which a point is plain that has met nothing but its nearest wall, as a plane."""
EVEN = wp.constant(5.0e-5)
"""Most by which a ray may differ from one at a plane, times the number of rays, of which a quarter or half are enough
then; a whole ray has 0.037. Means of what points give change by 0.1 % of a wall."""
MANY = 100_000
"""Points near a surface above which a CPU takes seconds, and tells how far it is."""
PARTS = 10
"""Times that it tells."""
STEPS = wp.constant(96)
"""Steps of the table of half-spaces, over the kernel's reach."""
CONES = wp.constant(256)
"""Cones around the normal of a half-space, over which it is integrated."""
OPPOSITE = wp.constant(-0.7)
"""Cosine between the faces that a ray enters and leaves by, below which they are the two sides of a wall."""
ASIDE = wp.constant(0.7)
"""Most that the normals of two walls have in common which are taken for two."""
CLEAR = wp.constant(0.01)
"""Spacings in front of a surface where rays begin at least."""
FAR = wp.constant(0.85)
"""Part of the kernel's reach from where on the nearest wall says enough: what more there is gives 0.3 % of a wall."""
BEHIND = wp.constant(0.1)
"""Spacings that a particle and a point may be behind each other's walls and on the same side: of a bulge they are."""
NODE, PLAIN, SOLID = wp.constant(0), wp.constant(-1), wp.constant(-2)
"""Kinds of points: one that has a node, one where the particle's nearest wall says all, and one deep in the mesh."""
SIDES = wp.constant(4)
"""Times at most that a ray enters a mesh within the kernel's reach."""

Node = wp.types.vector(length=14, dtype=float)
"""Nearest wall as its normal and the distance to it; and, more or less than the half-space behind it, the sums of the
kernel's gradient (3, 1/m), of its second moments (6, no unit: xx, yy, zz, yz, xz, xy) and of the kernel that ``packed``
sums."""
Half = wp.types.vector(length=5, dtype=float)
"""Sums over a half-space: of the gradient, of second moments along the normal and across, of the kernel, and the blow
of one at 1 m/s."""
Given = wp.types.vector(length=7, dtype=float)
"""Sum of gradients, pull of what is deeper, and sum of the kernel."""


@wp.struct
class Maps:
    """Grids of all mapped shapes, one after another."""

    of: wp.array2d[int]
    """(K, S) map of each shape; -1 for none."""
    low: wp.array[wp.vec3]
    """First point of each map in the shape's frame."""
    size: wp.array[wp.vec3i]
    """Points along each axis."""
    start: wp.array[int]
    """First of each map in ``index``."""
    index: wp.array[int]
    """Node of each point, PLAIN or SOLID."""
    node: wp.array[Node]
    """Nearest wall and sums of each point that has a node."""
    half: wp.array[Half]
    """Half-spaces from one at the particle to one out of reach."""
    cell: float
    """m between points."""
    reach: float
    """m of the kernel."""
    behind: float
    """m that a particle and a point may be behind each other's walls."""


@wp.func
def half_space(table: wp.array[Half], reach: float, d: float) -> Half:
    """Return the sums over the half-space that begins a distance below a point."""
    u = wp.clamp(d / reach, 0.0, 1.0) * float(STEPS)
    k = wp.min(int(u), STEPS - 1)
    part = u - float(k)
    return table[k] * (1.0 - part) + table[k + 1] * part


@wp.func
def turned_by(node: Node, pull: wp.vec3) -> wp.vec3:
    """Return the product of the second moments of a node and a vector."""
    return wp.vec3(
        node[7] * pull[0] + node[12] * pull[1] + node[11] * pull[2],
        node[12] * pull[0] + node[8] * pull[1] + node[10] * pull[2],
        node[11] * pull[0] + node[10] * pull[1] + node[9] * pull[2],
    )


@wp.func
def mapped(m: Maps, number: int, p: wp.vec3, n: wp.vec3, d: float, pull: wp.vec3) -> Given:
    """Return what a mapped shape gives a particle.

    Args:
        m: all maps.
        number: of the shape's map.
        p: the particle in the shape's frame, m.
        n: normal of its nearest wall there.
        d: distance to it, m.
        pull: gravity in the shape's frame, m/s^2.
    """
    size, u = m.size[number], (p - m.low[number]) / m.cell
    a = wp.vec3i(int(wp.floor(u[0])), int(wp.floor(u[1])), int(wp.floor(u[2])))
    given, pulled, kernel, whole = wp.vec3(), wp.vec3(), float(0.0), float(0.0)
    plain = float(0.0)
    for corner in range(8):
        i, j, k = a[0] + (corner & 1), a[1] + ((corner >> 1) & 1), a[2] + (corner >> 2)
        at = int(PLAIN)
        if wp.min(i, wp.min(j, k)) >= 0 and i < size[0] and j < size[1] and k < size[2]:
            at = m.index[m.start[number] + (i * size[1] + j) * size[2] + k]
        weight = (1.0 - wp.abs(u[0] - float(i))) * (1.0 - wp.abs(u[1] - float(j))) * (1.0 - wp.abs(u[2] - float(k)))
        if at == PLAIN:
            plain += weight
        if at >= 0:
            node = m.node[at]
            own = wp.vec3(node[0], node[1], node[2])
            way = p - m.low[number] - wp.vec3(float(i), float(j), float(k)) * m.cell
            height = node[3] + wp.dot(own, way)
            # The point of the surface that is nearest to the node, over the particle's own wall.
            over, allowed = d - wp.dot(n, way + own * node[3]), -m.behind
            if wp.dot(n, own) < OPPOSITE:
                allowed = float(0.0)
            if height > -m.behind and over >= allowed:
                half = half_space(m.half, m.reach, height)
                along = wp.dot(own, pull)
                given += (wp.vec3(node[4], node[5], node[6]) + own * half[0]) * weight
                pulled += (turned_by(node, pull) + pull * half[2] + own * (along * (half[1] - half[2]))) * weight
                kernel += (node[13] + half[3]) * weight
                whole += weight
    # Of points in a thin wall, and behind it, some are no use; where all are, the nearest wall is what is known.
    whole += plain
    if whole < 0.02:
        plain, whole = float(1.0), float(1.0)
        given, pulled, kernel = wp.vec3(), wp.vec3(), float(0.0)
    if plain > 0.0:
        half = half_space(m.half, m.reach, d)
        given += n * (half[0] * plain)
        pulled += (pull * half[2] + n * (wp.dot(n, pull) * (half[1] - half[2]))) * plain
        kernel += half[3] * plain
    given, pulled, kernel = given / whole, pulled / whole, kernel / whole
    return Given(given[0], given[1], given[2], -pulled[0], -pulled[1], -pulled[2], kernel)


@wp.func
def _moments(u: float) -> wp.vec3:
    """Integrals over a ray from 0 to u of its reach: (1 - u)^3 u^3, (1 - u)^3 u^4 and (1 - u^2)^4 u^2."""
    s = u * u
    first = s * s * (0.25 + u * (-0.6 + u * (0.5 - u / 7.0)))
    second = s * s * u * (0.2 + u * (-0.5 + u * (3.0 / 7.0 - u / 8.0)))
    third = s * u * (1.0 / 3.0 + s * (-0.8 + s * (6.0 / 7.0 + s * (-4.0 / 9.0 + s / 11.0))))
    return wp.vec3(first, second, third)


@wp.kernel(enable_backward=False)
def _tabulate(spacing: float, length: float, slope: float, share: float, found: wp.array[Half]):
    """Write the sums over half-spaces."""
    i = wp.tid()
    # Over cones around the normal, whose rays are as long in front of the wall.
    u, packed = float(i) / float(STEPS), float(0.0)
    for k in range(CONES):
        c = u + (float(k) + 0.5) * (1.0 - u) / float(CONES)
        packed += (_moments(1.0)[2] - _moments(u / c)[2]) * (2.0 * wp.pi * (1.0 - u) / float(CONES))
    # Particles at a wall stand in layers, and press on it as those of a lattice do: their pressure is as on a box.
    layers, ratio, none = layers_behind(u * 2.0 * length, wp.vec3(0.0, 0.0, 1.0), spacing), length / spacing, wp.vec3()
    got = layered_by(
        layers.depth, layers.thick, layers.low, layers.high, spacing, 0.5 / ratio, ratio, SOFT * ratio * ratio,
        wp.vec3(1.0, 0.0, 1.0), 1.0, none, none, 0.0, 0.0,
    )  # fmt: skip
    scale = slope * spacing * spacing * spacing
    found[i] = Half(got[2] * scale, got[5] * scale, got[3] * scale, packed * share, got[13] * scale)


@wp.func
def _filled_along(mesh: wp.uint64, x: wp.vec3, way: wp.vec3, reach: float, step: float, seen: wp.mat33) -> wp.vec4:
    """Integrate along a ray where it is filled.

    Args:
        mesh: Warp's number.
        x: start of the ray.
        way: its direction.
        reach: m of it.
        step: m by which it goes on behind a face.
        seen: normals of the walls that are around its start, which say where it is filled on.

    Returns:
        The three integrals, and 1 if ``seen`` mattered, else 0.
    """
    found, r, k, mattered = wp.vec3(), float(0.0), int(0), float(0.0)
    while k < SIDES and r < reach:
        k += 1
        into = wp.mesh_query_ray(mesh, x + way * r, way, reach - r)
        if not into.result:
            k = SIDES
        else:
            begin = r + into.t
            r = begin + step
            if wp.dot(into.normal, way) < 0.0:
                end, out = float(reach), wp.mesh_query_ray(mesh, x + way * r, way, reach - r)
                if out.result and wp.dot(out.normal, way) > 0.0:
                    mattered = 1.0
                    facing = wp.min(wp.min(seen @ out.normal), wp.dot(out.normal, into.normal))
                    if facing > OPPOSITE:
                        end = r + out.t
                found += _moments(end / reach) - _moments(begin / reach)
                r = end + step
    return wp.vec4(found[0], found[1], found[2], mattered)


@wp.func
def _walls_around(mesh: wp.uint64, x: wp.vec3, n: wp.vec3, rays: wp.array[wp.vec3], reach: float) -> wp.mat33:
    """Return the normals, one a row, of the nearest wall and of up to two more that rays meet and that face aside."""
    seen = wp.matrix_from_rows(n, n, n)
    count, k = int(1), int(0)
    while k < rays.shape[0] and count < 3:
        hit = wp.mesh_query_ray(mesh, x, rays[k], reach)
        if hit.result and wp.dot(hit.normal, rays[k]) < 0.0 and wp.max(seen @ hit.normal) < ASIDE:
            seen[count] = hit.normal
            count += 1
        k += 1
    return seen


@wp.func
def _point_of(i: int, low: wp.vec3, size: wp.vec3i, cell: float) -> wp.vec3:
    """Return the place of a point of a grid."""
    at = wp.vec3i(i // (size[1] * size[2]), (i // size[2]) % size[1], i % size[2])
    return low + wp.vec3(float(at[0]), float(at[1]), float(at[2])) * cell


@wp.kernel(enable_backward=False)
def _sort_out(
    first: int, mesh: wp.uint64, low: wp.vec3, size: wp.vec3i, cell: float, reach: float, state: wp.array[int]
):
    """Find which points of a grid need rays, from the ``first`` on."""
    i = first + wp.tid()
    d = mesh_distance(_point_of(i, low, size, cell), mesh, reach)[3]
    state[i] = NODE
    if d > FAR * reach:
        state[i] = PLAIN
    if d < -1.8 * cell:
        state[i] = SOLID


@wp.kernel(enable_backward=False)
def _survey(
    first: int, mesh: wp.uint64, low: wp.vec3, size: wp.vec3i, cell: float, reach: float, spacing: float,
    scales: wp.vec3, rays: wp.array[wp.vec3], chosen: wp.array[int], state: wp.array[int], nodes: wp.array[Node],
):  # fmt: skip
    """Find what fills a mesh around points of its grid.

    Args:
        first: of the chosen points that is surveyed.
        mesh: Warp's number.
        low: first point of the grid.
        size: points along each axis.
        cell: m between points.
        reach: m of the kernel.
        spacing: m of the liquid's particles.
        scales: of the integrals of the gradient, of second moments and of the kernel.
        rays: directions, evenly over the sphere.
        chosen: points that need rays.
        state: of each chosen point; NODE, or PLAIN where its nearest wall says all.
        nodes: what was found.
    """
    i = first + wp.tid()
    q = _point_of(chosen[i], low, size, cell)
    plane, clear = mesh_distance(q, mesh, reach), CLEAR * spacing
    n, d = wp.vec3(plane[0], plane[1], plane[2]), plane[3]
    # From within a wall, as on the surface that is nearest.
    x, h = q - n * (d - clear), clear
    if d > clear:
        x, h = q, d
    state[i] = PLAIN
    given, kernel = wp.vec3(), float(0.0)
    squares, products = wp.vec3(), wp.vec3()
    most, scale, k, looked = float(0.0), float(1.0), int(0), int(0)
    seen = wp.matrix_from_rows(n, n, n)
    while k < rays.shape[0]:
        way = rays[k]
        k += 1
        found = _filled_along(mesh, x, way, reach, 0.1 * clear, seen)
        if found[3] > 0.0 and looked == 0:
            # Only what a ray leaves by is compared with the walls around, which take as many rays to find.
            seen, looked = _walls_around(mesh, x, n, rays, reach), 1
            found = _filled_along(mesh, x, way, reach, 0.1 * clear, seen)
        more = wp.vec3(found[0], found[1], found[2])
        fall = -wp.dot(n, way)
        if fall * reach > h:
            more -= _moments(1.0) - _moments(h / (fall * reach))
        most = wp.max(most, wp.abs(more[2]))
        given -= way * more[0]
        squares += wp.cw_mul(way, way) * more[1]
        products += wp.vec3(way[1] * way[2], way[0] * way[2], way[0] * way[1]) * more[1]
        kernel += more[2]
        if k == FIRST and most < 1.0e-4:
            return
        if (k == FIRST or k == 2 * FIRST) and most < EVEN * float(k):
            scale, k = scale * float(rays.shape[0]) / float(k), rays.shape[0]
    given, kernel = given * (scales[0] * scale), kernel * (scales[2] * scale)
    squares, products = squares * (scales[1] * scale), products * (scales[1] * scale)
    state[i] = NODE
    nodes[i] = Node(
        n[0], n[1], n[2], d, given[0], given[1], given[2], squares[0], squares[1], squares[2],
        products[0], products[1], products[2], kernel,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Grid:
    """Grid around one mesh, and what was found at its points."""

    low: FloatArray
    """(3,) m, its first point in the mesh's frame."""
    size: tuple[int, int, int]
    """Points along each axis."""
    index: npt.NDArray[np.int32]
    """(X Y Z,) row in ``nodes``, PLAIN or SOLID."""
    nodes: npt.NDArray[np.float32]
    """(n, 14)"""


@functools.lru_cache(maxsize=32)
def grid_of(vertices: bytes, faces: bytes, bounds: tuple[tuple[float, ...], ...], spacing: float, device: str) -> Grid:
    """Survey a mesh.

    Args:
        vertices: (V, 3) single-precision metres.
        faces: (F, 3) 32-bit indices.
        bounds: lowest and highest corner of the box whose surroundings are surveyed, m.
        spacing: of the liquid's particles, m.
        device: that computes it.
    """
    points = np.frombuffer(vertices, np.float32).reshape(-1, 3)
    box = np.asarray(bounds)
    reach, cell, size = 2.0 * SMOOTHING * spacing, FINENESS * spacing, points_of(box, spacing)
    low, count = box.min(axis=0) - reach - cell, math.prod(size)
    with wp.ScopedDevice(device) as scope:
        indices = wp.array(np.frombuffer(faces, np.int32), dtype=int)
        mesh = wp.Mesh(points=wp.array(points, dtype=wp.vec3), indices=indices)
        state, grid = wp.zeros(count, dtype=int), [mesh.id, wp.vec3(*low), wp.vec3i(*size), cell, reach]
        _launch(_sort_out, 0, count, [*grid, state], scope)
        index = state.numpy().copy()
        near = np.flatnonzero(index == NODE).astype(np.int32)
        # Kernels take no empty arrays.
        kept, nodes = wp.zeros(len(near) + 1, dtype=int), wp.zeros(len(near) + 1, dtype=Node)
        chosen, rays = wp.array(np.append(near, 0), dtype=int), wp.array(_directions(), dtype=wp.vec3)
        scales = _scales(spacing) * (4.0 * math.pi / RAYS)
        inputs = [*grid, spacing, scales, rays, chosen, kept, nodes]
        # A GPU takes all points at once.
        parts = PARTS if scope.is_cpu and len(near) > MANY else 1
        if parts > 1:
            tell(f"orbit-matter: mapping what a surface gives liquids, {len(near):,} points")
        for part in range(parts):
            _launch(_survey, len(near) * part // parts, len(near) * (part + 1) // parts, inputs, scope)
            if parts > 1:
                tell(f" {100 * (part + 1) // parts} %" + "\n" * (part == parts - 1))
        is_node = kept.numpy()[:-1] == NODE
        index[near] = np.where(is_node, np.cumsum(is_node) - 1, int(PLAIN))
        return Grid(low, size, index, nodes.numpy()[:-1][is_node])


def _launch(kernel: Any, first: int, end: int, inputs: list[Any], device: wp.Device) -> None:
    """Launch a kernel for the places from ``first`` to ``end``: by each core of a CPU for some.

    Args:
        kernel: whose first input is the first place.
        first: of the places.
        end: the place after the last.
        inputs: the others.
        device: that computes it.
    """
    cores = len(os.sched_getaffinity(0)) if device.is_cpu else 1
    ends = [first + (end - first) * core // cores for core in range(cores + 1)]
    # Threads would load it at the same time.
    wp.load_module(__name__, device=device, block_dim=1 if device.is_cpu else 256)

    def launch(begin: int, end: int) -> None:
        wp.launch(kernel, end - begin, inputs=[begin, *inputs], device=device)

    own, *others = pairwise(ends)
    with ThreadPoolExecutor(max(len(others), 1)) as pool:
        running = [pool.submit(launch, *each) for each in others]
        launch(*own)
        for each in running:
            each.result()


def _directions() -> FloatArray:
    """Return (RAYS, 3) directions, evenly over the sphere, and the first of them as well."""
    k = np.arange(RAYS) + 0.5
    z, turn = 1.0 - 2.0 * k / RAYS, math.pi * (1.0 + math.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z * z)
    found = np.stack((across * np.cos(turn), across * np.sin(turn), z), axis=-1)
    return found[np.argsort(k * math.sqrt(2.0) % 1.0)].astype(np.float32)


def _scales(spacing: float) -> wp.vec3:
    """Return what turns integrals over rays, for a steradian, into sums of gradients, second moments and the kernel."""
    (slope, peak), reach = kernel_of(spacing), 2.0 * SMOOTHING * spacing
    return wp.vec3(slope * reach**4, slope * reach**5, peak * (reach / spacing) ** 3)


def build(colliders: Colliders, spacing: float, device: wp.Device) -> Any:
    """Return the :class:`Maps` of the hollow meshes, united pieces and curved objects among what liquids meet."""
    of, grids, known = np.full((colliders.kinds, colliders.count), -1, np.int32), [], {}
    for place, surface in colliders.surfaces.items():
        if not is_mappable(surface.bounds, spacing):
            continue
        mesh, bounds = surface.mesh, tuple(map(tuple, surface.bounds.tolist()))
        key = (mesh.vertices.astype(np.float32).tobytes(), mesh.faces.astype(np.int32).tobytes(), bounds)
        if key not in known:
            known[key] = len(grids)
            grids.append(grid_of(*key, spacing, device.alias))
        of[place] = known[key]
    made, length = Maps(), SMOOTHING * spacing
    firsts = np.cumsum([0, *(len(grid.nodes) for grid in grids)])
    pairs = zip(grids, firsts[:-1], strict=True)
    indices = [np.where(grid.index >= 0, grid.index + first, grid.index) for grid, first in pairs]
    with wp.ScopedDevice(device):
        made.of = wp.array(of, dtype=int)
        # Kernels take no empty arrays.
        made.low = wp.array([*(grid.low for grid in grids), np.zeros(3)], dtype=wp.vec3)
        made.size = wp.array([*(grid.size for grid in grids), (0, 0, 0)], dtype=wp.vec3i)
        starts = np.cumsum([0, *(len(grid.index) for grid in grids)])
        made.start = wp.array(starts, dtype=int)
        made.index = wp.array(np.concatenate([*indices, np.full(1, PLAIN)]), dtype=int)
        rows = [grid.nodes.reshape(-1, 14) for grid in grids]
        made.node = wp.array(np.concatenate([*rows, np.zeros((1, 14), np.float32)]), dtype=Node)
        made.half = wp.zeros(STEPS + 1, dtype=Half)
        if grids:
            inputs = [spacing, length, kernel_of(spacing)[0], _scales(spacing)[2], made.half]
            wp.launch(_tabulate, STEPS + 1, inputs=inputs)
    wp.synchronize_device(device)
    made.cell, made.reach, made.behind = FINENESS * spacing, 2.0 * length, float(BEHIND) * spacing
    return made
