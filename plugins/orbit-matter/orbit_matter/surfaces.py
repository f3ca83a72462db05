"""Signed distance to the surface of each kind of collision shape, in the shape's own frame."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false
# ruff: noqa: UP018 - float() and int() make variables that a kernel's loops may change.
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

BOX = wp.constant(0)
SPHERE = wp.constant(1)
CAPSULE = wp.constant(2)
CYLINDER = wp.constant(3)
PLANE = wp.constant(4)
HEIGHT_FIELD = wp.constant(5)
MESH = wp.constant(6)


@wp.struct
class Shapes:
    """S collision shapes of each kind of environment; those of kind k are in row k."""

    kind: wp.array2d[int]
    """(K, S) BOX, SPHERE, CAPSULE, CYLINDER, PLANE, HEIGHT_FIELD or MESH."""
    link: wp.array2d[int]
    """Index of the link; L, of a link that stands still at the origin, for the terrain."""
    pose: wp.array2d[wp.transform]
    """In the link's frame."""
    size: wp.array2d[wp.vec3]
    """Half extents; radius and half length; full extents of a height field; of a mesh, those of a box around its origin
    that holds it."""
    reach: wp.array2d[float]
    """Radius of a ball around the shape's origin that holds it."""
    still: wp.array2d[float]
    """m/s of another surface along it from which on that rubs with all of its friction, and in proportion below."""
    mesh: wp.array2d[wp.uint64]
    """(K, S) Warp's number of a mesh; 0 for other shapes."""
    heights: wp.array[float]
    """Of all height fields, row by row."""
    rows: wp.array2d[wp.vec3i]
    """Of a height field: offset in ``heights``, rows, columns."""


@wp.func
def _box(p: wp.vec3, half: wp.vec3) -> wp.vec4:
    q = wp.vec3(wp.abs(p[0]) - half[0], wp.abs(p[1]) - half[1], wp.abs(p[2]) - half[2])
    side = wp.vec3(wp.sign(p[0]), wp.sign(p[1]), wp.sign(p[2]))
    out = wp.vec3(wp.max(q[0], 0.0), wp.max(q[1], 0.0), wp.max(q[2], 0.0))
    away = wp.length(out)
    if away > 0.0:
        n = wp.cw_mul(out, side) / away
        return wp.vec4(n[0], n[1], n[2], away)
    if q[0] >= q[1] and q[0] >= q[2]:
        return wp.vec4(side[0], 0.0, 0.0, q[0])
    if q[1] >= q[2]:
        return wp.vec4(0.0, side[1], 0.0, q[1])
    return wp.vec4(0.0, 0.0, side[2], q[2])


@wp.func
def _from_point(p: wp.vec3, center: wp.vec3, radius: float) -> wp.vec4:
    arm = p - center
    away = wp.length(arm)
    n = wp.vec3(0.0, 0.0, 1.0)
    if away > 1.0e-9:
        n = arm / away
    return wp.vec4(n[0], n[1], n[2], away - radius)


@wp.func
def _cylinder(p: wp.vec3, radius: float, half: float) -> wp.vec4:
    across = wp.sqrt(p[0] * p[0] + p[1] * p[1])
    ex, ey = float(1.0), float(0.0)
    if across > 1.0e-9:
        ex = p[0] / across
        ey = p[1] / across
    # In the half-plane through its axis a cylinder is a rectangle; the endless third side is never the nearest.
    flat = _box(wp.vec3(across, 0.0, p[2]), wp.vec3(radius, 1.0e6, half))
    return wp.vec4(flat[0] * ex, flat[0] * ey, flat[2], flat[3])


@wp.func
def _height_field(p: wp.vec3, size: wp.vec3, grid: wp.vec3i, heights: wp.array[float]) -> wp.vec4:
    rows, columns = grid[1], grid[2]
    u = (p[0] / size[0] + 0.5) * float(columns - 1)
    v = (p[1] / size[1] + 0.5) * float(rows - 1)
    if u < 0.0 or v < 0.0 or u > float(columns - 1) or v > float(rows - 1):
        return wp.vec4(0.0, 0.0, 1.0, 1.0e6)
    i, j = wp.min(int(u), columns - 2), wp.min(int(v), rows - 2)
    fu, fv = u - float(i), v - float(j)
    start = grid[0] + j * columns + i
    h00, h10 = heights[start], heights[start + 1]
    h01, h11 = heights[start + columns], heights[start + columns + 1]
    # Each cell is two triangles along its diagonal, as the engines have it.
    du, dv = h10 - h00, h11 - h10
    if fv > fu:
        du, dv = h11 - h01, h01 - h00
    height = h00 + fu * du + fv * dv
    slope = wp.vec3(-du * float(columns - 1) / size[0], -dv * float(rows - 1) / size[1], 1.0)
    n = wp.normalize(slope)
    return wp.vec4(n[0], n[1], n[2], (p[2] - height) * n[2])


@wp.func
def mesh_distance(p: wp.vec3, mesh: wp.uint64, farthest: float) -> wp.vec4:
    """Outward normal and signed distance of a point from a mesh; 1e6 beyond ``farthest``."""
    query = wp.mesh_query_point_sign_normal(mesh, p, farthest)
    if not query.result:
        return wp.vec4(0.0, 0.0, 1.0, 1.0e6)
    near = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
    arm = p - near
    away = wp.length(arm)
    n, sign = wp.mesh_eval_face_normal(mesh, query.face), float(query.sign)
    if away > 1.0e-7:
        if sign < 0.0:
            # On the axis of a cup all sides are as near, and their normals cancel out: close to one they do not.
            again = wp.mesh_query_point_sign_normal(mesh, near + arm * 0.1, away)
            if again.result:
                sign = again.sign
        n = sign * arm / away
    return wp.vec4(n[0], n[1], n[2], sign * away)


@wp.func
def distance(shapes: Shapes, kind: int, shape: int, p: wp.vec3, farthest: float) -> wp.vec4:
    """Outward normal and signed distance of a point, in the shape's frame; of meshes none beyond ``farthest``."""
    form = shapes.kind[kind, shape]
    size = shapes.size[kind, shape]
    if form == BOX:
        return _box(p, size)
    if form == SPHERE:
        return _from_point(p, wp.vec3(), size[0])
    if form == CAPSULE:
        return _from_point(p, wp.vec3(0.0, 0.0, wp.clamp(p[2], -size[1], size[1])), size[0])
    if form == CYLINDER:
        return _cylinder(p, size[0], size[1])
    if form == PLANE:
        return wp.vec4(0.0, 0.0, 1.0, p[2])
    if form == HEIGHT_FIELD:
        return _height_field(p, size, shapes.rows[kind, shape], shapes.heights)
    return mesh_distance(p, shapes.mesh[kind, shape], farthest)
