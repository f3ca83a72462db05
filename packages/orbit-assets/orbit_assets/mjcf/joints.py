"""Joints of a compiled MJCF model as chains of simple ones, its actuators as drives, its keyframe as home."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from orbit_assets.joint_models import BALL, ActuatorLaw, compound
from orbit_assets.mjcf.model import Compiled, vector_of
from orbit_assets.urdf.writer import UNLIMITED
from orbit_core.scene import DriveGains, Joint, JointType, Link, Pose
from orbit_core.scene.pose import canonical


def body_chain(compiled: Compiled, body: int, effort_limits: dict[int, float]) -> tuple[list[Link], list[Joint]]:
    """Build the massless links between a body and its parent, and the joints in order, the outermost first.

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
    """Reject damping, armature, friction and springs of a free joint, which a floating root has not.

    Raises:
        AssetError: the options refuse unsupported elements.
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
    """Convert one of the file's joints; a ball becomes three."""
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


# Since MuJoCo 3.3 springs and dampers may be polynomials; a joint of the description has one coefficient each.
def _meet_curves(compiled: Compiled, index: int, dof: int) -> None:
    model = compiled.model
    if np.any(model.jnt_stiffnesspoly[index]) or np.any(model.dof_dampingpoly[dof]):
        what = f"joint '{compiled.joint_names[index]}' has a spring or damper that is not linear"
        compiled.unsupported(what, "give one coefficient each")


def _meet_ball(compiled: Compiled, index: int) -> None:
    """Reject or note the limit, spring, damper and friction of a ball's whole rotation: its three joints have their
    own.
    """
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
    """Return the angles (a, b, c) in rad with which ``R_x(a) R_y(b) R_z(c)`` is a rotation (w, x, y, z)."""
    w, x, y, z = (float(value) for value in quaternion)
    m = Pose(orientation=canonical((w, x, y, z))).rotation_matrix()
    middle = math.asin(max(-1.0, min(1.0, float(m[0, 2]))))
    return math.atan2(-m[1, 2], m[2, 2]), middle, math.atan2(-m[0, 1], m[0, 0])


# The keyframe that is home, where there are several.
_HOME = "home"


class Actuators:
    """Actuators of a compiled model, by the joint that each drives."""

    def __init__(self, compiled: Compiled) -> None:
        self.compiled = compiled
        """Compiled model."""
        self.names = compiled.names_of("ACTUATOR")
        """Names of all actuators, by number."""
        self.of_joint: dict[int, list[int]] = {}
        """Numbers of the actuators that drive a joint, by the joint's number."""
        model, kinds = compiled.model, compiled.mujoco.mjtTrn
        for actuator in range(model.nu):
            if model.actuator_trntype[actuator] in (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)):
                self.of_joint.setdefault(int(model.actuator_trnid[actuator, 0]), []).append(actuator)

    def effort_limits(self) -> dict[int, float]:
        """Return the largest effort on each joint, in either direction, within its own limit and those of its
        actuators.
        """
        model = self.compiled.model
        return {joint: _largest(self._effort_range(joint, self.of_joint.get(joint, []))) for joint in range(model.njnt)}

    def drives(self, bodies: set[int]) -> tuple[DriveGains, ...]:
        """Return the gains of the joints of some bodies; several actuators on one joint add up.

        An actuator that follows another law than a spring and a damper is left out with a note. So is an effort limit
        that differs by direction: the larger of the two holds in both.
        """
        model = self.compiled.model
        found: list[DriveGains] = []
        left: list[str] = []
        lopsided: list[str] = []
        for joint in range(model.njnt):
            # The model may hold several articulations, and these bodies are one of them.
            if int(model.jnt_bodyid[joint]) not in bodies:
                continue
            least, most = self._effort_range(joint, self.of_joint.get(joint, []))
            if not math.isclose(-least, most, rel_tol=1e-6):
                lopsided.append(f"'{self.compiled.joint_names[joint]}' {least:.4g} to {most:.4g}")
            if joint not in self.of_joint:
                continue
            simple = self.compiled.joint_kind(joint) in ("HINGE", "SLIDE")
            known = [(each, self._gains(each) if simple else None) for each in self.of_joint[joint]]
            left += [self._called(each) for each, gains in known if gains is None]
            gains = {each: gain for each, gain in known if gain is not None}
            if gains:
                stiffness, damping = (sum(values) for values in zip(*gains.values(), strict=True))
                limit = _largest(self._sum(list(gains)))
                found.append(DriveGains(self.compiled.joint_names[joint], stiffness, damping, limit))
        on_joints = {each for group in self.of_joint.values() for each in group}
        left += [self._called(each) for each in range(model.nu) if each not in on_joints]
        if lopsided:
            text = "effort limits (N or N m) that differ by direction have the larger of the two in both"
            self.compiled.notes.append(f"{text}: {_some(lopsided)}")
        if left:
            text = "actuators that are no spring and damper on one joint are left out"
            self.compiled.notes.append(f"{text}: {_some(left)}")
        return tuple(found)

    def home(self, bodies: set[int]) -> tuple[tuple[str, float], ...]:
        """Return the home positions of some bodies' joints: keyframe ``home``, else the first, else nonzero references.

        ``ref`` of a joint is where the file's simulation begins without a keyframe.
        """
        model = self.compiled.model
        keys, values = self.compiled.names_of("KEY"), self.home_values()
        found: list[tuple[str, float]] = []
        for joint in range(model.njnt):
            kind = self.compiled.joint_kind(joint)
            if int(model.jnt_bodyid[joint]) not in bodies or kind == "FREE":
                continue
            name, first = self.compiled.joint_names[joint], int(model.jnt_qposadr[joint])
            if kind == "BALL":
                angles = zip(("rx", "ry", "rz"), ball_angles(values[first : first + 4]), strict=True)
                found += [(f"{name}_{suffix}", angle) for suffix, angle in angles]
            else:
                found.append((name, float(values[first])))
        if not keys:
            return tuple((name, value) for name, value in found if value)
        if len(keys) > 1:
            chosen = _HOME if _HOME in keys else keys[0] or "0"
            self.compiled.notes.append(f"of {len(keys)} keyframes, '{chosen}' is home")
        return tuple(found)

    def home_values(self) -> np.ndarray:
        """Return all positions of the model in the home keyframe, else those at which its simulation begins."""
        keys = self.compiled.names_of("KEY")
        if not keys:
            return np.asarray(self.compiled.model.qpos0)
        return np.asarray(self.compiled.model.key_qpos[keys.index(_HOME) if _HOME in keys else 0])

    def _gains(self, actuator: int) -> tuple[float, float] | None:
        """Return stiffness and damping at the joint; None for another law than a spring and a damper."""
        return None if np.any(self.compiled.model.actuator_dampingpoly[actuator]) else self._law(actuator).gains()

    def _law(self, actuator: int) -> ActuatorLaw:
        # Names are passed, not MuJoCo's numbers: :class:`ActuatorLaw` also reads USD, where they are words.
        model, kinds = self.compiled.model, self.compiled.mujoco
        forces, commands = model.actuator_forcerange[actuator], model.actuator_ctrlrange[actuator]
        return ActuatorLaw(
            gain_type=_word(kinds.mjtGain(model.actuator_gaintype[actuator])),
            bias_type=_word(kinds.mjtBias(model.actuator_biastype[actuator])),
            dynamics=_word(kinds.mjtDyn(model.actuator_dyntype[actuator])),
            gain=tuple(model.actuator_gainprm[actuator].tolist()),
            bias=tuple(model.actuator_biasprm[actuator].tolist()),
            gear=float(model.actuator_gear[actuator, 0]),
            force_range=tuple(forces.tolist()) if model.actuator_forcelimited[actuator] else None,
            command_range=tuple(commands.tolist()) if model.actuator_ctrllimited[actuator] else None,
            damping=float(model.actuator_damping[actuator]),
        )

    def _effort_range(self, joint: int, actuators: list[int]) -> tuple[float, float]:
        """Return the least and the largest effort on a joint that its own limit and these actuators allow."""
        model = self.compiled.model
        least, most = self._sum(actuators) if actuators else (-math.inf, math.inf)
        if model.jnt_actfrclimited[joint]:
            own = model.jnt_actfrcrange[joint]
            least, most = max(least, float(own[0])), min(most, float(own[1]))
        return least, most

    def _sum(self, actuators: list[int]) -> tuple[float, float]:
        """Return the least and the largest effort of actuators that act together."""
        least, most = zip(*(self._law(each).effort_range() for each in actuators), strict=True)
        return sum(least), sum(most)

    def _called(self, actuator: int) -> str:
        return f"'{self.names[actuator] or actuator}'"


def _largest(limits: tuple[float, float]) -> float:
    return max(map(abs, limits))


def _word(kind: Any) -> str:
    """Return a kind of MuJoCo's as MJCF writes it: ``affine`` for ``mjBIAS_AFFINE``."""
    return kind.name.partition("_")[2].lower()


def _some(names: list[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
