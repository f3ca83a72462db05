"""Kinematics, mass matrix, extents and volumes of one description in double precision, to compare others with.

:mod:`orbit_core.dynamics` computes the same in batches for control. This module shares no code with it, nor with a
reader, so that a fault in either shows.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from orbit_assets.mass_properties import mass_properties
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Cylinder,
    Geometry,
    Joint,
    JointType,
    Mesh,
    MeshCollision,
    Shape,
    Sphere,
)

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Posture:
    """A description at one set of joint positions, its root at the origin.

    ``links`` and ``frames`` hold poses (4, 4) by name, in the root's frame. ``axes`` and ``origins`` (3,) are those of
    each movable joint, in the root's frame too.
    """

    links: Mapping[str, FloatArray]
    frames: Mapping[str, FloatArray]
    axes: Mapping[str, FloatArray]
    origins: Mapping[str, FloatArray]


def posture(articulation: Articulation, positions: Mapping[str, float]) -> Posture:
    """Compute the poses of links, frames and joint axes at joint positions.

    Followers are placed by ``positions``, not by their leaders. Links must be in topological order.

    Args:
        articulation: the description.
        positions: of movable joints by name (m, rad); zero where not named.
    """
    links = {articulation.root.name: np.eye(4)}
    axes: dict[str, FloatArray] = {}
    origins: dict[str, FloatArray] = {}
    for joint in articulation.joints:
        before = links[joint.parent] @ joint.parent_pose.matrix()
        links[joint.child] = before @ _motion(joint, positions.get(joint.name, 0.0)) @ _inverse(joint)
        if joint.movable:
            axes[joint.name] = before[:3, :3] @ np.asarray(joint.axis, dtype=float)
            origins[joint.name] = before[:3, 3]
    frames = {frame.name: links[frame.link] @ frame.pose.matrix() for frame in articulation.frames}
    return Posture(links, frames, axes, origins)


def mass_matrix(articulation: Articulation, at: Posture) -> FloatArray:
    """Return the mass matrix (J, J) of the movable joints, in their order, the root held and followers free; with
    armature.

    The sum over links of ``m Jv^T Jv + Jw^T R I R^T Jw`` (Siciliano et al., Robotics, 2009, eq. 7.32).
    """
    joints = articulation.movable_joints
    above = _ancestors(articulation)
    matrix = np.diag([float(joint.armature) for joint in joints])
    for link in articulation.links:
        pose = at.links[link.name]
        center = pose[:3, :3] @ np.asarray(link.center_of_mass) + pose[:3, 3]
        linear, angular = np.zeros((3, len(joints))), np.zeros((3, len(joints)))
        for index, joint in enumerate(joints):
            # Joints that are not between the link and the root do not move it: their columns stay zero.
            if joint.name not in above[link.name]:
                continue
            axis = at.axes[joint.name]
            if joint.type is JointType.PRISMATIC:
                linear[:, index] = axis
            else:
                linear[:, index] = np.cross(axis, center - at.origins[joint.name])
                angular[:, index] = axis
        turned = pose[:3, :3] @ link.inertia @ pose[:3, :3].T
        matrix += link.mass * linear.T @ linear + angular.T @ turned @ angular
    return matrix


def _ancestors(articulation: Articulation) -> dict[str, frozenset[str]]:
    """Return for each link the names of the movable joints between it and the root."""
    found = {articulation.root.name: frozenset[str]()}
    for joint in articulation.joints:
        own = frozenset([joint.name]) if joint.movable else frozenset[str]()
        found[joint.child] = found[joint.parent] | own
    return found


def _motion(joint: Joint, position: float) -> FloatArray:
    """Return the motion (4, 4) of the joint at a position: a shift along its axis, or Rodrigues' rotation about it."""
    result = np.eye(4)
    axis = np.asarray(joint.axis, dtype=float)
    if joint.type is JointType.PRISMATIC:
        result[:3, 3] = position * axis
    elif joint.movable:
        x, y, z = axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        result[:3, :3] += np.sin(position) * cross + (1.0 - np.cos(position)) * cross @ cross
    return result


def _inverse(joint: Joint) -> FloatArray:
    return joint.child_pose.inverse().matrix()


# Enough points that the hull of a sphere is within 3 % of its radius, and few enough for quick hulls.
_ON_SPHERE, _ON_CIRCLE = 96, 24


def shape_points(shape: Shape) -> FloatArray:
    """Return points (P, 3) in the link's frame whose hull is the shape's, round ones sampled; none of ground and
    terrain.
    """
    return shape.pose.transform(_points(shape.geometry))


def bounds(shapes: Iterable[Shape]) -> FloatArray | None:
    """Return the least and the greatest corner (2, 3) of all shapes in the link's frame; ``None`` where nothing has
    extent.
    """
    clouds = [cloud for shape in shapes if len(cloud := shape_points(shape))]
    if not clouds:
        return None
    points = np.concatenate(clouds)
    return np.stack([points.min(0), points.max(0)])


def colliding_volume(shape: Shape) -> float:
    """Return the volume (m^3) that collides: of a mesh's hull if it collides as that; sheets and terrain have none."""
    from scipy.spatial import QhullError
    from trimesh.convex import convex_hull

    geometry = shape.geometry
    try:
        if isinstance(geometry, Mesh) and geometry.collision is MeshCollision.CONVEX_HULL:
            return float(convex_hull(np.asarray(geometry.vertices, dtype=np.float64)).volume)
        return mass_properties(geometry, density=1.0).mass
    except (AssetError, QhullError):
        return 0.0


def _points(geometry: Geometry) -> FloatArray:
    match geometry:
        case Box(half_extents=half):
            return np.array(np.meshgrid(*([-1.0, 1.0],) * 3)).reshape(3, -1).T * half
        case Sphere(radius=radius):
            return radius * _SPHERE
        case Capsule(radius=radius, half_length=half):
            return np.concatenate([radius * _SPHERE + (0.0, 0.0, side * half) for side in (-1.0, 1.0)])
        case Cylinder(radius=radius, half_length=half):
            return np.concatenate([_CIRCLE * (radius, radius, side * half) for side in (-1.0, 1.0)])
        case Mesh(vertices=vertices):
            return np.asarray(vertices, dtype=np.float64)
        case _:
            return np.zeros((0, 3))


def _sphere() -> FloatArray:
    """Return points spread evenly on the unit sphere (a Fibonacci lattice), and those on its axes."""
    index = np.arange(_ON_SPHERE) + 0.5
    polar, azimuth = np.arccos(1 - 2 * index / _ON_SPHERE), np.pi * (1 + 5**0.5) * index
    spread = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)
    return np.concatenate([spread, np.eye(3), -np.eye(3)])


def _circle() -> FloatArray:
    angle = np.linspace(0.0, 2.0 * np.pi, _ON_CIRCLE, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=1)


_SPHERE, _CIRCLE = _sphere(), _circle()
