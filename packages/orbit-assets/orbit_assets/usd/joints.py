"""Joints of one articulation in a USD stage: those of its tree, those that close loops, and their actuators."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from orbit_assets.joint_models import ActuatorLaw, Range, chain
from orbit_assets.usd.dynamics import (
    Direction,
    coordinates,
    directions,
    drive_gains,
    mimic,
    mujoco_angle,
    with_dynamics,
)
from orbit_assets.usd.stage import Reading, array, attribute, authored, label, number, targets
from orbit_assets.usd.tree import Edge, Tree
from orbit_core.scene import DriveGains, Joint, JointType, Link, LoopJoint, LoopType, Mimic, Pose
from orbit_core.scene.pose import Vector3

# Effort range of a joint without a limit.
_NONE = (-math.inf, math.inf)
# Most names that a note lists; it counts the rest.
_SHOWN = 8


class Actuators:
    """The ``MjcActuator`` prims of a stage, by the joint prim that each drives.

    Args:
        prims: the actuators.
        joints: the stage's joints.
        reading: the file; actuators that drive no joint are noted.

    Raises:
        AssetError: a number of an actuator is none.
    """

    def __init__(self, prims: Sequence[Any], joints: Collection[Any], reading: Reading) -> None:
        paths = {str(joint.GetPath()) for joint in joints}
        self._laws: dict[str, list[tuple[str, ActuatorLaw]]] = {}
        left: list[str] = []
        for prim in prims:
            (target, *_) = targets(prim, "mjc:target") or [""]
            if target in paths:
                self._laws.setdefault(target, []).append((label(prim), _law(prim)))
            else:
                left.append(label(prim))
        if left:
            reading.note(f"actuators that drive no joint are left out: {_some(left)}")

    def limited(self, joint: Joint, prim: Any, reading: Reading) -> Joint:
        """Return the joint with the effort limit that its own range and all its actuators together leave it."""
        path = str(prim.GetPath())
        low, high = _sum(law for _, law in self._laws[path]) if path in self._laws else _NONE
        # Several actuators act on one joint together: their ranges add up.
        own = _range(prim, "actuatorfrclimited", "actuatorfrcrange") or _NONE
        low, high = max(low, own[0]), min(high, own[1])
        most = max(-low, high)
        if not math.isclose(-low, high, rel_tol=1e-6):
            reading.note(
                f"the effort limit of joint '{joint.name}' differs by direction, {low:.4g} to {high:.4g}: "
                f"{most:.4g} holds in both"
            )
        return replace(joint, effort_limit=min(most, joint.effort_limit))

    def drives(self, names: Mapping[str, str], driven: Collection[str], reading: Reading) -> list[DriveGains]:
        """Return the gains of joints that have actuators; those of several actuators add up.

        Args:
            names: names of an articulation's joints with one position, by the paths of their prims.
            driven: joints that have a drive of UsdPhysics, which counts.
            reading: the file, for notes on what is left out.
        """
        found: list[DriveGains] = []
        left: list[str] = []
        for path in names:
            laws = self._laws.get(path, [])
            if laws and names[path] in driven:
                reading.note(f"joint '{names[path]}' has a drive of UsdPhysics, which counts, and an actuator")
                continue
            left += [called for called, law in laws if law.gains() is None]
            known = [(law, gains) for _, law in laws if (gains := law.gains()) is not None]
            if known:
                low, high = _sum(law for law, _ in known)
                stiffness, damping = (sum(values) for values in zip(*(gains for _, gains in known), strict=True))
                found.append(DriveGains(names[path], stiffness, damping, max(-low, high)))
        if left:
            reading.note(f"actuators that are no spring and damper on one joint are left out: {_some(left)}")
        return found


def _law(prim: Any) -> ActuatorLaw:
    gear = array(prim, "mjc:gear", 1, float)
    return ActuatorLaw(
        gain_type=str(attribute(prim, "mjc:gainType", "fixed")),
        bias_type=str(attribute(prim, "mjc:biasType", "none")),
        dynamics=str(attribute(prim, "mjc:dynType", "none")),
        gain=_parameters(prim, "mjc:gainPrm", 1.0),
        bias=_parameters(prim, "mjc:biasPrm", 0.0),
        gear=float(gear[0]) if len(gear) else 1.0,
        force_range=_range(prim, "forceLimited", "forceRange"),
        command_range=_range(prim, "ctrlLimited", "ctrlRange"),
    )


def _parameters(prim: Any, name: str, first: float) -> tuple[float, ...]:
    """Return the first three of an actuator's parameters, the schema's where the file gives none."""
    given = [float(value) for value in array(prim, name, 1, float)[:3]] or [first]
    return (*given, *(0.0,) * (3 - len(given)))


def _range(prim: Any, limited: str, name: str) -> Range | None:
    """Return a range of MuJoCo's schema if it is active; ``auto`` means active where both ends differ."""
    word = str(attribute(prim, f"mjc:{limited}", "auto"))
    low, high = (number(prim, f"mjc:{name}:{end}") for end in ("min", "max"))
    return (low, high) if word == "true" or (word == "auto" and low != high) else None


def _sum(laws: Iterable[ActuatorLaw]) -> Range:
    """Return the least and the largest effort of actuators that act together."""
    lows, highs = zip(*(law.effort_range() for law in laws), strict=True)
    return sum(lows), sum(highs)


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(f"'{name}'" for name in names[:_SHOWN])
    return shown + (f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else "")


# Metres and radians by which the stage's poses may differ from those that the joint can reach; beyond, it is noted.
_APART = 1e-3
# Metres or radians from zero at which a joint counts as not at zero.
_MOVED = 1e-6
# Metres from the middle of a hinge that closes a loop to either of the two balls that replace it.
_HINGE = 0.05


@dataclass(eq=False)
class Joints:
    """Joints of a tree, and the massless links between those that come from one prim."""

    reading: Reading
    """File, units and options."""
    names: Mapping[str, str]
    """Names of links by their bodies' paths."""
    joint_names: Mapping[str, str]
    """Names of joints by their prims' paths."""
    root_pose: Callable[[str], Pose]
    """Returns the pose in the world of the link with a body's path."""
    actuators: Actuators
    """Actuators of MuJoCo's schema in the whole stage."""
    links: list[Link] = field(default_factory=list)
    """Massless links that were added."""
    joints: list[Joint] = field(default_factory=list)
    """Joints that have been read."""
    drives: list[DriveGains] = field(default_factory=list)
    """Gains of drives as the stage states them."""
    home: list[tuple[str, float]] = field(default_factory=list)
    """Names and positions, rad or m, of joints whose state the stage gives."""
    loops: list[LoopJoint] = field(default_factory=list)
    """Closures of loops."""
    references: dict[str, float] = field(default_factory=dict)
    """Positions of joints, rad or m, where their frames coincide; zero unless MuJoCo's schema says so."""

    def gather(self, tree: Tree) -> None:
        """Read all joints of a tree.

        Raises:
            AssetError: a joint moves as no chain of simple joints can, or mimics what is missing.
        """
        # Directions first: a follower needs the type of its leader, which may come later in the tree.
        parts = [part for edge, _ in tree.parent_edges.values() for part in edge.parts]
        ways: dict[str, tuple[Direction, ...]] = {
            str(part.prim.GetPath()): directions(part.prim, self.reading) or () for part in parts
        }
        leaders = {path: (self.joint_names[path], each[0].angular) for path, each in ways.items() if len(each) == 1}
        for path in tree.bodies:
            if path in tree.parent_edges:
                edge, backwards = tree.parent_edges[path]
                stacked = bool(edge.following)
                simple = [
                    joint
                    for part in edge.parts
                    for joint in self._simple_joints(
                        part, backwards, ways[str(part.prim.GetPath())], leaders, stacked=stacked
                    )
                ]
                # A chain runs from the parent: the order reverses where the prim names the bodies the other way round.
                links, joints = chain(simple[::-1] if backwards else simple)
                self.links += links
                self.joints += joints
        for edge in tree.loops:
            if edge.following:
                names = ", ".join(str(part.prim.GetPath()) for part in edge.parts)
                self.reading.lack(f"joints {names} together close a loop")
            else:
                self._close(edge)
        # Last: mimics must be complete before references shift their positions.
        self.joints = [self._counted(joint) for joint in self.joints]
        names = {path: name for path, (name, _) in leaders.items()}
        self.drives += self.actuators.drives(names, {drive.joint for drive in self.drives}, self.reading)

    def _simple_joints(
        self,
        edge: Edge,
        backwards: bool,
        ways: tuple[Direction, ...],
        leaders: dict[str, tuple[str, bool]],
        *,
        stacked: bool,
    ) -> list[Joint]:
        """Return the joints of one prim, in the prim's order, each as if it were the only one between its bodies."""
        (parent, child), (parent_pose, child_pose) = edge.bodies, edge.frames
        if backwards:
            parent, child, parent_pose, child_pose = child, parent, child_pose, parent_pose
        name = self.joint_names[str(edge.prim.GetPath())]
        whole = Joint(name, JointType.FIXED, self.names[parent], self.names[child], parent_pose, child_pose)
        if len(ways) == 1 and ways[0].locked:
            self.reading.note(f"joint '{whole.name}' is locked by limits of which the lower is above the upper: fixed")
            ways = ()
        if not ways:
            return [whole]
        against = backwards != edge.flipped
        simple = [self._simple(whole, each, edge.prim, against, several=len(ways) > 1) for each in ways]
        if len(simple) > 1:
            self.reading.note(f"joint '{whole.name}' is a chain of {len(simple)} joints, massless links between them")
        followed = mimic(edge.prim, ways[0], leaders, self.reading) if len(simple) == 1 else None
        if followed is None:
            self._stand(edge, ways, simple, stacked=stacked)
        for way, joint in zip(ways, simple, strict=True):
            if (gains := drive_gains(joint, way, edge.prim, self.reading)) is not None:
                self.drives.append(gains)
        return [replace(joint, mimic=followed) for joint in simple]

    def _simple(self, whole: Joint, way: Direction, prim: Any, backwards: bool, *, several: bool) -> Joint:
        x, y, z = way.axis
        axis = (-x, -y, -z) if backwards else way.axis
        name = f"{whole.name}_{way.instance}" if several else whole.name
        joint = with_dynamics(replace(whole, name=name, axis=axis), way, prim, self.reading)
        if not several and (reference := mujoco_angle(prim, "mjc:ref", way, self.reading)):
            self.references[name] = reference
        return joint if several else self.actuators.limited(joint, prim, self.reading)

    def _counted(self, joint: Joint) -> Joint:
        """Shift a joint's zero to MuJoCo's reference, which the joint has where its frames coincide."""
        reference = self.references.get(joint.name, 0.0)
        if joint.mimic is not None:
            leader = self.references.get(joint.mimic.joint, 0.0)
            law = np.polynomial.Polynomial(joint.mimic.coefficients)(np.polynomial.Polynomial((-leader, 1.0)))
            offset, *others = law.coef.tolist()  # without the highest powers that are zero
            slope, *powers = others or [0.0]
            joint = replace(joint, mimic=Mimic(joint.mimic.joint, slope, offset + reference, tuple(powers)))
        if not reference:
            return joint
        x, y, z = (-reference * each for each in joint.axis)
        sliding = joint.type is JointType.PRISMATIC
        back = Pose((x, y, z)) if sliding else Pose.from_axis_angle(joint.axis, -reference)
        return replace(joint, parent_pose=joint.parent_pose @ back)

    def _stand(self, edge: Edge, ways: tuple[Direction, ...], joints: list[Joint], *, stacked: bool) -> None:
        """Record home positions from the poses of the stage's bodies, or from a joint's own state.

        Poses do not determine each of several joints between two bodies: without a state those are at zero.
        """
        first, second = (self.root_pose(path) @ frame for path, frame in zip(edge.bodies, edge.frames, strict=True))
        relative = first.inverse() @ second
        states = [authored(edge.prim, f"state:{way.instance}:physics:position") for way in ways]
        found, rest = coordinates(() if stacked else ways, relative)
        angle = 2.0 * math.acos(min(1.0, rest.orientation[0]))
        # Nothing is guessed from poses that the joint cannot reach.
        if max(math.hypot(*rest.position), angle) > _APART and not (stacked and any(states)):
            self.reading.note(
                f"the bodies of joint '{label(edge.prim)}' stand {math.hypot(*rest.position):.3g} m and "
                f"{angle:.3g} rad from where {'zero brings' if stacked else 'it can bring'} them"
            )
            return
        for way, joint, state, implied in zip(ways, joints, states, found or [0.0] * len(ways), strict=True):
            position = implied if state is None else state * self.reading.units.position(way.angular)
            position += self.references.get(joint.name, 0.0)
            within = joint.lower_limit - _MOVED <= position <= joint.upper_limit + _MOVED
            if abs(position) > _MOVED and within:
                self.home.append((joint.name, min(max(position, joint.lower_limit), joint.upper_limit)))

    def _close(self, edge: Edge) -> None:
        """Convert a joint that closes a loop into balls and welds."""
        ways = directions(edge.prim, self.reading)
        if ways is None:
            return
        name = self.joint_names[str(edge.prim.GetPath())]
        first, second = (self.names[path] for path in edge.bodies)
        one, other = edge.frames
        ends: list[Vector3] = [(0.0, 0.0, 0.0)]
        kind = LoopType.BALL
        if not ways:
            kind = LoopType.WELD
        elif len(ways) == 1 and ways[0].angular:
            x, y, z = ways[0].axis
            # Two balls on the axis leave only the turn about it.
            ends = [(side * x, side * y, side * z) for side in (-_HINGE, _HINGE)]
            self.reading.note(f"joint '{name}' closes a loop: two balls on its axis {2 * _HINGE} m apart replace it")
            self._note_unheld(edge.prim, ways[0], name)
        elif not (len(ways) == 3 and all(way.angular for way in ways)):
            self.reading.lack(f"{edge.prim.GetPath()} closes a loop and is neither hinge, ball nor fixed")
            return
        turn = (one @ other.inverse()).orientation if kind is LoopType.WELD else (1.0, 0.0, 0.0, 0.0)
        for number_, end in enumerate(ends, start=1):
            points = (one @ Pose(end)).position, (other @ Pose(end)).position
            loop = LoopJoint(name if len(ends) == 1 else f"{name}_{number_}", first, second, *points, kind, turn)
            self.loops.append(loop)

    def _note_unheld(self, prim: Any, way: Direction, name: str) -> None:
        drive = f"drive:{way.instance}:physics:stiffness"
        if math.isfinite(way.lower) or math.isfinite(way.upper) or number(prim, drive) > 0:
            self.reading.note(f"joint '{name}' closes a loop: its limits and its drive are left out")
