"""Inputs of Newton's XPBD solver: drive targets, and the surface of each contact."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_newton.joints import JointTable


@wp.struct
class Drives:
    """Newton's arrays of drives, with a row per environment."""

    target_q: wp.array2d[float]
    target_qd: wp.array2d[float]
    stiffness: wp.array2d[float]
    damping: wp.array2d[float]
    force: wp.array2d[float]


@wp.kernel(enable_backward=False)
def write_drives(
    friction_speed: float,
    scales: wp.array[float],
    table: JointTable,
    stiffness: wp.array2d[float],
    damping: wp.array2d[float],
    position_targets: wp.array2d[float],
    velocity_targets: wp.array2d[float],
    efforts: wp.array2d[float],
    joint_q: wp.array2d[float],
    joint_qd: wp.array2d[float],
    drives: Drives,
    joint_efforts: wp.array2d[float],
):
    """A drive that asks for more than its limit is replaced by the limit; friction acts as a damper with its force.

    ``scales`` compensate for sweeps, each of which applies the drive again.
    """
    env, joint = wp.tid()
    dof = table.velocities[joint]
    q, v = joint_q[env, table.positions[joint]], joint_qd[env, dof]
    target = position_targets[env, joint] - table.zeros[joint]
    asked = stiffness[env, joint] * (target - q)
    asked += damping[env, joint] * (velocity_targets[env, joint] - v) + efforts[env, joint]
    limit = table.effort_limit[joint]
    force = wp.clamp(asked, -limit, limit)
    joint_efforts[env, joint] = force
    beyond = wp.abs(asked) > limit  # false of what is not finite, so that this is found
    within = wp.where(beyond, 0.0, 1.0)
    ke, kd = within * stiffness[env, joint], within * damping[env, joint]
    drag = table.damping[joint] + table.friction[joint] / wp.max(wp.abs(v), friction_speed)
    drives.target_q[env, table.targets[joint]] = target
    # Where there is damping, an effort is a velocity to be damped towards: so it acts in the sweeps, not before them.
    effort = wp.where(beyond, force, efforts[env, joint])
    damped = wp.where(kd + drag > 0.0, 1.0, 0.0)
    speed = velocity_targets[env, joint] * kd + damped * effort
    drives.target_qd[env, dof] = speed / wp.max(kd + drag, 1.0e-12)
    drives.stiffness[env, dof] = ke * scales[joint]
    drives.damping[env, dof] = (kd + drag) * scales[joint]
    drives.force[env, dof] = (1.0 - damped) * effort


@wp.struct
class Coefficients:
    """Newton's arrays of surfaces, with room for one of each contact behind those of the shapes."""

    body: wp.array[int]
    friction: wp.array[float]
    torsional: wp.array[float]
    rolling: wp.array[float]
    restitution: wp.array[float]


@wp.func
def _to_larger(one: float, other: float) -> float:
    """The value that averages with ``other`` to the larger of the two."""
    return 2.0 * wp.max(one, other) - other


@wp.kernel(enable_backward=False)
def give_own_surfaces(
    count: wp.array[int],
    shapes: int,
    coefficients: Coefficients,
    shape0: wp.array[int],
    shape1: wp.array[int],
):
    """Newton averages the coefficients of a pair; the contract takes the larger."""
    i = wp.tid()
    if i >= count[0]:
        return
    a, b, own = shape0[i], shape1[i], shapes + i
    coefficients.body[own] = coefficients.body[a]
    coefficients.friction[own] = _to_larger(coefficients.friction[a], coefficients.friction[b])
    coefficients.torsional[own] = _to_larger(coefficients.torsional[a], coefficients.torsional[b])
    coefficients.rolling[own] = _to_larger(coefficients.rolling[a], coefficients.rolling[b])
    coefficients.restitution[own] = _to_larger(coefficients.restitution[a], coefficients.restitution[b])
    shape0[i] = own


@wp.kernel(enable_backward=False)
def take_forces(count: wp.array[int], contact_f: wp.array[wp.spatial_vector], forces: wp.array[wp.vec3]):
    """Force of each contact on its first shape."""
    i = wp.tid()
    if i < count[0]:
        forces[i] = wp.spatial_top(contact_f[i])
