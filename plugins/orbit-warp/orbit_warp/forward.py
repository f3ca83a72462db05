"""Poses and velocities of links from positions and velocities of joints, in one launch.

MuJoCo-Warp's own kinematics take a score of launches, for they prepare a physics step: centres of mass, inertias,
geoms. What tasks read after a step, and again after resets, are links alone.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from mujoco import mjtJoint
from torch import Tensor

from orbit_mjmodel.addresses import Addresses
from orbit_warp.kernels import rotate

if TYPE_CHECKING:
    from orbit_warp.engine import Native

_FREE = wp.constant(int(mjtJoint.mjJNT_FREE))
_BALL = wp.constant(int(mjtJoint.mjJNT_BALL))
_SLIDE = wp.constant(int(mjtJoint.mjJNT_SLIDE))


@wp.struct
class Tree:
    """The bodies' part of a MuJoCo model; parents come before their children."""

    parents: wp.array[int]
    mocaps: wp.array[int]
    joint_counts: wp.array[int]
    first_joints: wp.array[int]
    links: wp.array[int]
    """The link that a body is, -1 for none."""
    positions: wp.array2d[wp.vec3]
    orientations: wp.array2d[wp.quat]
    types: wp.array[int]
    position_addresses: wp.array[int]
    velocity_addresses: wp.array[int]
    anchors: wp.array2d[wp.vec3]
    axes: wp.array2d[wp.vec3]
    zeros: wp.array2d[float]


@wp.func
def multiply(a: wp.quat, b: wp.quat) -> wp.quat:
    """Of quaternions (w, x, y, z)."""
    u, v = wp.vec3(a[1], a[2], a[3]), wp.vec3(b[1], b[2], b[3])
    w = a[0] * b[0] - wp.dot(u, v)
    x = a[0] * v + b[0] * u + wp.cross(u, v)
    return wp.quat(w, x[0], x[1], x[2])


@wp.func
def quaternion_at(row: wp.array[float], start: int) -> wp.quat:
    return wp.normalize(wp.quat(row[start], row[start + 1], row[start + 2], row[start + 3]))


@wp.func
def vector_at(row: wp.array[float], start: int) -> wp.vec3:
    return wp.vec3(row[start], row[start + 1], row[start + 2])


@wp.kernel(enable_backward=False)
def derive_links(
    tree: Tree,
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    mocap_pos: wp.array2d[wp.vec3],
    mocap_quat: wp.array2d[wp.quat],
    body_positions: wp.array2d[wp.vec3],
    body_orientations: wp.array2d[wp.quat],
    body_velocities: wp.array2d[wp.spatial_vector],
    poses: wp.array3d[float],
    velocities: wp.array3d[float],
):
    """A thread an environment; bodies' own arrays have the environment as their last index, so that threads read side
    by side. Velocities are of the bodies' origins: linear, then angular.
    """
    env = wp.tid()
    q, qd = qpos[env], qvel[env]
    for body in range(1, tree.parents.shape[0]):
        parent = tree.parents[body]
        turn = body_orientations[parent, env]
        base = 1.0 * body_positions[parent, env]  # a value, where the array's element would stay one
        twist = body_velocities[parent, env]
        linear, spin = wp.spatial_top(twist), wp.spatial_bottom(twist)  # at the parent's origin until all joints are in
        position = base + rotate(turn, tree.positions[env % tree.positions.shape[0], body])
        orientation = multiply(turn, tree.orientations[env % tree.orientations.shape[0], body])
        mocap = tree.mocaps[body]
        if mocap >= 0:
            position = 1.0 * mocap_pos[env, mocap]
            orientation = wp.normalize(mocap_quat[env, mocap])
        for joint in range(tree.first_joints[body], tree.first_joints[body] + tree.joint_counts[body]):
            p, v = tree.position_addresses[joint], tree.velocity_addresses[joint]
            if tree.types[joint] == _FREE:
                position = vector_at(q, p)
                orientation = quaternion_at(q, p + 3)
                spin = rotate(orientation, vector_at(qd, v + 3))
                base = 1.0 * position
                linear = vector_at(qd, v)
                continue
            local_anchor = tree.anchors[env % tree.anchors.shape[0], joint]
            local_axis = tree.axes[env % tree.axes.shape[0], joint]
            axis = rotate(orientation, local_axis)
            anchor = position + rotate(orientation, local_anchor)
            if tree.types[joint] == _SLIDE:
                position += axis * (q[p] - tree.zeros[env % tree.zeros.shape[0], p])
                linear += axis * qd[v]
                continue
            if tree.types[joint] == _BALL:
                orientation = multiply(orientation, quaternion_at(q, p))
                turning = rotate(orientation, vector_at(qd, v))
            else:
                half = 0.5 * (q[p] - tree.zeros[env % tree.zeros.shape[0], p])
                s = wp.sin(half)
                turned = wp.quat(wp.cos(half), s * local_axis[0], s * local_axis[1], s * local_axis[2])
                orientation = multiply(orientation, turned)
                turning = axis * qd[v]
            position = anchor - rotate(orientation, local_anchor)
            spin += turning
            linear += wp.cross(turning, base - anchor)
        orientation = wp.normalize(orientation)
        linear += wp.cross(spin, position - base)
        body_positions[body, env] = position
        body_orientations[body, env] = orientation
        body_velocities[body, env] = wp.spatial_vector(linear, spin)
        link = tree.links[body]
        if link >= 0:
            sign = wp.where(orientation[0] < 0.0, -1.0, 1.0)
            for i in range(3):
                poses[env, link, i] = position[i]
                velocities[env, link, i] = linear[i]
                velocities[env, link, 3 + i] = spin[i]
            for i in range(4):
                poses[env, link, 3 + i] = sign * orientation[i]


class ForwardKinematics:
    """Writes poses (N, links, 7) and velocities (N, links, 6) of an engine's links."""

    def __init__(self, addresses: Addresses, native: Native, poses: Tensor, velocities: Tensor) -> None:
        model, data = native.model, native.data
        self._data, self._tree = data, Tree()
        bodies = native.host_model.nbody
        links = np.full(bodies, -1, dtype=np.int32)
        links[list(addresses.bodies)] = np.arange(len(addresses.bodies))
        tree = self._tree
        tree.parents, tree.mocaps = model.body_parentid, model.body_mocapid
        tree.joint_counts, tree.first_joints = model.body_jntnum, model.body_jntadr
        tree.links = wp.array(links, dtype=int)
        tree.positions, tree.orientations = model.body_pos, model.body_quat
        tree.types, tree.zeros = model.jnt_type, model.qpos0
        tree.position_addresses, tree.velocity_addresses = model.jnt_qposadr, model.jnt_dofadr
        tree.anchors, tree.axes = model.jnt_pos, model.jnt_axis
        shape = (bodies, data.nworld)
        self._positions = wp.zeros(shape, dtype=wp.vec3)
        self._orientations = wp.full(shape, wp.quat(1.0, 0.0, 0.0, 0.0), dtype=wp.quat)
        self._velocities = wp.zeros(shape, dtype=wp.spatial_vector)
        self._outputs = (wp.from_torch(poses), wp.from_torch(velocities))

    def launch(self) -> None:
        """For the present state of all environments."""
        data = self._data
        wp.launch(
            derive_links,
            dim=data.nworld,
            inputs=[self._tree, data.qpos, data.qvel, data.mocap_pos, data.mocap_quat],
            outputs=[self._positions, self._orientations, self._velocities, *self._outputs],
        )
