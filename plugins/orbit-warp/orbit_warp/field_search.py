"""Contacts of shapes with the triangles of height fields that they are near: MuJoCo-Warp's search, a thread for each.

MuJoCo-Warp itself gives all prisms under a shape to one thread, which the slowest then makes all others wait for.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp
from mujoco import mjtGeom
from mujoco_warp._src.collision_core import Geom, contact_margin_gap
from mujoco_warp._src.collision_gjk import ccd
from mujoco_warp._src.types import mat63

from orbit_warp.field_kernel import Contacts, Materials, Near, Scene, add_contact, field_around, triangle

_FIELD = wp.constant(int(mjtGeom.mjGEOM_HFIELD))
_MESH = wp.constant(int(mjtGeom.mjGEOM_MESH))
_FAR = wp.constant(1e10)
_MOST_OF_PAIR = wp.constant(4)
# Metres within which MuJoCo-Warp takes contacts for one.
_CLOSE = wp.constant(1e-3)


@wp.struct
class Meshes:
    """Vertices of a MuJoCo model's meshes, and the edges of their hulls."""

    starts: wp.array[int]
    """First vertex of each mesh."""
    counts: wp.array[int]
    """Vertices of each mesh."""
    graph_starts: wp.array[int]
    """First number of each mesh in ``graph``; -1 without one."""
    vertices: wp.array[wp.vec3]
    """m, in the mesh's frame."""
    graph: wp.array[int]
    """Edges of the convex hulls, as MuJoCo stores them."""


@wp.struct
class Polytopes:
    """Buffers that a search writes, one set for each thread that runs at a time."""

    vertices: wp.array2d[wp.vec3]
    """(threads, vertices) points of the difference of both shapes."""
    indices: wp.array2d[int]
    """(threads, vertices) numbers that lead from each back to vertices of the shapes."""
    faces: wp.array2d[int]
    """(threads, faces) three vertices, packed into one number."""
    projections: wp.array2d[wp.vec3]
    """(threads, faces) point of the face nearest to the origin."""
    squares: wp.array2d[float]
    """(threads, faces) squared distance of that point."""
    horizon: wp.array2d[int]
    """(threads, edges) border of the faces that a new vertex sees."""


@wp.func
def shape_at(scene: Scene, meshes: Meshes, geom: int, env: int, axes: wp.mat33, margin: float) -> Geom:
    """A shape at the origin, as MuJoCo-Warp's support functions want it."""
    shape = Geom()
    shape.rot = axes
    shape.size = scene.sizes[env % scene.sizes.shape[0], geom]
    shape.margin = margin
    shape.index = -1
    if scene.types[geom] == _MESH:
        mesh = scene.data_ids[env % scene.data_ids.shape[0], geom]
        shape.vertadr = meshes.starts[mesh]
        shape.vertnum = meshes.counts[mesh]
        shape.graphadr = meshes.graph_starts[mesh]
        shape.vert = meshes.vertices
        shape.graph = meshes.graph
    return shape


@wp.kernel(module="unique", enable_backward=False)
def search_triangles(
    threads: int, tolerances: wp.array[float], iterations: int, scene: Scene, materials: Materials, meshes: Meshes,
    polytopes: Polytopes, near: Near, overflow: wp.array[int],
):  # fmt: skip
    """Find the deepest contact of each listed triangle's prism with its shape. Threads take every so many triangles."""
    thread = wp.tid()
    item = wp.int32(thread)
    total = wp.min(near.triangle_count[0], near.cells.shape[0])
    while item < total:
        pair, cell = near.pairs[item], near.cells[item]
        geoms, env = near.geoms[pair], near.envs[pair]
        index = scene.data_ids[env % scene.data_ids.shape[0], geoms[0]]
        margin, gap = contact_margin_gap(
            materials.margin, materials.gap, materials.pair_margin, materials.pair_gap, geoms, near.ids[pair][0], env
        )
        into = wp.transpose(scene.rotations[env, geoms[0]])
        center = into @ (scene.positions[env, geoms[1]] - scene.positions[env, geoms[0]])
        field = field_around(scene, index, center, wp.vec3())
        a, b, c = triangle(scene, field, cell // 2 // field.columns, (cell // 2) % field.columns, cell % 2)
        prism = mat63()
        prism[3] = a
        prism[4] = b
        prism[5] = c
        for i in range(3):
            prism[3 + i, 2] = prism[3 + i, 2] + margin
            prism[i] = prism[3 + i]
            prism[i, 2] = field.below - scene.field_sizes[index][3]
        ground = Geom()
        ground.rot = wp.identity(n=3, dtype=float)
        ground.index = -1
        ground.polyvert = prism
        middle = (prism[0] + prism[1] + prism[2] + prism[3] + prism[4] + prism[5]) / 6.0
        shape = shape_at(scene, meshes, geoms[1], env, into @ scene.rotations[env, geoms[1]], margin)
        distance, found, on_ground, on_shape, _ = ccd(
            tolerances[env % tolerances.shape[0]], 0.0, iterations, iterations, ground, shape, _FIELD,
            scene.types[geoms[1]], middle, shape.pos, polytopes.vertices[thread], polytopes.indices[thread],
            polytopes.faces[thread], polytopes.projections[thread], polytopes.squares[thread],
            polytopes.horizon[thread], False, env, overflow,
        )  # fmt: skip
        touches = found > 0 and distance < margin + gap
        near.distances[item] = wp.where(touches, distance, _FAR)
        near.points[item] = center + 0.5 * (on_ground + on_shape)
        near.normals[item] = wp.normalize(on_ground - on_shape)
        item += threads


@wp.kernel(module="unique", enable_backward=False)
def choose_contacts(scene: Scene, materials: Materials, contacts: Contacts, near: Near):
    """Keep four of each pair's contacts, as MuJoCo-Warp does: the deepest, and those that span most around it."""
    pair = wp.tid()
    if pair >= near.count[0]:
        return
    first, second, third = wp.int32(-1), wp.int32(-1), wp.int32(-1)
    for number in range(_MOST_OF_PAIR):
        chosen = wp.int32(-1)
        most = wp.float32(-_FAR)
        for item in range(near.starts[pair], near.ends[pair]):
            apart = wp.vec3i(item - first, item - second, item - third)
            if near.distances[item] >= _FAR or wp.min(wp.abs(apart)) == 0:
                continue
            worth = -near.distances[item]
            if number > 0:
                worth = span(near, number, item, first, second, third)
            if worth > most:
                most = worth
                chosen = item
        if chosen < 0 or (number > 0 and most > 0.0 and most < _CLOSE):
            return
        add_contact(
            scene, materials, contacts, near.geoms[pair], near.ids[pair], near.envs[pair], number,
            near.distances[chosen], near.points[chosen], near.normals[chosen],
        )  # fmt: skip
        if number == 0:
            first = chosen
        elif number == 1:
            second = chosen
        else:
            third = chosen


@wp.func
def span(near: Near, number: int, item: int, first: int, second: int, third: int) -> float:
    """Return a contact's distance from the chosen: from one, from the line of two, or from a triangle's sides."""
    away = near.points[item] - near.points[first]
    if number == 1:
        return wp.length(away)
    normal = near.normals[first]
    if number == 2:
        return wp.abs(wp.dot(away, wp.cross(normal, near.points[first] - near.points[second])))
    side = wp.cross(normal, near.points[first] - near.points[third])
    other = wp.cross(normal, near.points[second] - near.points[third])
    return wp.abs(wp.dot(away, side)) + wp.abs(wp.dot(near.points[second] - near.points[item], other))
