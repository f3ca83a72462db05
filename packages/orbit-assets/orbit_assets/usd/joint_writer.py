"""Writes an articulation's joints, drives, couplings and loops to USD."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orbit_assets.usd.dynamics import HIGHER_POWERS, SPRING, SPRING_REST
from orbit_assets.usd.prims import assign, assign_custom, define, quatf
from orbit_core.scene import Articulation, DriveGains, Joint, JointType, LoopJoint, LoopType, Pose
from orbit_core.scene.pose import Vector3


@dataclass(eq=False)
class JointWriter:
    """Writes the joints of one articulation, whose links have prims already."""

    articulation: Articulation
    stage: Any
    links: Mapping[str, Any]
    """Prims of links by name."""
    joints: dict[str, Any] = field(default_factory=dict)

    def write(self, top: Any) -> None:
        """Write all joints below a scope ``joints`` of the prim ``top``."""
        if not self.articulation.joints and not self.articulation.loops:
            return
        scope = define(self.stage, top, "joints", "Scope")
        drives = {drive.joint: drive for drive in self.articulation.drives}
        home = dict(self.articulation.home)
        for joint in self.articulation.joints:
            prim = self._joint(scope, joint)
            self.joints[joint.name] = prim
            if joint.movable:
                _set_dynamics(prim, joint)
                _set_drive(prim, joint, drives.get(joint.name))
            if joint.name in home:
                assign_custom(prim, {f"state:{_instance(joint)}:physics:position": home[joint.name] * _unit(joint)})
        for joint in self.articulation.joints:
            self._mimic(joint)
        for loop in self.articulation.loops:
            self._loop(scope, loop)

    def _joint(self, scope: Any, joint: Joint) -> Any:
        kind = "Revolute" if _angular(joint) else "Prismatic" if joint.movable else "Fixed"
        prim = define(self.stage, scope, joint.name, f"Physics{kind}Joint")
        axis, turn = _usd_axis(joint.axis)
        self._connect(prim, (joint.parent, joint.child), (joint.parent_pose @ turn, joint.child_pose @ turn))
        if joint.movable:
            assign(prim, None, {"physics:axis": axis})
        return prim

    def _connect(self, prim: Any, links: tuple[str, str], frames: tuple[Pose, Pose]) -> None:
        for side, link, frame in zip("01", links, frames, strict=True):
            prim.GetRelationship(f"physics:body{side}").SetTargets([self.links[link].GetPath()])
            prim.GetAttribute(f"physics:localPos{side}").Set(frame.position)
            prim.GetAttribute(f"physics:localRot{side}").Set(quatf(frame))

    def _mimic(self, joint: Joint) -> None:
        if joint.mimic is None:
            return
        leader = next(other for other in self.articulation.joints if other.name == joint.mimic.joint)
        own, other = _unit(joint), _unit(leader)
        prim = self.joints[joint.name]
        coefficients = {
            "newton:mimicCoef0": joint.mimic.offset * own,
            "newton:mimicCoef1": joint.mimic.multiplier * own / other,
        }
        assign(prim, "NewtonMimicAPI", coefficients)
        prim.GetRelationship("newton:mimicJoint").SetTargets([self.joints[leader.name].GetPath()])
        if not joint.mimic.linear:
            powers = enumerate(joint.mimic.higher_powers, start=2)
            assign_custom(prim, {HIGHER_POWERS: [value * own / other**power for power, value in powers]})

    def _loop(self, scope: Any, loop: LoopJoint) -> None:
        weld = loop.type is LoopType.WELD
        prim = define(self.stage, scope, loop.name, f"Physics{'Fixed' if weld else 'Spherical'}Joint")
        turned = Pose(orientation=loop.orientation) if weld else Pose()
        self._connect(
            prim,
            (loop.first, loop.second),
            (Pose(loop.first_point, turned.orientation), Pose(loop.second_point)),
        )
        assign(prim, None, {"physics:excludeFromArticulation": True})


def _set_dynamics(prim: Any, joint: Joint) -> None:
    position = _unit(joint)
    if joint.type is not JointType.CONTINUOUS:
        limits = {"physics:lowerLimit": joint.lower_limit, "physics:upperLimit": joint.upper_limit}
        assign(prim, None, {name: value * position for name, value in limits.items() if math.isfinite(value)})
    dynamics = {
        "newton:armature": joint.armature,
        "newton:damping": joint.damping / position,
        "newton:friction": joint.friction,
        "newton:velocityLimit": joint.velocity_limit * position,
    }
    assign(prim, "NewtonJointAPI", dynamics)
    if joint.stiffness:
        assign_custom(prim, {SPRING: joint.stiffness / position, SPRING_REST: joint.rest_position * position})


def _set_drive(prim: Any, joint: Joint, drive: DriveGains | None) -> None:
    """The drive that the articulation names, and the effort limit: USD has one for both."""
    instance, position = _instance(joint), _unit(joint)
    attributes: dict[str, Any] = {}
    if math.isfinite(joint.effort_limit):
        attributes["maxForce"] = joint.effort_limit
    if drive is not None:
        attributes |= {"stiffness": drive.stiffness / position, "damping": drive.damping / position}
    if attributes:
        named = {f"drive:{instance}:physics:{name}": value for name, value in attributes.items()}
        assign(prim, f"PhysicsDriveAPI:{instance}", named)


def _angular(joint: Joint) -> bool:
    return joint.type in (JointType.REVOLUTE, JointType.CONTINUOUS)


def _instance(joint: Joint) -> str:
    return "angular" if _angular(joint) else "linear"


def _unit(joint: Joint) -> float:
    """USD's units of position in one radian or metre."""
    return math.degrees(1.0) if _angular(joint) else 1.0


def _usd_axis(axis: Vector3) -> tuple[str, Pose]:
    """The name of a joint axis, and the turn of the joint's frames that takes that axis to the one given."""
    for name, basis in zip("XYZ", np.eye(3), strict=True):
        if np.array_equal(axis, basis):
            return name, Pose()
    z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    return "Z", Pose.from_matrix(np.stack((x, np.cross(z, x), z), axis=1))
