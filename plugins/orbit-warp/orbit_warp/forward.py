"""Poses and velocities of links from positions and velocities of joints, in one launch.

MuJoCo-Warp's own kinematics take a score of launches, for they prepare a physics step: centres of mass, inertias,
geoms. What tasks read after a step, and again after resets, are links alone.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import warp as wp
from mujoco import mjtJoint
from mujoco_warp._src.math import axis_angle_to_quat, mul_quat
from torch import Tensor

from orbit_mjmodel.addresses import Addresses
from orbit_warp.kernels import rotate
from orbit_warp.native import Native

_FREE = wp.constant(int(mjtJoint.mjJNT_FREE))
_BALL = wp.constant(int(mjtJoint.mjJNT_BALL))
_SLIDE = wp.constant(int(mjtJoint.mjJNT_SLIDE))


# Threads of a block: many small blocks, for a launch has few threads and each goes a long way.
_THREADS = 64


@wp.struct
class Tree:
    """The bodies' part of a MuJoCo model."""

    mocaps: wp.array[int]
    """(bodies,) number among bodies that a program moves; -1 for others."""
    joint_counts: wp.array[int]
    """(bodies,) joints of each."""
    first_joints: wp.array[int]
    """(bodies,) first joint of each."""
    positions: wp.array2d[wp.vec3]
    """(K, bodies) m in the parent's frame."""
    orientations: wp.array2d[wp.quat]
    """(K, bodies) in the parent's frame."""
    types: wp.array[int]
    """(joints,) free, ball, slide or hinge."""
    position_addresses: wp.array[int]
    """(joints,) first number in ``qpos``."""
    velocity_addresses: wp.array[int]
    """(joints,) first number in ``qvel``."""
    anchors: wp.array2d[wp.vec3]
    """(K, joints) m in the body's frame."""
    axes: wp.array2d[wp.vec3]
    """(K, joints) unit vectors in the body's frame."""
    zeros: wp.array2d[float]
    """(K, coordinates) ``qpos0``: coordinates at which the bodies are at their poses."""


@wp.struct
class Branches:
    """The ways from a root to each body that has no children, one after the other."""

    starts: wp.array[int]
    """Offsets of the branches, one more than there are branches."""
    bodies: wp.array[int]
    """Bodies of all branches, each from its root on."""
    links: wp.array[int]
    """What link each of the bodies is; -1 where it is none, or a branch before has it."""


@wp.func
def quaternion_at(row: wp.array[float], start: int) -> wp.quat:
    return wp.normalize(wp.quat(row[start], row[start + 1], row[start + 2], row[start + 3]))


@wp.func
def vector_at(row: wp.array[float], start: int) -> wp.vec3:
    return wp.vec3(row[start], row[start + 1], row[start + 2])


@wp.kernel(enable_backward=False)
def derive_links(
    tree: Tree,
    branches: Branches,
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    mocap_pos: wp.array2d[wp.vec3],
    mocap_quat: wp.array2d[wp.quat],
    poses: wp.array3d[float],
    velocities: wp.array3d[float],
):
    """Each thread goes along one branch. Velocities are of the bodies' origins: linear, then angular."""
    branch, env = wp.tid()
    q, qd = qpos[env], qvel[env]
    position, linear, spin = wp.vec3(), wp.vec3(), wp.vec3()
    orientation = wp.quat(1.0, 0.0, 0.0, 0.0)
    for index in range(branches.starts[branch], branches.starts[branch + 1]):
        body = branches.bodies[index]
        base = 1.0 * position  # of the parent; to it the velocity belongs until all joints are in
        position += rotate(orientation, tree.positions[env % tree.positions.shape[0], body])
        orientation = mul_quat(orientation, tree.orientations[env % tree.orientations.shape[0], body])
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
                orientation = mul_quat(orientation, quaternion_at(q, p))
                turning = rotate(orientation, vector_at(qd, v))
            else:
                angle = q[p] - tree.zeros[env % tree.zeros.shape[0], p]
                orientation = mul_quat(orientation, axis_angle_to_quat(local_axis, angle))
                turning = axis * qd[v]
            position = anchor - rotate(orientation, local_anchor)
            spin += turning
            linear += wp.cross(turning, base - anchor)
        orientation = wp.normalize(orientation)
        linear += wp.cross(spin, position - base)
        link = branches.links[index]
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
        model = native.model
        self._data, self._tree = native.data, Tree()
        tree = self._tree
        tree.mocaps, tree.joint_counts, tree.first_joints = model.body_mocapid, model.body_jntnum, model.body_jntadr
        tree.positions, tree.orientations = model.body_pos, model.body_quat
        tree.types, tree.anchors, tree.axes = model.jnt_type, model.jnt_pos, model.jnt_axis
        tree.position_addresses, tree.velocity_addresses = model.jnt_qposadr, model.jnt_dofadr
        tree.zeros = model.qpos0
        self._count, self._branches = _branches(native.host_model.body_parentid, addresses)
        self._outputs = (wp.from_torch(poses), wp.from_torch(velocities))

    def launch(self) -> None:
        """Launch the kernels for the present state of all environments."""
        data = self._data
        wp.launch(
            derive_links,
            dim=(self._count, data.nworld),
            inputs=[self._tree, self._branches, data.qpos, data.qvel, data.mocap_pos, data.mocap_quat],
            outputs=[*self._outputs],
            block_dim=_THREADS,
        )


def _branches(parents: npt.NDArray[np.int32], addresses: Addresses) -> tuple[int, Branches]:
    """Branches of the bodies 1 and up, given each body's parent; body 0 is the world."""
    link_of = {int(body): link for link, body in enumerate(addresses.bodies)}
    starts, bodies, links = [0], list[int](), list[int]()
    for leaf in sorted(set(range(1, len(parents))) - set(parents[1:].tolist())):
        path = [leaf]
        while parents[path[-1]]:
            path.append(int(parents[path[-1]]))
        bodies += reversed(path)
        links += [link_of.pop(body, -1) for body in reversed(path)]
        starts.append(len(bodies))
    branches = Branches()
    branches.starts, branches.bodies, branches.links = (wp.array(a, dtype=int) for a in (starts, bodies, links))
    return len(starts) - 1, branches
