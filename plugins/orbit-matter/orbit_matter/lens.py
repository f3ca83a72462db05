"""Pinhole cameras as kernels take them."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAttributeAccessIssue=false, reportReturnType=false, reportGeneralTypeIssues=false

from __future__ import annotations

import math

import warp as wp

from orbit_core.scene import CameraSpec


@wp.struct
class Lens:
    """A pinhole camera in pixels."""

    focal: float
    """Focal length in pixels; pixels are square."""
    width: int
    """Columns of the picture."""
    height: int
    """Rows of the picture."""
    near: float
    """Metres of depth; triangles that come nearer are left out whole."""
    far: float
    """Metres of depth beyond which nothing is painted."""


def lens_of(camera: CameraSpec) -> Lens:
    """Return a camera's lens."""
    lens = Lens()
    lens.focal = 0.5 * camera.height / math.tan(0.5 * camera.vertical_fov)
    lens.width, lens.height, lens.near, lens.far = camera.width, camera.height, camera.near, camera.far
    return lens


@wp.func
def seen(poses: wp.array2d[float], env: int, p: wp.vec3) -> wp.vec3:
    """Return a point in the camera's frame, depth along +z and y down."""
    eye = wp.vec3(poses[env, 0], poses[env, 1], poses[env, 2])
    turn = wp.quat(poses[env, 4], poses[env, 5], poses[env, 6], poses[env, 3])
    local = wp.quat_rotate_inv(turn, p - eye)
    return wp.vec3(local[0], -local[1], -local[2])


@wp.func
def from_view(poses: wp.array2d[float], env: int, v: wp.vec3) -> wp.vec3:
    """Return a vector of the camera's frame, depth along +z and y down, in the environment's axes."""
    turn = wp.quat(poses[env, 4], poses[env, 5], poses[env, 6], poses[env, 3])
    return wp.quat_rotate(turn, wp.vec3(v[0], -v[1], -v[2]))


@wp.func
def pixel_of(lens: Lens, p: wp.vec3) -> wp.vec2:
    """Return coordinates in pixels of a point in the camera's frame."""
    scale = lens.focal / p[2]
    return wp.vec2(p[0] * scale + 0.5 * float(lens.width), p[1] * scale + 0.5 * float(lens.height))


@wp.func
def ray_of(lens: Lens, column: int, row: int) -> wp.vec3:
    """Return the way along a pixel's ray, in the camera's frame, for each metre of depth."""
    x = (float(column) + 0.5 - 0.5 * float(lens.width)) / lens.focal
    y = (float(row) + 0.5 - 0.5 * float(lens.height)) / lens.focal
    return wp.vec3(x, y, 1.0)
