"""The tree of links as MJCF's nested bodies, several joints on one body where links between them have no mass."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from orbit_assets.mjcf.model import vector_of
from orbit_assets.mjcf.shapes_writer import GeomWriter, place
from orbit_assets.mjcf.trees import WORLD
from orbit_assets.urdf.text import UNLIMITED, numbers
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Articulation, Joint, JointType, Link, Pose
from orbit_core.scene.inertias import solid_moments

_WIDTH = 1e-9
"""Rad, m, N or N m between limits that the description has equal: MuJoCo asks for some."""


@dataclass(eq=False)
class BodyWriter:
    """Writes one articulation's bodies below ``<worldbody>``."""

    articulation: Articulation
    geoms: GeomWriter
    fixed_base: bool

    def __post_init__(self) -> None:
        self.notes: list[str] = []
        self._joint_of = {joint.child: joint for joint in self.articulation.joints}
        self._children: dict[str, list[Joint]] = {}
        for joint in self.articulation.joints:
            self._children.setdefault(joint.parent, []).append(joint)
        ends = {name for loop in self.articulation.loops for name in (loop.first, loop.second)}
        self._named = {frame.link for frame in self.articulation.frames} | ends
        self._frames: dict[str, list[tuple[str, Pose]]] = {}
        for frame in self.articulation.frames:
            self._frames.setdefault(frame.link, []).append((frame.name, frame.pose))

    def write(self, worldbody: Element) -> dict[str, Element]:
        """The elements of all links but those without mass between joints; the root ``world`` is the world itself."""
        elements: dict[str, Element] = {}
        for link in self.articulation.links:
            if self._between(link):
                continue
            if link is self.articulation.root:
                elements[link.name] = body = self._root(worldbody, link)
            else:
                chain = self._chain(link)
                body = SubElement(elements[chain[0].parent], "body", name=link.name)
                elements[link.name] = body
                self._joints(body, chain)
            self._contents(body, link)
        return elements

    def _root(self, worldbody: Element, link: Link) -> Element:
        if link.name == WORLD:
            return worldbody
        body = SubElement(worldbody, "body", name=link.name)
        if not self.fixed_base:
            SubElement(body, "freejoint", name=f"{link.name}_free")
        return body

    def _contents(self, body: Element, link: Link) -> None:
        if link.mass > 0:
            self._inertial(body, link)
        elif (body.find("joint") is not None or body.find("freejoint") is not None) and not self._carried(link):
            raise AssetError(
                f"'{self.articulation.name}': link '{link.name}' moves without mass, and carries shapes, frames or "
                "several links, which MJCF refuses: give it mass"
            )
        self.geoms.write(body, link, is_root=link is self.articulation.root)
        for name, pose in self._frames.get(link.name, ()):
            place(SubElement(body, "site", name=name), pose)

    def _carried(self, link: Link) -> bool:
        """Whether a link without mass is rigid with one that has some."""
        waiting = [link.name]
        masses = {each.name: each.mass for each in self.articulation.links}
        while waiting:
            for joint in self._children.get(waiting.pop(), ()):
                if not joint.movable and masses[joint.child] > 0:
                    return True
                waiting += [] if joint.movable else [joint.child]
        return False

    def _between(self, link: Link) -> bool:
        """Whether a link stands for nothing but the place between two joints of one body."""
        joint, children = self._joint_of.get(link.name), self._children.get(link.name, [])
        empty = link.mass == 0 and not (link.collisions or link.visuals) and link.name not in self._named
        return bool(joint and joint.movable and empty and len(children) == 1 and children[0].movable)

    def _chain(self, link: Link) -> list[Joint]:
        """The joints between a link and the next above that is a body, the outermost first."""
        links = {each.name: each for each in self.articulation.links}
        chain = [self._joint_of[link.name]]
        while self._between(links[chain[0].parent]):
            parent = chain[0].parent
            chain.insert(0, self._joint_of[parent])
            if parent != f"{chain[0].name}_link":
                self.notes.append(f"MJCF does not hold the name of link '{parent}', which has no mass")
        return chain

    def _joints(self, body: Element, chain: list[Joint]) -> None:
        """Place a body where all joints are at zero, and each joint as the body sees it there."""
        at_zero = Pose()
        for joint in chain:
            at_zero = at_zero @ joint.parent_pose @ joint.child_pose.inverse()
        place(body, at_zero)
        below = Pose()
        seen: list[Pose] = []
        for joint in reversed(chain):
            below = joint.child_pose.inverse() @ below
            seen.insert(0, below.inverse())
            below = joint.parent_pose @ below
        for joint, frame in zip(chain, seen, strict=True):
            if joint.movable:
                _joint(body, joint, frame)

    def _inertial(self, body: Element, link: Link) -> None:
        moments, axes = solid_moments(link.inertia)
        SubElement(
            body,
            "inertial",
            pos=numbers(link.center_of_mass),
            quat=numbers(axes.orientation),
            mass=repr(float(link.mass)),
            # MuJoCo holds inertias to the triangle inequality without any tolerance.
            diaginertia=numbers(moments),
        )


def renamed_world(articulation: Articulation, *, fixed_base: bool) -> tuple[Articulation, tuple[str, ...]]:
    """The articulation with no link or frame by the name that MJCF keeps for the world itself, and what was said.

    A root ``world`` that is fixed and has no mass keeps it, for it is the world.
    """
    root = articulation.root
    taken = {*articulation.link_names, *(frame.name for frame in articulation.frames)}
    if WORLD not in taken or (fixed_base and root.name == WORLD and root.mass == 0):
        return articulation, ()
    new = next(name for name in (f"{WORLD}_{number}" for number in range(1, len(taken) + 2)) if name not in taken)

    def name(old: str) -> str:
        return new if old == WORLD else old

    renamed = replace(
        articulation,
        links=tuple(replace(link, name=name(link.name)) for link in articulation.links),
        joints=tuple(replace(j, parent=name(j.parent), child=name(j.child)) for j in articulation.joints),
        frames=tuple(replace(frame, name=name(frame.name), link=name(frame.link)) for frame in articulation.frames),
        collision_exclusions=tuple((name(one), name(other)) for one, other in articulation.collision_exclusions),
        loops=tuple(replace(loop, first=name(loop.first), second=name(loop.second)) for loop in articulation.loops),
    )
    return renamed, (f"MJCF keeps the name '{WORLD}' for the world: what has it becomes '{new}'",)


def _joint(body: Element, joint: Joint, frame: Pose) -> None:
    """One joint, whose frame stands so in the body."""
    angular = joint.type is not JointType.PRISMATIC
    axis = vector_of(frame.rotation_matrix() @ np.asarray(joint.axis))
    element = SubElement(
        body,
        "joint",
        name=joint.name,
        type="hinge" if angular else "slide",
        pos=numbers(frame.position),
        axis=numbers(axis),
    )
    limits = joint.lower_limit, joint.upper_limit
    limited = limits != (-math.inf, math.inf)
    element.set("limited", str(limited).lower())
    if limited:
        lower, upper = max(limits[0], -UNLIMITED), min(limits[1], UNLIMITED)
        element.set("range", numbers((lower, max(upper, lower + _WIDTH))))
    if math.isfinite(joint.effort_limit):
        effort = max(joint.effort_limit, _WIDTH)
        element.set("actuatorfrclimited", "true")
        element.set("actuatorfrcrange", numbers((-effort, effort)))
    for name, value in (
        ("damping", joint.damping),
        ("frictionloss", joint.friction),
        ("armature", joint.armature),
        ("stiffness", joint.stiffness),
        ("springref", joint.rest_position),
    ):
        if value:
            element.set(name, repr(float(value)))
