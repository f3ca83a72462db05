"""Degrees of freedom of USD joints, and their friction, inertia, springs, drives and couplings.

UsdPhysics has only drives and limits. Newton's ``NewtonJointAPI``, PhysX' ``PhysxJointAPI`` and ``PhysxJointAxisAPI``
and MuJoCo's ``MjcJointAPI`` have the rest, and ``orbit:spring...`` is what none has in the stage's units. They are
read as plain attributes, whether or not the schemas are installed; the first that the file itself gives counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orbit_assets.usd.library import pxr
from orbit_assets.usd.stage import Reading, applies, array, attribute, authored, is_authored, label, number, targets
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import DriveGains, Joint, JointType, Mimic, Pose
from orbit_core.scene.pose import Vector3

_AXES: dict[str, Vector3] = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
# Axes of a generic joint: it moves along the first three of its first frame, then turns about x, y and z in turn.
_GENERIC = ("transX", "transY", "transZ", "rotX", "rotY", "rotZ")


@dataclass(frozen=True)
class Direction:
    """One degree of freedom: the axis in the joint's frames, limits in rad or m, and its name in the stage.

    ``instance`` names it in the schemas of drives, limits and friction: ``angular``, ``linear``, ``rotX`` and so on.
    """

    instance: str
    angular: bool
    axis: Vector3
    """Unit vector in the joint's frames."""
    lower: float
    """rad or m."""
    upper: float
    """rad or m."""

    @property
    def locked(self) -> bool:
        """True if a lower limit above the upper locks the direction."""
        return self.lower > self.upper


def directions(prim: Any, reading: Reading) -> tuple[Direction, ...] | None:
    """Return the directions in which a joint can move, the outermost first; None for a joint that cannot be described.

    Raises:
        AssetError: the joint's type or axis is unknown.
    """
    kind = prim.GetTypeName()
    match kind:
        case "PhysicsFixedJoint":
            return ()
        case "PhysicsRevoluteJoint" | "PhysicsPrismaticJoint":
            return (_simple(prim, reading, angular=kind == "PhysicsRevoluteJoint"),)
        # The cone limits both angles of a ball joint together, as no chain of hinges does.
        case "PhysicsSphericalJoint":
            if max(number(prim, f"physics:coneAngle{side}Limit", -1.0) for side in "01") >= 0:
                reading.lack(f"{prim.GetPath()} limits its ball joint by a cone")
            # The cone stands about the joint's own axis, which has no meaning without one.
            return tuple(Direction(f"rot{name}", True, axis, -math.inf, math.inf) for name, axis in _AXES.items())
        case "PhysicsJoint":
            if attribute(prim, "limit:distance:physics:high") is not None:
                reading.lack(f"{prim.GetPath()} limits a distance")
            found = (_generic(prim, reading, name) for name in _GENERIC)
            return tuple(each for each in found if not each.locked)
        case "PhysicsDistanceJoint":
            reading.lack(f"{prim.GetPath()} is a distance joint")
            return None
        case _:
            raise AssetError(f"{prim.GetPath()} is a {kind}: give it one of UsdPhysics' types of joints")


def _simple(prim: Any, reading: Reading, *, angular: bool) -> Direction:
    name = attribute(prim, "physics:axis", "X")
    if name not in _AXES:
        raise AssetError(f"{prim.GetPath()}.physics:axis is {name!r}: give X, Y or Z")
    unit = reading.units.position(angular)
    lower = number(prim, "physics:lowerLimit", -math.inf) * unit
    upper = number(prim, "physics:upperLimit", math.inf) * unit
    return Direction("angular" if angular else "linear", angular, _AXES[name], lower, upper)


def _generic(prim: Any, reading: Reading, name: str) -> Direction:
    angular = name.startswith("rot")
    unit = reading.units.position(angular)
    lower = number(prim, f"limit:{name}:physics:low", -math.inf) * unit
    upper = number(prim, f"limit:{name}:physics:high", math.inf) * unit
    return Direction(name, angular, _AXES[name[-1]], lower, upper)


def coordinates(directions: tuple[Direction, ...], relative: Pose) -> tuple[list[float], Pose]:
    """Compute the joint's positions (rad or m) for the pose ``relative`` of its second frame in the first, and the
    rest.

    The rest is the pose of the second frame in the one where those positions would bring it.
    """
    turning = [each for each in directions if each.angular]
    # Twice the half angle of the quaternion's component along the axis: exact over a whole turn.
    if len(turning) == 1:
        _, *vector = relative.orientation
        angles = [2.0 * math.atan2(float(np.dot(vector, turning[0].axis)), relative.orientation[0])]
    else:
        m = relative.rotation_matrix()
        euler = (
            math.atan2(-m[1, 2], m[2, 2]),
            math.asin(max(-1.0, min(1.0, float(m[0, 2])))),
            math.atan2(-m[0, 1], m[0, 0]),
        )
        angles = [euler[each.axis.index(1.0)] for each in turning]
    along = [float(np.dot(relative.position, each.axis)) for each in directions if not each.angular]
    # Along the axes of the first frame before any turn: a generic joint's order.
    reached = Pose()
    for each, value in zip(directions, [*along, *angles], strict=True):
        x, y, z = each.axis
        moved = Pose.from_axis_angle(each.axis, value) if each.angular else Pose((value * x, value * y, value * z))
        reached = reached @ moved
    return [*along, *angles], reached.inverse() @ relative


SPRING, SPRING_REST = "orbit:springStiffness", "orbit:springRestPosition"
"""Attributes of a joint: stiffness and rest position of a passive spring, in the stage's units and degrees."""
_SOFT = ("mjc:margin", "mjc:solimplimit", "mjc:solreflimit")
HIGHER_POWERS = "orbit:mimicHigherPowers"
"""Attribute of a follower: coefficients of the leader's square, cube and fourth power, in the stage's units."""


@dataclass(frozen=True)
class _Scales:
    """Scales from units of the stage to SI, for one direction of a joint."""

    position: float
    effort: float
    inertia: float

    @staticmethod
    def of(reading: Reading, angular: bool) -> _Scales:
        units = reading.units
        return _Scales(units.position(angular), units.effort(angular), units.inertia(angular))

    @property
    def gain(self) -> float:
        """Scale of stiffness and damping."""
        return self.effort / self.position


def with_dynamics(joint: Joint, direction: Direction, prim: Any, reading: Reading) -> Joint:
    """Return a simple joint with limits, efforts, friction, inertia and spring in one direction of its prim."""
    scales = _Scales.of(reading, direction.angular)
    axis = f"physxJointAxis:{direction.instance}"
    free = direction.lower == -math.inf and direction.upper == math.inf
    turning = JointType.CONTINUOUS if free else JointType.REVOLUTE
    _notice(prim, axis, reading)
    return replace(
        joint,
        type=turning if direction.angular else JointType.PRISMATIC,
        lower_limit=direction.lower,
        upper_limit=direction.upper,
        # Attributes in order of precedence: Newton's, PhysX' per axis and per joint, MuJoCo's, which are in SI units.
        effort_limit=_effort_limit(prim, direction, scales),
        velocity_limit=_first(
            prim,
            {
                "newton:velocityLimit": scales.position,
                f"{axis}:maxJointVelocity": scales.position,
                "physxJoint:maxJointVelocity": scales.position,
            },
            math.inf,
        ),
        damping=_first(
            prim, {"newton:damping": scales.gain, f"{axis}:viscousFrictionCoefficient": scales.gain, "mjc:damping": 1.0}
        ),
        friction=_first(
            prim,
            {"newton:friction": scales.effort, f"{axis}:dynamicFrictionEffort": scales.effort, "mjc:frictionloss": 1.0},
        ),
        armature=_first(
            prim,
            {
                "newton:armature": scales.inertia,
                f"{axis}:armature": scales.inertia,
                "physxJoint:armature": scales.inertia,
                "mjc:armature": 1.0,
            },
        ),
        stiffness=_first(prim, {SPRING: scales.gain, "mjc:stiffness": 1.0}),
        rest_position=(authored(prim, SPRING_REST) or 0.0) * scales.position
        or mujoco_angle(prim, "mjc:springref", direction, reading),
    )


def mujoco_angle(prim: Any, name: str, direction: Direction, reading: Reading) -> float:
    """Return a position of MuJoCo's schema in rad or m: angles are in the unit that the file's scene names."""
    value = authored(prim, name) or 0.0
    if not value or not direction.angular:
        return value
    scenes = (each for each in reading.stage.Traverse() if each.IsA(pxr().UsdPhysics.Scene))
    angle = next((attribute(scene, "mjc:compiler:angle", "degree") for scene in scenes), "degree")
    return value if angle == "radian" else math.radians(value)


def _first(prim: Any, scales: dict[str, float], default: float = 0.0) -> float:
    """Return the first attribute that the file gives, times its scale."""
    for name, scale in scales.items():
        if (value := authored(prim, name)) is not None:
            return value * scale
    return default


def _effort_limit(prim: Any, direction: Direction, scales: _Scales) -> float:
    """Return the effort limit (N or N m) of the drive, else the one that the converter from URDF writes."""
    drive = authored(prim, f"drive:{direction.instance}:physics:maxForce")
    if drive is not None:
        return drive * scales.effort
    return _first(prim, {"urdf:limit:effort": 1.0}, math.inf)


def _notice(prim: Any, axis: str, reading: Reading) -> None:
    """Note properties of a joint that are left out."""
    name = label(prim)
    if authored(prim, "physxJoint:jointFriction"):
        reading.note(f"the friction of joint '{name}' in proportion to its load (physxJoint:jointFriction) is left out")
    static = authored(prim, f"{axis}:staticFrictionEffort")
    if static is not None and static != authored(prim, f"{axis}:dynamicFrictionEffort"):
        reading.note(f"joint '{name}' has the friction that acts while it moves, not that at rest")
    if any(array(prim, "mjc:springdamper", 1, float)):
        reading.lack(f"{prim.GetPath()} has a spring by time constant and damping ratio (mjc:springdamper)")
    if any(is_authored(prim, each) for each in _SOFT):
        reading.note(f"joints' limits are hard, though the file gives them softness ({', '.join(_SOFT)})")
    if math.isfinite(number(prim, "physics:breakForce", math.inf) + number(prim, "physics:breakTorque", math.inf)):
        reading.note(f"joint '{name}' never breaks, though it has a break force or torque")
    soft = ("newton:limitStiffness", "newton:limitDamping")
    instance = axis.partition(":")[2]
    if any(authored(prim, each) is not None for each in (*soft, f"physxLimit:{instance}:stiffness")):
        reading.note(f"the limits of joint '{name}' are hard, though the file gives them a stiffness")


def drive_gains(joint: Joint, direction: Direction, prim: Any, reading: Reading) -> DriveGains | None:
    """Return the drive on one direction of a joint; None where the file gives it no gains."""
    drive = f"drive:{direction.instance}:physics"
    stiffness, damping = authored(prim, f"{drive}:stiffness"), authored(prim, f"{drive}:damping")
    if stiffness is None and damping is None:
        return None
    # Drives in accelerations multiply the gains by the mass that the joint moves, which varies with the pose.
    if attribute(prim, f"{drive}:type", "force") != "force":
        reading.note(f"the drive of joint '{joint.name}' is in accelerations: its gains are left out")
        return None
    gain = _Scales.of(reading, direction.angular).gain
    return DriveGains(joint.name, (stiffness or 0.0) * gain, (damping or 0.0) * gain, joint.effort_limit)


def mimic(prim: Any, direction: Direction, leaders: dict[str, tuple[str, bool]], reading: Reading) -> Mimic | None:
    """Return how a joint follows another, by Newton's schema, MuJoCo's or PhysX'.

    Args:
        prim: the follower's.
        direction: its one degree of freedom.
        leaders: the name of each joint by its path, and whether it turns.
        reading: the file.

    Raises:
        AssetError: the leader is missing.
    """
    own = reading.units.position(direction.angular)
    if found := targets(prim, "newton:mimicJoint"):
        if not attribute(prim, "newton:mimicEnabled", True):
            reading.note(f"joint '{label(prim)}' does not follow its leader at first, and never does here")
            return None
        name, angular = _leader(prim, found[0], leaders)
        scale = own / reading.units.position(angular)
        offset, slope = number(prim, "newton:mimicCoef0", 0.0), number(prim, "newton:mimicCoef1", 1.0)
        return Mimic(name, slope * scale, offset * own, _higher_powers(prim, own, reading.units.position(angular)))
    if applies(prim, "MjcEqualityJointAPI"):
        return _mujoco_mimic(prim, leaders)
    for axis in ("rotX", "rotY", "rotZ", "transX", "transY", "transZ", "angular", "linear"):
        if found := targets(prim, f"physxMimicJoint:{axis}:referenceJoint"):
            name, angular = _leader(prim, found[0], leaders)
            gearing = number(prim, f"physxMimicJoint:{axis}:gearing", 1.0)
            offset = number(prim, f"physxMimicJoint:{axis}:offset", 0.0)
            # PhysX: position + gearing * leader's position + offset = 0.
            return Mimic(name, -gearing * own / reading.units.position(angular), -offset * own)
    return None


def _mujoco_mimic(prim: Any, leaders: dict[str, tuple[str, bool]]) -> Mimic:
    """Read MuJoCo's schema, which Newton's has replaced; all its attributes are in radians and metres."""
    found = targets(prim, "mjc:target")
    if not found:
        raise AssetError(f"{prim.GetPath()} follows no joint by its MjcEqualityJointAPI: name one by mjc:target")
    name, _ = _leader(prim, found[0], leaders)
    offset, slope = number(prim, "mjc:coef0", 0.0), number(prim, "mjc:coef1", 1.0)
    return Mimic(name, slope, offset, _mujoco_powers(prim))


def _mujoco_powers(prim: Any) -> tuple[float, ...]:
    powers = [number(prim, f"mjc:coef{power}", 0.0) for power in (2, 3, 4)]
    while powers and not powers[-1]:
        powers.pop()
    return tuple(powers)


def _higher_powers(prim: Any, own: float, leader: float) -> tuple[float, ...]:
    given = attribute(prim, HIGHER_POWERS, ())
    return tuple(float(value) * own / leader**power for power, value in enumerate(given, start=2)) or _mujoco_powers(
        prim
    )


def _leader(prim: Any, path: str, leaders: dict[str, tuple[str, bool]]) -> tuple[str, bool]:
    if path not in leaders:
        raise AssetError(f"{prim.GetPath()} mimics {path}, which is no joint of its articulation with one position")
    return leaders[path]
