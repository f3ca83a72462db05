"""Forces that Newton's Featherstone solver is given: of joints, linearly implicit, and of contacts.

A force ``f - k q - d v`` of a joint is taken where the step h ends: ``f - k (q + h v) - d v`` and an inertia
``h d + h^2 k`` added to the joint's own, which makes it stable at any gain (Tan et al., Stable Proportional-Derivative
Controllers, 2011). A contact is a spring and a damper whose size follows from the effective mass where it acts.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false, reportReturnType=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_newton.joints import JointTable


@wp.struct
class JointSettings:
    friction_speed: float
    """rad/s or m/s at which friction is fully developed."""
    limit_stiffness: float
    """N m/rad or N/m beyond a limit."""
    limit_damping: float
    """N m s/rad or N s/m beyond a limit."""


@wp.kernel(enable_backward=False)
def write_joint_forces(
    h: float,
    settings: JointSettings,
    table: JointTable,
    stiffness: wp.array2d[float],
    damping: wp.array2d[float],
    position_targets: wp.array2d[float],
    velocity_targets: wp.array2d[float],
    efforts: wp.array2d[float],
    joint_q: wp.array2d[float],
    joint_qd: wp.array2d[float],
    joint_f: wp.array2d[float],
    joint_efforts: wp.array2d[float],
    armature: wp.array2d[float],
):
    env, joint = wp.tid()
    dof = table.velocities[joint]
    v = joint_qd[env, dof]
    q = joint_q[env, table.positions[joint]] + h * v
    ke, kd = stiffness[env, joint], damping[env, joint]
    force = ke * (position_targets[env, joint] - q) + kd * (velocity_targets[env, joint] - v) + efforts[env, joint]
    added = h * kd + h * h * ke
    limit = table.effort_limit[joint]
    if wp.abs(force) > limit:
        force = wp.clamp(force, -limit, limit)
        added = 0.0
    joint_efforts[env, joint] = force
    # Coulomb friction as a damper whose force is the friction at this speed.
    drag = table.damping[joint] + table.friction[joint] / wp.max(wp.abs(v), settings.friction_speed)
    force -= drag * v
    added += h * drag
    past = wp.min(q - table.lower[joint], 0.0) + wp.max(q - table.upper[joint], 0.0)
    if past != 0.0:
        force -= settings.limit_stiffness * past + settings.limit_damping * v
        added += h * settings.limit_damping + h * h * settings.limit_stiffness
    joint_f[env, dof] = force
    armature[env, dof] = table.armature[joint] + added


@wp.struct
class Bodies:
    """Newton's arrays of bodies, and what moves them."""

    q: wp.array[wp.transform]
    """Poses in the world."""
    qd: wp.array[wp.spatial_vector]
    """Velocities, m/s and rad/s, world axes."""
    com: wp.array[wp.vec3]
    """m, centres of mass in the bodies' frames."""
    mobility: wp.array[wp.spatial_matrix]
    """Inverse spatial inertias in world axes."""
    flags: wp.array[int]
    """Newton's flags, such as that of a kinematic body."""


@wp.struct
class Surfaces:
    """Per shape."""

    body: wp.array[int]
    """Body that carries the shape; -1 for the world."""
    friction: wp.array[float]
    """Coefficient of sliding friction."""
    torsional: wp.array[float]
    """m, coefficient of torsional friction."""
    rolling: wp.array[float]
    """m, coefficient of rolling friction."""
    damping_ratio: wp.array[float]
    """Damping ratio of the rebound, negative where the material asks for none."""
    stiffness: wp.array[float]
    """Stiffness of a compliant material, zero for others."""
    damping: wp.array[float]
    """N s/m of a compliant material."""


@wp.struct
class Found:
    """Newton's arrays of contacts."""

    count: wp.array[int]
    """Contacts so far, in one number."""
    shape0: wp.array[int]
    """First shape of each contact."""
    shape1: wp.array[int]
    """Second shape."""
    point0: wp.array[wp.vec3]
    """Point on the first shape, in its body's frame."""
    point1: wp.array[wp.vec3]
    """Point on the second shape, in its body's frame."""
    margin0: wp.array[float]
    """m by which the first shape is thicker than its geometry."""
    margin1: wp.array[float]
    """m by which the second shape is thicker."""
    normal: wp.array[wp.vec3]
    """Unit normal from the first shape to the second."""


@wp.struct
class ContactSettings:
    stiffness: float
    """``k h^2 / m``"""
    damping_ratio: float
    """Damping ratio of contacts without a compliant material."""
    friction_slope: float
    """``c h / m``"""


@wp.func
def _pose(bodies: Bodies, body: int) -> wp.transform:
    if body < 0:
        return wp.transform_identity()
    return bodies.q[body]


@wp.func
def _moves(bodies: Bodies, body: int) -> bool:
    return body >= 0 and (bodies.flags[body] & 2) == 0  # newton.BodyFlags.KINEMATIC


@wp.func
def _arm(bodies: Bodies, body: int, point: wp.vec3) -> wp.vec3:
    """The lever from the body's centre of mass to a point."""
    if body < 0:
        return point
    return point - wp.transform_point(bodies.q[body], bodies.com[body])


@wp.func
def _velocity(bodies: Bodies, body: int, arm: wp.vec3) -> wp.vec3:
    if body < 0:
        return wp.vec3()
    return wp.spatial_top(bodies.qd[body]) + wp.cross(wp.spatial_bottom(bodies.qd[body]), arm)


@wp.func
def _spin(bodies: Bodies, body: int) -> wp.vec3:
    if body < 0:
        return wp.vec3()
    return wp.spatial_bottom(bodies.qd[body])


@wp.func
def _turn(bodies: Bodies, body: int, axis: wp.vec3) -> float:
    """Inverse of the inertia about an axis."""
    if body < 0:
        return 0.0
    torque = wp.spatial_vector(wp.vec3(), axis)
    return wp.dot(torque, bodies.mobility[body] * torque)


@wp.func
def _mobility(bodies: Bodies, body: int, arm: wp.vec3, direction: wp.vec3) -> float:
    """Inverse of the mass that a force feels."""
    if body < 0:
        return 0.0
    wrench = wp.spatial_vector(direction, wp.cross(arm, direction))
    return wp.dot(wrench, bodies.mobility[body] * wrench)


@wp.func
def _depth(bodies: Bodies, found: Found, i: int, body0: int, body1: int) -> float:
    one = wp.transform_point(_pose(bodies, body0), found.point0[i])
    other = wp.transform_point(_pose(bodies, body1), found.point1[i])
    return found.margin0[i] + found.margin1[i] - wp.dot(found.normal[i], other - one)


@wp.kernel(enable_backward=False)
def count_contacts(bodies: Bodies, surfaces: Surfaces, found: Found, contacts_of_body: wp.array[int]):
    """Count the contacts of each body in which shapes overlap."""
    i = wp.tid()
    if i >= found.count[0]:
        return
    body0, body1 = surfaces.body[found.shape0[i]], surfaces.body[found.shape1[i]]
    if _depth(bodies, found, i, body0, body1) > 0.0:
        if _moves(bodies, body0):
            wp.atomic_add(contacts_of_body, body0, 1)
        if _moves(bodies, body1):
            wp.atomic_add(contacts_of_body, body1, 1)


@wp.func
def _damped(rate: wp.vec3, slope: float, most: float) -> wp.vec3:
    """A force against a motion, no larger than ``most``."""
    force = -slope * rate
    size = wp.length(force)
    if size > most:
        force = force * (most / size)
    return force


@wp.func
def _normal_force(
    settings: ContactSettings, surfaces: Surfaces, a: int, b: int, mass: float, h: float, crowd: float, count: float,
    depth: float, approach: float,
) -> float:  # fmt: skip
    ratio = wp.min(surfaces.damping_ratio[a], surfaces.damping_ratio[b])
    if ratio < 0.0:
        ratio = wp.max(surfaces.damping_ratio[a], surfaces.damping_ratio[b])
    if ratio < 0.0:
        ratio = settings.damping_ratio
    stiffness = settings.stiffness * mass / (h * h * crowd)
    damping = 2.0 * ratio * wp.sqrt(settings.stiffness) * mass / (h * crowd)
    soft = wp.max(surfaces.stiffness[a], surfaces.stiffness[b])
    if soft > 0.0 and soft / count < stiffness:
        stiffness = soft / count
        damping = wp.min(wp.max(surfaces.damping[a], surfaces.damping[b]) / count, mass / h)
    return wp.max(stiffness * depth + damping * approach, 0.0)


@wp.kernel(enable_backward=False)
def add_contact_forces(
    h: float,
    settings: ContactSettings,
    bodies: Bodies,
    surfaces: Surfaces,
    found: Found,
    contacts_of_body: wp.array[int],
    body_f: wp.array[wp.spatial_vector],
    forces: wp.array[wp.vec3],
):
    i = wp.tid()
    if i >= found.count[0]:
        return
    forces[i] = wp.vec3()
    a, b = found.shape0[i], found.shape1[i]
    body0, body1 = surfaces.body[a], surfaces.body[b]
    depth = _depth(bodies, found, i, body0, body1)
    if depth <= 0.0:
        return
    normal = found.normal[i]  # from the first shape to the second
    point = wp.transform_point(_pose(bodies, body0), found.point0[i]) + (found.margin0[i] - 0.5 * depth) * normal
    arm0, arm1 = _arm(bodies, body0, point), _arm(bodies, body1, point)
    mobility = _mobility(bodies, body0, arm0, normal) + _mobility(bodies, body1, arm1, normal)
    if mobility == 0.0:
        return
    count = float(1)
    if _moves(bodies, body0):
        count = wp.max(count, float(contacts_of_body[body0]))
    if _moves(bodies, body1):
        count = wp.max(count, float(contacts_of_body[body1]))
    crowd = wp.max(0.25 * count, 1.0)
    slip = _velocity(bodies, body0, arm0) - _velocity(bodies, body1, arm1)
    approach = wp.dot(slip, normal)
    push = _normal_force(settings, surfaces, a, b, 1.0 / mobility, h, crowd, count, depth, approach)
    slip -= approach * normal
    along = wp.normalize(slip)
    slope = settings.friction_slope / (h * crowd)
    friction = wp.max(surfaces.friction[a], surfaces.friction[b])
    mobility = _mobility(bodies, body0, arm0, along) + _mobility(bodies, body1, arm1, along)
    drag = wp.vec3()
    if mobility > 0.0:
        drag = _damped(slip, slope / mobility, friction * push)
    force = drag - push * normal  # on the first body
    spin = _spin(bodies, body0) - _spin(bodies, body1)
    twist = wp.dot(spin, normal) * normal
    roll = spin - twist
    torque = wp.vec3()
    turn = _turn(bodies, body0, normal) + _turn(bodies, body1, normal)
    if turn > 0.0:
        torque += _damped(twist, slope / turn, wp.max(surfaces.torsional[a], surfaces.torsional[b]) * push)
    turn = _turn(bodies, body0, wp.normalize(roll)) + _turn(bodies, body1, wp.normalize(roll))
    if turn > 0.0:
        torque += _damped(roll, slope / turn, wp.max(surfaces.rolling[a], surfaces.rolling[b]) * push)
    if body0 >= 0:
        wp.atomic_add(body_f, body0, wp.spatial_vector(force, wp.cross(arm0, force) + torque))
    if body1 >= 0:
        wp.atomic_sub(body_f, body1, wp.spatial_vector(force, wp.cross(arm1, force) + torque))
    forces[i] = force
