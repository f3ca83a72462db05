"""Kernels in addition to MuJoCo-Warp's: commands in, state, contact forces and faults out, resets.

Each is one launch over environments (and links or contacts); quaternions are (w, x, y, z), as MuJoCo-Warp stores them
in ``wp.quat``.
A negative index of an environment selects none: a mask becomes indices without counting them.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp
from mujoco_warp._src.types import vec10f

from orbit_warpkit.kernels import DISTANCE_BOUND, SPEED_BOUND, within

DIVERGED_BIT = 1 << 30
"""The bit of a fault where a number is beyond the bounds of divergence, or no number. The lower bits are MuJoCo-Warp's
``OverflowType``."""
_DIVERGED = wp.constant(DIVERGED_BIT)


@wp.func
def rotate(q: wp.quat, v: wp.vec3) -> wp.vec3:
    u = wp.vec3(q[1], q[2], q[3])
    t = 2.0 * wp.cross(u, v)
    return v + q[0] * t + wp.cross(u, t)


@wp.func
def conjugate(q: wp.quat) -> wp.quat:
    return wp.quat(q[0], -q[1], -q[2], -q[3])


@wp.kernel(enable_backward=False)
def write_commands(
    position_targets: wp.array2d[float],
    velocity_targets: wp.array2d[float],
    efforts: wp.array2d[float],
    biasprm: wp.array2d[vec10f],
    ctrl: wp.array2d[float],
):
    """``ctrl = stiffness target + damping velocity target + effort``; the actuator subtracts the state's part."""
    env, joint = wp.tid()
    bias = biasprm[env % biasprm.shape[0], joint]
    drive = -bias[1] * position_targets[env, joint] - bias[2] * velocity_targets[env, joint]
    ctrl[env, joint] = drive + efforts[env, joint]


@wp.kernel(enable_backward=False)
def read_efforts(
    ctrl: wp.array2d[float],
    force: wp.array2d[float],
    biasprm: wp.array2d[vec10f],
    bounds: wp.array[float],
    lead: float,
    position_columns: wp.array[int],
    velocity_columns: wp.array[int],
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    efforts: wp.array2d[float],
):
    """The law of drives at the end of a step; at and beyond its bound a force is as the step began with it."""
    env, joint = wp.tid()
    effort = force[env, joint]
    if wp.abs(effort) < bounds[joint]:
        bias = biasprm[env % biasprm.shape[0], joint]
        velocity = qvel[env, velocity_columns[joint]]
        position = qpos[env, position_columns[joint]] - lead * velocity
        effort = ctrl[env, joint] + bias[1] * position + bias[2] * velocity
    efforts[env, joint] = effort


@wp.kernel(enable_backward=False)
def write_root(
    env_ids: wp.array[wp.int64],
    mocap: int,
    position_start: int,
    velocity_start: int,
    with_pose: bool,
    with_velocity: bool,
    pose: wp.array2d[float],
    velocity: wp.array2d[float],
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    mocap_pos: wp.array2d[wp.vec3],
    mocap_quat: wp.array2d[wp.quat],
):
    """A free root's angular velocity is in its own axes, so that a new pose alone must turn it."""
    row = wp.tid()
    env = int(env_ids[row])
    # A mask comes as indices that are -1 where it is False: their number must not depend on its values.
    if env < 0:
        return
    orientation = wp.quat(0.0, 0.0, 0.0, 0.0)
    if with_pose:
        orientation = wp.normalize(wp.quat(pose[row, 3], pose[row, 4], pose[row, 5], pose[row, 6]))
    if mocap >= 0:
        if with_pose:
            mocap_pos[env, mocap] = wp.vec3(pose[row, 0], pose[row, 1], pose[row, 2])
            mocap_quat[env, mocap] = orientation
        return
    p, v = position_start, velocity_start
    old = wp.quat(qpos[env, p + 3], qpos[env, p + 4], qpos[env, p + 5], qpos[env, p + 6])
    spin = rotate(old, wp.vec3(qvel[env, v + 3], qvel[env, v + 4], qvel[env, v + 5]))
    if with_pose:
        for i in range(3):
            qpos[env, p + i] = pose[row, i]
        for i in range(4):
            qpos[env, p + 3 + i] = orientation[i]
    else:
        orientation = old
    if with_velocity:
        spin = wp.vec3(velocity[row, 3], velocity[row, 4], velocity[row, 5])
        for i in range(3):
            qvel[env, v + i] = velocity[row, i]
    local = rotate(conjugate(orientation), spin)
    for i in range(3):
        qvel[env, v + 3 + i] = local[i]


@wp.kernel(enable_backward=False)
def reset_state(
    env_ids: wp.array[wp.int64],
    home_qpos: wp.array[float],
    home_mocap_pos: wp.array[wp.vec3],
    home_mocap_quat: wp.array[wp.quat],
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    warm_start: wp.array2d[float],
    mocap_pos: wp.array2d[wp.vec3],
    mocap_quat: wp.array2d[wp.quat],
    wrenches: wp.array2d[wp.spatial_vector],
    time: wp.array[float],
    overflow: wp.array[int],
):
    env = int(env_ids[wp.tid()])
    if env < 0:
        return
    for i in range(qpos.shape[1]):
        qpos[env, i] = home_qpos[i]
    for i in range(qvel.shape[1]):
        qvel[env, i] = 0.0
        # The solver's warm start is a part of the state: kept, an episode would depend on the one before.
        warm_start[env, i] = 0.0
    for i in range(mocap_pos.shape[1]):
        mocap_pos[env, i] = home_mocap_pos[i]
        mocap_quat[env, i] = home_mocap_quat[i]
    for i in range(wrenches.shape[1]):
        wrenches[env, i] = wp.spatial_vector()
    time[env] = 0.0
    overflow[env] = 0


@wp.kernel(enable_backward=False)
def note_faults(
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    watched: int,
    overflow: wp.array[int],
    faults: wp.array[int],
    summary: wp.array[int],
):
    """Faults of the step just taken, per environment and over all; ``watched`` are the overflows that count."""
    env = wp.tid()
    fault = overflow[env] & watched
    overflow[env] = 0
    for i in range(qpos.shape[1]):
        if not within(qpos[env, i], DISTANCE_BOUND):
            fault = fault | _DIVERGED
    for i in range(qvel.shape[1]):
        if not within(qvel[env, i], SPEED_BOUND):
            fault = fault | _DIVERGED
    faults[env] = fault
    if fault != 0:
        # One number for all environments, so that the host reads a single one.
        wp.atomic_or(summary, 0, fault)


@wp.kernel(enable_backward=False)
def note_peaks(
    rows: wp.array[int],
    contacts: wp.array[int],
    candidates: wp.array[int],
    peaks: wp.array[int],
):
    """The most contacts (or pairs that might touch) over all environments, and rows in any one, of the last step."""
    env = wp.tid()
    if env == 0:
        wp.atomic_max(peaks, 0, wp.max(contacts[0], candidates[0]))
    wp.atomic_max(peaks, 1, rows[env])
