"""Joints of a compiled MJCF model: every body hangs on a chain of simple ones."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from orbit_assets.compound_joints import BALL, compound
from orbit_assets.mjcf.model import Compiled, vector_of
from orbit_assets.urdf.text import UNLIMITED
from orbit_core.scene import Joint, JointType, Link, Pose
from orbit_core.scene.pose import canonical


def body_chain(compiled: Compiled, body: int, effort_limits: dict[int, float]) -> tuple[list[Link], list[Joint]]:
    """The links without mass between a body and its parent, and the joints in order, the outermost first.

    Args:
        compiled: the model.
        body: any but the root.
        effort_limits: of joints, by their number; others have none.
    """
    names = compiled.body_names
    name, parent = names[body], names[int(compiled.model.body_parentid[body])]
    at_rest = compiled.body_pose(body)
    indices = compiled.joints_of(body)
    if not indices:
        return [], [Joint(f"{name}_fixed", JointType.FIXED, parent, name, at_rest)]
    between: list[Link] = []
    joints: list[Joint] = []
    for index in indices:
        child = name if index == indices[-1] else f"{compiled.joint_names[index]}_link"
        inner, chain = _joint(compiled, index, parent, child, at_rest, effort_limits.get(index, math.inf))
        between += [*inner, Link(child)] if child != name else inner
        joints += chain
        parent, at_rest = child, Pose()
    return between, joints


def check_root(compiled: Compiled, body: int) -> None:
    """Meet what a free joint has besides its freedom: the root of an articulation has none of it.

    Raises:
        AssetError: the options have what the description cannot hold refused.
    """
    model = compiled.model
    for joint in compiled.joints_of(body):
        dofs = slice(int(model.jnt_dofadr[joint]), int(model.jnt_dofadr[joint]) + 6)
        has = [
            word
            for word, values in (
                ("damping", model.dof_damping[dofs]),
                ("armature", model.dof_armature[dofs]),
                ("friction", model.dof_frictionloss[dofs]),
                ("a spring", model.jnt_stiffness[joint]),
            )
            if np.any(values)
        ]
        if has:
            what = f"free joint '{compiled.joint_names[joint]}' has {' and '.join(has)}, which a floating base has not"
            compiled.unsupported(what, "set them to zero")


def _joint(
    compiled: Compiled, index: int, parent: str, child: str, at_rest: Pose, effort_limit: float
) -> tuple[tuple[Link, ...], tuple[Joint, ...]]:
    """One of the file's joints; a ball is three."""
    model, name = compiled.model, compiled.joint_names[index]
    anchor = Pose(vector_of(model.jnt_pos[index]))
    dof = int(model.jnt_dofadr[index])
    _meet_curves(compiled, index, dof)
    numbers: dict[str, Any] = {
        "effort_limit": effort_limit,
        "damping": float(model.dof_damping[dof]),
        "friction": float(model.dof_frictionloss[dof]),
        "armature": float(model.dof_armature[dof]),
    }
    if compiled.joint_kind(index) == "BALL":
        _meet_ball(compiled, index)
        whole = Joint(name, JointType.CONTINUOUS, parent, child, at_rest @ anchor, anchor, **numbers)
        return compound(whole, BALL)
    return (), (_simple(compiled, index, (parent, child), at_rest, numbers),)


def _simple(compiled: Compiled, index: int, ends: tuple[str, str], at_rest: Pose, numbers: dict[str, Any]) -> Joint:
    model = compiled.model
    angular = compiled.joint_kind(index) == "HINGE"
    limited = bool(model.jnt_limited[index])
    lower, upper = model.jnt_range[index].tolist() if limited else (-math.inf, math.inf)
    lower, upper = lower if lower > -UNLIMITED else -math.inf, upper if upper < UNLIMITED else math.inf
    address = int(model.jnt_qposadr[index])
    axis = vector_of(model.jnt_axis[index])
    anchor = Pose(vector_of(model.jnt_pos[index]))
    # The file places bodies where the joint is at its reference; the description, where it is at zero.
    reference = float(model.qpos0[address])
    back = Pose.from_axis_angle(axis, -reference) if angular else Pose(vector_of(-reference * np.asarray(axis)))
    stiffness = float(model.jnt_stiffness[index])
    return Joint(
        compiled.joint_names[index],
        (JointType.REVOLUTE if limited else JointType.CONTINUOUS) if angular else JointType.PRISMATIC,
        *ends,
        at_rest @ anchor @ back,
        anchor,
        axis,
        lower,
        upper,
        stiffness=stiffness,
        rest_position=float(model.qpos_spring[address]) if stiffness else 0.0,
        **numbers,
    )


def _meet_curves(compiled: Compiled, index: int, dof: int) -> None:
    model = compiled.model
    if np.any(model.jnt_stiffnesspoly[index]) or np.any(model.dof_dampingpoly[dof]):
        what = f"joint '{compiled.joint_names[index]}' has a spring or damper that is not linear"
        compiled.unsupported(what, "give one coefficient each")


def _meet_ball(compiled: Compiled, index: int) -> None:
    """A ball has one limit, spring, damper and friction of its whole rotation; the chain's joints have their own."""
    model, name = compiled.model, compiled.joint_names[index]
    dof = int(model.jnt_dofadr[index])
    if model.jnt_limited[index]:
        most = float(model.jnt_range[index, 1])
        compiled.unsupported(f"ball joint '{name}' has a limit of {most:.4g} rad on its whole turn", "remove its range")
    if model.jnt_stiffness[index]:
        compiled.unsupported(f"ball joint '{name}' has a spring", "remove its stiffness")
    felt = (model.dof_damping[dof], model.dof_frictionloss[dof], model.dof_armature[dof])
    if any(felt):
        compiled.notes.append(
            f"ball joint '{name}': damping, friction and armature act on each of its three angles, not on the turn"
        )
    else:
        compiled.notes.append(f"ball joint '{name}' is three joints about x, y and z")


def ball_angles(quaternion: Any) -> tuple[float, float, float]:
    """The angles (a, b, c) in rad with which ``R_x(a) R_y(b) R_z(c)`` is the rotation of a quaternion (w, x, y, z)."""
    w, x, y, z = (float(value) for value in quaternion)
    m = Pose(orientation=canonical((w, x, y, z))).rotation_matrix()
    middle = math.asin(max(-1.0, min(1.0, float(m[0, 2]))))
    return math.atan2(-m[1, 2], m[2, 2]), middle, math.atan2(-m[0, 1], m[0, 0])
