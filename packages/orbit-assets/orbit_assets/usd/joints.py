"""The joints of one articulation in a USD stage: those of its tree, and those that close loops in it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from orbit_assets.compound_joints import chain
from orbit_assets.usd.actuators import Actuators
from orbit_assets.usd.dynamics import drive_gains, mimic, mujoco_angle, with_dynamics
from orbit_assets.usd.freedoms import Direction, coordinates, directions
from orbit_assets.usd.stage import Reading, authored, label, number
from orbit_assets.usd.tree import Edge, Tree
from orbit_core.scene import DriveGains, Joint, JointType, Link, LoopJoint, LoopType, Mimic, Pose
from orbit_core.scene.pose import Vector3

_APART = 1e-3
"""Metres and radians by which bodies may stand beside where their joint can bring them; beyond, it is told."""
_MOVED = 1e-6
"""Metres or radians from zero at which a joint counts as standing elsewhere."""
_HINGE = 0.05
"""Metres from the middle of a hinge that closes a loop to either of the two balls that it becomes."""


@dataclass(eq=False)
class Joints:
    """Joints, and the links without mass between those that one prim stands for, gathered over a tree."""

    reading: Reading
    names: Mapping[str, str]
    """Names of links by their bodies' paths."""
    joint_names: Mapping[str, str]
    """Names of joints by their prims' paths."""
    root_pose: Callable[[str], Pose]
    """Where the link of a body's path stands in the world."""
    actuators: Actuators
    """MuJoCo's, of the whole stage."""
    links: list[Link] = field(default_factory=list)
    joints: list[Joint] = field(default_factory=list)
    drives: list[DriveGains] = field(default_factory=list)
    home: list[tuple[str, float]] = field(default_factory=list)
    loops: list[LoopJoint] = field(default_factory=list)
    references: dict[str, float] = field(default_factory=dict)
    """Positions of joints, rad or m, where their frames coincide; zero unless MuJoCo's schema says so."""

    def gather(self, tree: Tree) -> None:
        """Read all joints of a tree.

        Raises:
            AssetError: a joint moves as no chain of simple joints can, or mimics what is missing.
        """
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
                links, joints = chain(simple[::-1] if backwards else simple)
                self.links += links
                self.joints += joints
        for edge in tree.loops:
            if edge.following:
                names = ", ".join(str(part.prim.GetPath()) for part in edge.parts)
                self.reading.lack(f"joints {names} together close a loop")
            else:
                self._close(edge)
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
        """The joints that one prim stands for, in the prim's order, each as if it were alone between its bodies."""
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
        """The joint in positions of MuJoCo's, which has its reference where the joint's frames coincide."""
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
        """Take over where the stage's bodies stand, or where a joint's own state says that it does.

        Where bodies stand says nothing of each of several joints between them: those are at zero without a state.
        """
        first, second = (self.root_pose(path) @ frame for path, frame in zip(edge.bodies, edge.frames, strict=True))
        relative = first.inverse() @ second
        states = [authored(edge.prim, f"state:{way.instance}:physics:position") for way in ways]
        found, rest = coordinates(() if stacked else ways, relative)
        angle = 2.0 * math.acos(min(1.0, rest.orientation[0]))
        if max(math.hypot(*rest.position), angle) > _APART and not (stacked and any(states)):
            self.reading.note(
                f"the bodies of joint '{label(edge.prim)}' stand {math.hypot(*rest.position):.3g} m and "
                f"{angle:.3g} rad beside where {'zero brings' if stacked else 'it can bring'} them"
            )
            return
        for way, joint, state, implied in zip(ways, joints, states, found or [0.0] * len(ways), strict=True):
            position = implied if state is None else state * self.reading.units.position(way.angular)
            position += self.references.get(joint.name, 0.0)
            within = joint.lower_limit - _MOVED <= position <= joint.upper_limit + _MOVED
            if abs(position) > _MOVED and within:
                self.home.append((joint.name, min(max(position, joint.lower_limit), joint.upper_limit)))

    def _close(self, edge: Edge) -> None:
        """A joint that closes a loop, as balls and welds."""
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
            ends = [(side * x, side * y, side * z) for side in (-_HINGE, _HINGE)]
            self.reading.note(f"joint '{name}' closes a loop: two balls on its axis {2 * _HINGE} m apart stand for it")
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
