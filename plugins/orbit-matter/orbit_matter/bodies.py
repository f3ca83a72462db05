"""Free bodies that touch matter and are not attached to it, within a physics step.

Of other links the matter knows the way that the engine has taken them, and what it does to them they feel a step later.
That is too late for a body that rests on cloth: it would bounce on its contacts, ever higher. So the matter goes on
with free bodies by itself, most of a step ahead of the engine, from the state where this left them: in each substep by
what cloth and rope did to them so far, and by what else moved them in the engine's last step. The engine then takes
them the same way, under the mean of these wrenches.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import warp as wp

from orbit_core.interfaces import SceneLayout
from orbit_matter.contact import Felt
from orbit_matter.kernels import Links, pose_between

AHEAD = wp.constant(0.8)
"""Part of a step that the matter's end is ahead of the engine's. Half would neither take from a swinging load nor give
to it; contacts of what lies on cloth have their damping from the rest, and a load of angular frequency w loses ``0.15
w^2 dt`` of its swing a second."""


TOUCHED = wp.constant(0.1)
"""Of the gravity: acceleration that is neither gravity's nor the matter's by which a body counts as touched."""


@wp.struct
class Bodies:
    """B free bodies of each of N environments."""

    link: wp.array2d[int]
    """(N, B) of each, the only one that it has."""
    mass: wp.array2d[float]
    """(N, B) kg."""
    inertia: wp.array2d[wp.mat33]
    """(N, B) kg m^2 about the centre of mass, in the link's axes."""
    center: wp.array2d[wp.vec3]
    """(N, B) of mass, in the link's frame."""
    before: wp.array3d[float]
    """(N, B, 6) velocities, linear and angular, of the frame's origin before the engine's last step, and after it."""
    after: wp.array3d[float]
    """(N, B, 6) the same velocities after the step."""
    wrenches: wp.array3d[float]
    """(N, L, 6) that the matter had done to links in it, about their frames' origins."""
    pull: wp.array2d[wp.vec3]
    """(N, B) m/s^2 and rad/s^2 that what else there is gives it."""
    twist: wp.array2d[wp.vec3]
    """(N, B) rad/s^2: the angular part of ``pull``."""
    turning: wp.array2d[wp.mat33]
    """(N, B) inverse of the inertia, in world axes."""
    lags: wp.array2d[int]
    """(N, B) 1 for those that feel this step's matter in the next one only, as links do."""
    shift: wp.array2d[wp.vec3]
    """(N, B) how far it is from where its velocity alone would have taken it: metres of its centre, and radians."""
    turned: wp.array2d[wp.vec3]
    """(N, B) rad: the angular part of ``shift``."""


def free_links(layout: SceneLayout) -> list[int]:
    """Indices of the links of free bodies that matter moves: of what is neither fixed nor has joints."""
    return [e.links.start for e in layout.entities if e.spec.is_free_body]


def masses(layout: SceneLayout) -> tuple[npt.NDArray[np.float32], ...]:
    """Masses (K, B), inertias (K, B, 3, 3) and centres of mass (K, B, 3) of free bodies in each kind of environment."""
    chosen = free_links(layout)
    kinds = [[variant.links[n] for n in chosen] for variant in layout.variants]
    shape = (len(kinds), len(chosen))
    mass = np.array([[link.mass for link in links] for links in kinds], np.float32).reshape(shape)
    inertia = np.array([[link.inertia for link in links] for links in kinds], np.float32).reshape(*shape, 3, 3)
    center = np.array([[link.center_of_mass for link in links] for links in kinds], np.float32).reshape(*shape, 3)
    return mass, inertia, center


@wp.func
def three(of: wp.array3d[float], env: int, row: int, first: int) -> wp.vec3:
    return wp.vec3(of[env, row, first], of[env, row, first + 1], of[env, row, first + 2])


@wp.func
def quat_of(of: wp.array3d[float], env: int, row: int) -> wp.quat:
    """Return the orientation of a pose (x, y, z, then w, x, y, z of the quaternion)."""
    return wp.quat(of[env, row, 4], of[env, row, 5], of[env, row, 6], of[env, row, 3])


@wp.func
def _at_most(v: wp.vec3, most: float) -> wp.vec3:
    length = wp.length(v)
    if length > most:
        v = v * (most / length)
    return v


@wp.func
def turn_by(v: wp.vec3) -> wp.quat:
    """The turn by a rotation vector, in radians."""
    angle = wp.length(v)
    if angle < 1.0e-9:
        return wp.quat(0.5 * v, 1.0)
    return wp.quat_from_axis_angle(v / angle, angle)


@wp.func
def write_pose(to: wp.array3d[float], env: int, link: int, x: wp.vec3, q: wp.quat, center: wp.vec3):
    """The pose of a link whose centre of mass is at x."""
    origin = x - wp.quat_rotate(q, center)
    for k in range(3):
        to[env, link, k] = origin[k]
        to[env, link, 4 + k] = q[k]
    to[env, link, 3] = q[3]


@wp.kernel(enable_backward=False)
def look_ahead(
    b: Bodies, attached: wp.array2d[int], links: Links, gravity: wp.array[wp.vec3], dt: float, h: float, liquids: int
):  # fmt: skip
    """Extrapolate each body's pose over the step to come, and note what other than the matter accelerates it.

    That is what it was in the last step: gravity, and what other bodies did. Of a blow, which does not go on, no more
    is taken than what carries the body and the matter's own wrench.

    In scenes with ``liquids`` a body that more than gravity and matter moved waits for the engine. The pressure of a
    liquid in one step says too little of what a stand answers in the next: a light cup went up and down in its water.
    What floats is touched by the liquid alone; it swung on it by 3.5 mm where it felt it a step late.
    """
    env, i = wp.tid()
    b.lags[env, i] = 0
    if attached[env, i] > 0:
        return
    link = b.link[env, i]
    e = links.end
    position, q = three(e, env, link, 0), quat_of(e, env, link)
    axes = wp.quat_to_matrix(q)
    arm, mass = axes * b.center[env, i], b.mass[env, i]
    turning = axes * wp.inverse(b.inertia[env, i]) * wp.transpose(axes)
    w, w_before = three(b.after, env, i, 3), three(b.before, env, i, 3)
    v = three(b.after, env, i, 0) + wp.cross(w, arm)
    v_before = three(b.before, env, i, 0) + wp.cross(w_before, arm)
    force = three(b.wrenches, env, link, 0)
    torque = three(b.wrenches, env, link, 3) - wp.cross(arm, force)
    own, own_turn = force / mass, turning * torque
    weight = wp.length(gravity[env])
    if liquids == 1 and wp.length((v - v_before) / dt - own - gravity[env]) > TOUCHED * wp.max(weight, 1.0):
        b.lags[env, i] = 1
        return
    b.pull[env, i] = _at_most((v - v_before) / dt - own, weight + wp.length(own))
    gyration = wp.sqrt(wp.trace(b.inertia[env, i]) / mass)
    b.twist[env, i] = _at_most((w - w_before) / dt - own_turn, weight / gyration + wp.length(own_turn))
    b.turning[env, i] = turning
    b.shift[env, i] = wp.vec3()
    b.turned[env, i] = wp.vec3()
    # A window as long as the step, which begins before the engine's state and ends AHEAD of it. On liquids each begins
    # where the last one ended: a liquid takes from the way of a body what its velocity does not say for pressure.
    end = AHEAD * dt
    if liquids == 1:
        end = 0.5 * (dt + h)
    x, c, begin = position + arm, b.center[env, i], end - dt
    write_pose(links.start, env, link, x + v * begin, turn_by(w * begin) * q, c)
    write_pose(links.end, env, link, x + v * end, turn_by(w * end) * q, c)


@wp.kernel(enable_backward=False)
def respond(
    b: Bodies, attached: wp.array2d[int], links: Links, felt: Felt, dt: float, share: float, h: float, stage: int
):  # fmt: skip
    """Move bodies by what was done to them so far, in the substep that ends after a share of the step.

    Args:
        b: the bodies.
        attached: (N, B) particles that are attached to each, which others move.
        links: where they are.
        felt: forces on them.
        dt: seconds of a step.
        share: of the step, at the end of the substep.
        h: seconds of a substep.
        stage: 0 to move them; 1 to say where they are before a liquid has pushed them in this substep, and 2 to move
            them when it has. Pressure follows their velocity, and one that is a push late feeds what it should calm.
    """
    env, i = wp.tid()
    if attached[env, i] > 0 or b.lags[env, i] == 1:
        return
    link = b.link[env, i]
    force = wp.vec3()
    for d in range(felt.forces.shape[1]):
        force += felt.forces[env, d, link]
    pose = pose_between(links.start, links.end, env, link, share)
    origin, q = wp.transform_get_translation(pose), wp.transform_get_rotation(pose)
    arm = wp.quat_rotate(q, b.center[env, i])
    torque = felt.torques[env, link] - wp.cross(arm, force)
    pulled = share
    if stage == 1:
        # As long as the forces so far, or what floats would sink by ``g h`` in each substep.
        pulled -= h / dt
    shift = b.shift[env, i] + (b.pull[env, i] * pulled + force / b.mass[env, i]) * (dt * h)
    turned = b.turned[env, i] + (b.twist[env, i] * pulled + b.turning[env, i] * torque) * (dt * h)
    if stage != 1:
        b.shift[env, i] = shift
        b.turned[env, i] = turned
    q = turn_by(turned) * q
    links.link[env, link] = wp.transform(origin + arm + shift - wp.quat_rotate(q, b.center[env, i]), q)
