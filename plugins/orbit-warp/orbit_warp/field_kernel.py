"""Contacts of shapes with height fields: of spheres in closed form, and triangles near other shapes.

MuJoCo takes a height field's triangle for the top of a prism that goes down to the field's base, and looks for
contacts of a shape with each prism under it by a general search. A sphere's are found here in closed form; other shapes
are left to that search (``field_search``) with those triangles alone that the shape's box reaches below.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp
from mujoco import mjtGeom
from mujoco_warp._src.collision_core import contact_margin_gap, contact_material_params, write_contact
from mujoco_warp._src.math import make_frame
from mujoco_warp._src.types import OverflowType, vec5

_SPHERE = wp.constant(int(mjtGeom.mjGEOM_SPHERE))
_MESH = wp.constant(int(mjtGeom.mjGEOM_MESH))
_FULL = wp.constant(int(OverflowType.BROADPHASE))
# Distances (m) that differ by less are the same: rounding on a field of 100 m leaves a few of these.
_SAME = wp.constant(1e-6)


@wp.struct
class Scene:
    """Shapes and height fields of a MuJoCo model and its state."""

    types: wp.array[int]
    """(geoms,) kind of geom."""
    data_ids: wp.array2d[int]
    """(K, geoms) number of the mesh or height field."""
    sizes: wp.array2d[wp.vec3]
    """(K, geoms) m."""
    boxes: wp.array3d[wp.vec3]
    """(K, geoms, 2) middle and half extents of the bounding box, in the geom's frame."""
    positions: wp.array2d[wp.vec3]
    """(N, geoms) m in the world."""
    rotations: wp.array2d[wp.mat33]
    """(N, geoms) in the world."""
    field_sizes: wp.array[wp.vec4]
    """(fields,) half extents along x and y, height and depth of the base, m."""
    field_rows: wp.array[int]
    """(fields,) points along y."""
    field_columns: wp.array[int]
    """(fields,) points along x."""
    field_starts: wp.array[int]
    """(fields,) first number in ``heights``."""
    heights: wp.array[float]
    """Heights of all fields in [0, 1], row by row."""


@wp.struct
class Materials:
    """Contact parameters of a MuJoCo model."""

    condim: wp.array[int]
    """(geoms,) dimension of contacts."""
    priority: wp.array[int]
    """(geoms,) higher one decides for the pair."""
    solmix: wp.array2d[float]
    """(K, geoms) weight in the mix of a pair."""
    solref: wp.array2d[wp.vec2]
    """(K, geoms) time constant and damping ratio, or minus stiffness and damping."""
    solimp: wp.array2d[vec5]
    """(K, geoms) impedance."""
    friction: wp.array2d[wp.vec3]
    """(K, geoms) sliding, torsional and rolling."""
    margin: wp.array2d[float]
    """(K, geoms) m of distance from which contacts are made."""
    gap: wp.array2d[float]
    """(K, geoms) m of that within which they do nothing."""
    adhesion: wp.array2d[float]
    """(K, geoms) N of pull."""
    pair_dim: wp.array[int]
    """(pairs,) dimension of contacts of an explicit pair."""
    pair_solref: wp.array2d[wp.vec2]
    """(K, pairs) as ``solref``."""
    pair_solreffriction: wp.array2d[wp.vec2]
    """(K, pairs) the same for friction."""
    pair_solimp: wp.array2d[vec5]
    """(K, pairs) as ``solimp``."""
    pair_margin: wp.array2d[float]
    """(K, pairs) m."""
    pair_gap: wp.array2d[float]
    """(K, pairs) m."""
    pair_adhesion: wp.array2d[float]
    """(K, pairs) N."""
    pair_friction: wp.array2d[vec5]
    """(K, pairs) two of sliding, one of torsional, two of rolling friction."""


@wp.struct
class Contacts:
    """MuJoCo-Warp's contacts of all environments, and how many there are."""

    most: int
    """Contacts that there is room for."""
    dist: wp.array[float]
    """m between the surfaces, negative inside."""
    pos: wp.array[wp.vec3]
    """m, point in the world."""
    frame: wp.array[wp.mat33]
    """Rows: normal and two tangents."""
    includemargin: wp.array[float]
    """m of distance from which the contact acts."""
    friction: wp.array[vec5]
    """Two of sliding, one of torsional, two of rolling friction."""
    solref: wp.array[wp.vec2]
    """Reference of the normal."""
    solreffriction: wp.array[wp.vec2]
    """Reference of friction."""
    solimp: wp.array[vec5]
    """Impedance."""
    dim: wp.array[int]
    """Dimension of the contact."""
    geom: wp.array[wp.vec2i]
    """Both geoms."""
    efc_address: wp.array2d[int]
    """Rows of the constraints."""
    worldid: wp.array[int]
    """Environment."""
    type: wp.array[int]
    """Flags of MuJoCo-Warp's, such as that of a constraint."""
    geomcollisionid: wp.array[int]
    """Number of the contact within its pair."""
    adhesion: wp.array[float]
    """N of pull."""
    count: wp.array[int]
    """Contacts so far, in one number."""


@wp.struct
class Pairs:
    """Pairs of a field and a shape: their geoms, and MuJoCo-Warp's numbers of explicit pairs."""

    geoms: wp.array[wp.vec2i]
    """Field and shape of each pair."""
    ids: wp.array[wp.vec2i]
    """Numbers of explicit pairs; -1 for none."""


@wp.struct
class Near:
    """Pairs whose shapes are near triangles of the field, in any environment; each has some of these in a row."""

    geoms: wp.array[wp.vec2i]
    """Field and shape of each pair."""
    ids: wp.array[wp.vec2i]
    """Numbers of explicit pairs; -1 for none."""
    envs: wp.array[int]
    """Environment of each pair."""
    starts: wp.array[int]
    """First triangle of each pair."""
    ends: wp.array[int]
    """One past the last triangle."""
    count: wp.array[int]
    """Pairs so far, in one number."""
    pairs: wp.array[int]
    """Of each triangle: whose it is."""
    cells: wp.array[int]
    """Of each triangle: twice the cell's number, and which half of it."""
    triangle_count: wp.array[int]
    """Triangles so far, in one number."""
    distances: wp.array[float]
    """Of each triangle, once searched: the distance to the shape, negative inside, or 1e10 where they do not touch."""
    points: wp.array[wp.vec3]
    """m, nearest point of each triangle."""
    normals: wp.array[wp.vec3]
    """From the field to the shape, in the field's frame, as the points."""


@wp.struct
class Field:
    """A height field as seen from a shape in its frame, and the cells that the shape's box covers."""

    start: int
    """First number of the field in ``heights``."""
    columns: int
    """Points along x."""
    left: float
    """m from the middle of the box to the least x."""
    front: float
    """m from there to the least y."""
    below: float
    """m from there to a height of 0."""
    width: float
    """m of a cell along x."""
    depth: float
    """m of a cell along y."""
    scale: float
    """m of a height of 1."""
    first_row: int
    """First row of the cells that the box covers."""
    end_row: int
    """One past the last row."""
    first_column: int
    """First column of these cells."""
    end_column: int
    """One past the last column."""


@wp.func
def field_around(scene: Scene, index: int, center: wp.vec3, reach: wp.vec3) -> Field:
    """Heights are z of the field's frame, all other lengths are relative to the center of the shape."""
    size, rows, columns = scene.field_sizes[index], scene.field_rows[index], scene.field_columns[index]
    field = Field()
    field.start = scene.field_starts[index]
    field.columns = columns
    field.scale = size[2]
    field.width = 2.0 * size[0] / float(columns - 1)
    field.depth = 2.0 * size[1] / float(rows - 1)
    field.left = -size[0] - center[0]
    field.front = -size[1] - center[1]
    field.below = -center[2]
    field.first_column = wp.max(0, int(wp.floor((-field.left - reach[0]) / field.width)))
    field.end_column = wp.min(columns - 1, int(wp.ceil((-field.left + reach[0]) / field.width)))
    field.first_row = wp.max(0, int(wp.floor((-field.front - reach[1]) / field.depth)))
    field.end_row = wp.min(rows - 1, int(wp.ceil((-field.front + reach[1]) / field.depth)))
    return field


@wp.func
def corner(scene: Scene, field: Field, row: int, column: int) -> wp.vec3:
    height = scene.heights[field.start + row * field.columns + column] * field.scale
    return wp.vec3(
        field.left + field.width * float(column), field.front + field.depth * float(row), field.below + height
    )


@wp.func
def triangle(scene: Scene, field: Field, row: int, column: int, half: int):
    """The corners of one of a cell's two triangles, counterclockwise from above; they share the diagonal."""
    a, c = corner(scene, field, row, column), corner(scene, field, row + 1, column + 1)
    if half == 0:
        return a, c, corner(scene, field, row + 1, column)
    return a, corner(scene, field, row, column + 1), c


@wp.func
def highest(scene: Scene, field: Field, row: int, column: int) -> float:
    """The z of a cell's highest corner, from the center of the shape."""
    first = field.start + row * field.columns + column
    near = wp.max(scene.heights[first], scene.heights[first + 1])
    first += field.columns
    return field.below + field.scale * wp.max(near, wp.max(scene.heights[first], scene.heights[first + 1]))


@wp.func
def nearest_on_triangle(a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """The point nearest to the origin, and whether it is inside, not on the rim (Ericson 2005, section 5.1.5)."""
    ab, ac = b - a, c - a
    d1, d2 = -wp.dot(ab, a), -wp.dot(ac, a)
    if d1 <= 0.0 and d2 <= 0.0:
        return a, False
    d3, d4 = -wp.dot(ab, b), -wp.dot(ac, b)
    if d3 >= 0.0 and d4 <= d3:
        return b, False
    if d1 * d4 - d3 * d2 <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return a + ab * (d1 / (d1 - d3)), False
    d5, d6 = -wp.dot(ab, c), -wp.dot(ac, c)
    if d6 >= 0.0 and d5 <= d6:
        return c, False
    if d5 * d2 - d1 * d6 <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return a + ac * (d2 / (d2 - d6)), False
    if d3 * d6 - d5 * d4 <= 0.0 and d4 >= d3 and d5 >= d6:
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6))), False
    normal = wp.cross(ab, ac)
    return normal * (wp.dot(a, normal) / wp.dot(normal, normal)), True


@wp.func
def is_below(scene: Scene, field: Field) -> bool:
    """Return True if the shape's center is below the surface."""
    row = wp.clamp(int(wp.floor(-field.front / field.depth)), field.first_row, field.end_row - 1)
    column = wp.clamp(int(wp.floor(-field.left / field.width)), field.first_column, field.end_column - 1)
    here = corner(scene, field, row, column)
    half = wp.where(-here[1] / field.depth > -here[0] / field.width, 0, 1)
    a, b, c = triangle(scene, field, row, column, half)
    return wp.dot(wp.cross(b - a, c - a), a) > 0.0


@wp.func
def is_reported(scene: Scene, field: Field, row: int, column: int, half: int, point: wp.vec3) -> bool:
    """Return True unless a triangle that shares this rim point is nearer, or is equal and reported before."""
    here = wp.length(point)
    for other_row in range(field.first_row, field.end_row):
        for other_column in range(field.first_column, field.end_column):
            for other_half in range(2):
                a, b, c = triangle(scene, field, other_row, other_column, other_half)
                gap, inside = nearest_on_triangle(a - point, b - point, c - point)
                itself = other_row == row and other_column == column and other_half == half
                if itself or wp.length(gap) > _SAME:
                    continue
                there, inside = nearest_on_triangle(a, b, c)
                if wp.length(there) < here - _SAME:
                    return False
                turned_away = wp.dot(wp.cross(b - a, c - a), a) > 0.0
                before = other_row < row or (other_row == row and other_column < column)
                before = before or (other_row == row and other_column == column and other_half < half)
                if (inside or before) and not (inside and turned_away):
                    return False
    return True


@wp.func
def add_contact(
    scene: Scene, materials: Materials, contacts: Contacts, geoms: wp.vec2i, ids: wp.vec2i, env: int, number: int,
    distance: float, point: wp.vec3, normal: wp.vec3,
):  # fmt: skip
    """Write a contact, given in the frame of the field: the point half way between the surfaces."""
    margin, gap = contact_margin_gap(
        materials.margin, materials.gap, materials.pair_margin, materials.pair_gap, geoms, ids[0], env
    )
    condim, friction, solref, solreffriction, solimp, adhesion = contact_material_params(
        materials.condim, materials.priority, materials.solmix, materials.solref, materials.solimp, materials.friction,
        materials.adhesion, materials.pair_dim, materials.pair_solref, materials.pair_solreffriction,
        materials.pair_solimp, materials.pair_adhesion, materials.pair_friction, geoms, ids[0], env,
    )  # fmt: skip
    rotation = scene.rotations[env, geoms[0]]
    position = scene.positions[env, geoms[0]] + rotation @ point
    write_contact(
        contacts.most, number, distance, position, make_frame(rotation @ normal), margin, gap, condim, friction, solref,
        solreffriction, solimp, adhesion, geoms, ids, env, contacts.dist, contacts.pos, contacts.frame,
        contacts.includemargin, contacts.friction, contacts.solref, contacts.solreffriction, contacts.solimp,
        contacts.dim, contacts.geom, contacts.efc_address, contacts.worldid, contacts.type, contacts.geomcollisionid,
        contacts.adhesion, contacts.count,
    )  # fmt: skip


@wp.func
def meet_sphere(
    scene: Scene, materials: Materials, contacts: Contacts, geoms: wp.vec2i, ids: wp.vec2i, env: int,
    field: Field, center: wp.vec3, radius: float, bound: float,
):  # fmt: skip
    """Contacts at the points where the distance from the center has a local minimum; the nearest from below."""
    below = is_below(scene, field)
    number = wp.int32(0)
    least = wp.float32(1e10)
    nearest = wp.vec3()
    outward = wp.vec3()
    for row in range(field.first_row, field.end_row):
        for column in range(field.first_column, field.end_column):
            if not below and highest(scene, field, row, column) < -bound:
                continue
            for half in range(2):
                a, b, c = triangle(scene, field, row, column, half)
                point, inside = nearest_on_triangle(a, b, c)
                distance = wp.length(point)
                normal = wp.cross(b - a, c - a)
                if below:
                    if distance < least:
                        least = distance
                        nearest = point
                        outward = normal
                    continue
                if distance >= bound or (inside and wp.dot(normal, a) > 0.0):
                    continue
                if not inside and not is_reported(scene, field, row, column, half, point):
                    continue
                direction = wp.normalize(wp.where(distance > _SAME, -point, normal))
                middle = center + point + 0.5 * (distance - radius) * direction
                add_contact(scene, materials, contacts, geoms, ids, env, number, distance - radius, middle, direction)
                number += 1
    if below:
        direction = wp.normalize(wp.where(least > _SAME, nearest, outward))
        middle = center + nearest - 0.5 * (least + radius) * direction
        add_contact(scene, materials, contacts, geoms, ids, env, 0, -least - radius, middle, direction)


@wp.func
def near_triangles(
    scene: Scene, field: Field, axes: wp.mat33, half_size: wp.vec3, lowest: float, bound: float, near: Near, pair: int,
    start: int,
) -> int:  # fmt: skip
    """Count the triangles whose planes a box reaches below; list them from ``start`` unless that is negative.

    ``lowest`` is the z of the box's lowest point from its center.
    """
    count = wp.int32(0)
    for row in range(field.first_row, field.end_row):
        for column in range(field.first_column, field.end_column):
            if highest(scene, field, row, column) < lowest - bound:
                continue
            for half in range(2):
                a, b, c = triangle(scene, field, row, column, half)
                normal = wp.normalize(wp.cross(b - a, c - a))
                across = wp.transpose(axes) @ normal
                if -wp.dot(normal, a) > wp.dot(wp.abs(across), half_size) + bound:
                    continue
                if start >= 0:
                    near.pairs[start + count] = pair
                    near.cells[start + count] = 2 * (row * field.columns + column) + half
                count += 1
    return count


@wp.kernel(module="unique", enable_backward=False)
def meet_fields(scene: Scene, materials: Materials, pairs: Pairs, contacts: Contacts, near: Near, full: wp.array[int]):
    """Each thread takes a pair in an environment: adds a sphere's contacts, or lists triangles that are near."""
    pair, env = wp.tid()
    geoms, ids = pairs.geoms[pair], pairs.ids[pair]
    kind = scene.types[geoms[1]]
    kinds = scene.data_ids.shape[0]
    index = scene.data_ids[env % kinds, geoms[0]]
    if kind == _MESH and scene.data_ids[env % kinds, geoms[1]] < 0:
        return  # no such shape in this environment
    margin, gap = contact_margin_gap(
        materials.margin, materials.gap, materials.pair_margin, materials.pair_gap, geoms, ids[0], env
    )
    into = wp.transpose(scene.rotations[env, geoms[0]])
    center = into @ (scene.positions[env, geoms[1]] - scene.positions[env, geoms[0]])
    axes = into @ scene.rotations[env, geoms[1]]
    radius = scene.sizes[env % scene.sizes.shape[0], geoms[1]][0]
    half_size = wp.vec3(radius, radius, radius)
    if kind == _SPHERE:
        axes = wp.identity(n=3, dtype=float)
    else:
        half_size = scene.boxes[env % scene.boxes.shape[0], geoms[1], 1]
        center += axes @ scene.boxes[env % scene.boxes.shape[0], geoms[1], 0]
    bound = wp.max(margin + gap, 0.0)
    reach = wp.vec3(bound, bound, bound)
    for i in range(3):
        reach[i] += wp.dot(wp.abs(axes[i]), half_size)
    size = scene.field_sizes[index]
    beside = wp.abs(center[0]) > size[0] + reach[0] or wp.abs(center[1]) > size[1] + reach[1]
    if beside or center[2] - reach[2] > size[2] or center[2] + reach[2] < -size[3]:
        return
    field = field_around(scene, index, center, reach)
    if kind == _SPHERE and wp.abs(center[0]) < size[0] and wp.abs(center[1]) < size[1] and center[2] > -size[3]:
        meet_sphere(scene, materials, contacts, geoms, ids, env, field, center, radius, radius + bound)
        return
    bound += _SAME
    count = near_triangles(scene, field, axes, half_size, -reach[2], bound, near, 0, -1)
    if count == 0:
        return
    start = wp.atomic_add(near.triangle_count, 0, count)
    if start + count > near.cells.shape[0]:
        wp.atomic_or(full, env, _FULL)
        return
    slot = wp.atomic_add(near.count, 0, 1)
    near.geoms[slot] = geoms
    near.ids[slot] = ids
    near.envs[slot] = env
    near.starts[slot] = start
    near.ends[slot] = start + near_triangles(scene, field, axes, half_size, -reach[2], bound, near, slot, start)
