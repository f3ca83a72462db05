"""Kernels that ORBIT adds to Newton's own: wrenches in, state and faults out, resets.

Arrays of Newton's are flat, environment by environment; quaternions are (x, y, z, w) there, and (w, x, y, z) here.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_warpkit.kernels import DISTANCE_BOUND, SPEED_BOUND, within


@wp.kernel(enable_backward=False)
def write_body_forces(
    applied: wp.array2d[wp.spatial_vector],
    compensated: wp.array[float],
    mass: wp.array[float],
    gravity: wp.array[wp.vec3],
    body_f: wp.array[wp.spatial_vector],
):
    """Wrenches applied to links at their centres of mass, and what holds up links whose gravity is compensated."""
    env, link = wp.tid()
    body = env * applied.shape[1] + link
    weight = compensated[link] * mass[body] * gravity[env]
    body_f[body] = applied[env, link] - wp.spatial_vector(weight, wp.vec3())


@wp.kernel(enable_backward=False)
def read_links(
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    body_com: wp.array[wp.vec3],
    poses: wp.array3d[float],
    velocities: wp.array3d[float],
):
    """Newton's velocities are of the centre of mass: move them to the link's origin."""
    env, link = wp.tid()
    body = env * poses.shape[1] + link
    position = wp.transform_get_translation(body_q[body])
    q = wp.transform_get_rotation(body_q[body])
    sign = wp.float32(1.0)
    if q[3] < 0.0:
        sign = -1.0
    spin = wp.spatial_bottom(body_qd[body])
    linear = wp.spatial_top(body_qd[body]) - wp.cross(spin, wp.quat_rotate(q, body_com[body]))
    for i in range(3):
        poses[env, link, i] = position[i]
        poses[env, link, 4 + i] = sign * q[i]
        velocities[env, link, i] = linear[i]
        velocities[env, link, 3 + i] = spin[i]
    poses[env, link, 3] = sign * q[3]


@wp.kernel(enable_backward=False)
def shift_joints(zeros: wp.array[float], positions: wp.array2d[float]):
    """Convert Newton's joint coordinates to the contract's."""
    env, joint = wp.tid()
    positions[env, joint] += zeros[joint]


@wp.kernel(enable_backward=False)
def write_root(
    env_ids: wp.array[wp.int64],
    links: int,
    root: int,
    joints: int,
    root_joint: int,
    position_start: int,
    velocity_start: int,
    with_pose: bool,
    with_velocity: bool,
    pose: wp.array2d[float],
    velocity: wp.array2d[float],
    body_com: wp.array[wp.vec3],
    joint_q: wp.array2d[float],
    joint_qd: wp.array2d[float],
    joint_X_p: wp.array[wp.transform],
):
    """A free root's coordinates are its pose and the velocity of its centre of mass, in world axes."""
    row = wp.tid()
    env = int(env_ids[row])
    p, v = position_start, velocity_start
    orientation = wp.quat_identity()
    if with_pose:
        orientation = wp.normalize(wp.quat(pose[row, 4], pose[row, 5], pose[row, 6], pose[row, 3]))
    if p < 0:
        if with_pose:
            joint_X_p[env * joints + root_joint] = wp.transform(
                wp.vec3(pose[row, 0], pose[row, 1], pose[row, 2]), orientation
            )
        return
    center = body_com[env * links + root]
    old = wp.quat(joint_q[env, p + 3], joint_q[env, p + 4], joint_q[env, p + 5], joint_q[env, p + 6])
    spin = wp.vec3(joint_qd[env, v + 3], joint_qd[env, v + 4], joint_qd[env, v + 5])
    linear = wp.vec3(joint_qd[env, v], joint_qd[env, v + 1], joint_qd[env, v + 2])
    linear -= wp.cross(spin, wp.quat_rotate(old, center))
    if with_velocity:
        linear = wp.vec3(velocity[row, 0], velocity[row, 1], velocity[row, 2])
        spin = wp.vec3(velocity[row, 3], velocity[row, 4], velocity[row, 5])
    if with_pose:
        for i in range(3):
            joint_q[env, p + i] = pose[row, i]
        for i in range(4):
            joint_q[env, p + 3 + i] = orientation[i]
    else:
        orientation = old
    linear += wp.cross(spin, wp.quat_rotate(orientation, center))
    for i in range(3):
        joint_qd[env, v + i] = linear[i]
        joint_qd[env, v + 3 + i] = spin[i]


@wp.kernel(enable_backward=False)
def reset_state(
    env_ids: wp.array[wp.int64],
    home_q: wp.array[float],
    home_X_p: wp.array[wp.transform],
    joint_q: wp.array2d[float],
    joint_qd: wp.array2d[float],
    joint_X_p: wp.array2d[wp.transform],
    applied: wp.array2d[wp.spatial_vector],
):
    env = int(env_ids[wp.tid()])
    for i in range(home_q.shape[0]):
        joint_q[env, i] = home_q[i]
    for i in range(joint_qd.shape[1]):
        joint_qd[env, i] = 0.0
    for i in range(home_X_p.shape[0]):
        joint_X_p[env, i] = home_X_p[i]
    for i in range(applied.shape[1]):
        applied[env, i] = wp.spatial_vector()


@wp.kernel(enable_backward=False)
def note_divergence(
    body_q: wp.array2d[wp.transform],
    body_qd: wp.array2d[wp.spatial_vector],
    joint_q: wp.array2d[float],
    diverged: wp.array[int],
    summary: wp.array[int],
):
    """Environments in which a number is beyond the bounds of divergence, or none."""
    env = wp.tid()
    diverged[env] = 0
    for i in range(body_q.shape[1]):
        near = within(wp.length(wp.transform_get_translation(body_q[env, i])), DISTANCE_BOUND)
        slow = within(wp.length(wp.spatial_top(body_qd[env, i])), SPEED_BOUND)
        if not (near and slow and within(wp.length(wp.spatial_bottom(body_qd[env, i])), SPEED_BOUND)):
            diverged[env] = 1
    for i in range(joint_q.shape[1]):
        if not within(joint_q[env, i], DISTANCE_BOUND):
            diverged[env] = 1
    if diverged[env] != 0:
        wp.atomic_or(summary, 0, 1)


@wp.kernel(enable_backward=False)
def note_overflow(count: wp.array[int], most: int, summary: wp.array[int]):
    """Record if more contacts were found than the buffer holds."""
    if count[0] > most:
        wp.atomic_or(summary, 0, 2)


@wp.kernel(enable_backward=False)
def mark_articulations(environments: wp.array[bool], articulations: wp.array[bool]):
    """Mark the articulations of the marked environments."""
    articulation = wp.tid()
    per_env = articulations.shape[0] / environments.shape[0]
    articulations[articulation] = environments[articulation / per_env]


@wp.kernel(enable_backward=False)
def unwrap_joints(turning: wp.array[bool], derived: wp.array2d[float], joint_q: wp.array2d[float]):
    """Coordinates derived from poses; those that turn go on from where they were, and so count whole turns."""
    env, column = wp.tid()
    value = derived[env, column]
    if turning[column]:
        turn = 2.0 * wp.pi
        value += turn * wp.round((joint_q[env, column] - value) / turn)
    joint_q[env, column] = value
