"""Kernels that engines in Warp share: reading joints, resetting commands and measurements, checking bounds.

Each kernel is one launch over environments (and joints). A negative index of an environment selects none: a mask
becomes indices without counting them.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_core.interfaces import MAX_DISTANCE, MAX_SPEED

# Constants of Warp, because kernels cannot read Python's global variables.
DISTANCE_BOUND = wp.constant(MAX_DISTANCE)
"""Coordinates (m, rad) beyond it have diverged."""
SPEED_BOUND = wp.constant(MAX_SPEED)
"""Speeds (m/s, rad/s) beyond it have diverged."""


@wp.func
def within(value: float, bound: float) -> bool:
    """Return True if a number's magnitude is within the bound; NaN is not."""
    return wp.abs(value) <= bound


@wp.kernel(enable_backward=False)
def read_joints(
    position_columns: wp.array[int],
    velocity_columns: wp.array[int],
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    positions: wp.array2d[float],
    velocities: wp.array2d[float],
):
    env, joint = wp.tid()
    positions[env, joint] = qpos[env, position_columns[joint]]
    velocities[env, joint] = qvel[env, velocity_columns[joint]]


@wp.kernel(enable_backward=False)
def reset_tensors(
    env_ids: wp.array[wp.int64],
    home_targets: wp.array[float],
    position_targets: wp.array2d[float],
    velocity_targets: wp.array2d[float],
    efforts: wp.array2d[float],
    joint_efforts: wp.array2d[float],
    contact_forces: wp.array2d[wp.vec3],
    wrenches: wp.array2d[float],
):
    """Commands to their defaults, measurements to zero."""
    env = int(env_ids[wp.tid()])
    if env < 0:
        return
    for i in range(home_targets.shape[0]):
        position_targets[env, i] = home_targets[i]
        velocity_targets[env, i] = 0.0
        efforts[env, i] = 0.0
        joint_efforts[env, i] = 0.0
    for i in range(contact_forces.shape[1]):
        contact_forces[env, i] = wp.vec3()
    for i in range(wrenches.shape[1]):
        wrenches[env, i] = 0.0
