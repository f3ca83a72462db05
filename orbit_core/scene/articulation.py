"""The one articulation description that every reader produces and every engine builds from."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from orbit_core.scene.joints import DriveGains, Joint, LoopJoint
from orbit_core.scene.pose import Pose, Vector3
from orbit_core.scene.shapes import Shape


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid body.

    ``inertia`` (3, 3) in kg m^2 is about the centre of mass, in the link's axes; ``center_of_mass`` is in the link
    frame. ``semantic_label`` names the kind of thing in segmentation images; empty takes the entity's. A link without
    mass and inertia may be the root of a fixed base, or stand between two joints of a tree, as those of a compound
    joint do (:mod:`orbit_assets.joint_models`).
    """

    name: str
    mass: float = 0.0
    center_of_mass: Vector3 = (0.0, 0.0, 0.0)
    inertia: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 3)))
    collisions: tuple[Shape, ...] = ()
    visuals: tuple[Shape, ...] = ()
    semantic_label: str = ""


@dataclass(frozen=True)
class Frame:
    """A named frame fixed to a link: a tool centre point, a sensor's mount, a link merged away."""

    name: str
    link: str
    pose: Pose = field(default_factory=Pose)


@dataclass(frozen=True, eq=False)
class Articulation:
    """A tree of links, and joints that close loops in it. A rigid object is an articulation with one link.

    Links stand in topological order, the root first, and joints in the order of their child links; this order is the
    order of every tensor on every engine. :func:`orbit_core.preparation.validation.validate` checks it.
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...] = ()
    frames: tuple[Frame, ...] = ()
    self_collisions: bool = False
    """Whether links that no joint connects (:attr:`joined_links`) may collide with each other."""
    collision_exclusions: tuple[tuple[str, str], ...] = ()
    """Pairs of links that never collide, whatever ``self_collisions`` says."""
    notes: tuple[str, ...] = ()
    """What a reader or the catalogue changed against the source, for the build report."""
    loops: tuple[LoopJoint, ...] = ()
    drives: tuple[DriveGains, ...] = ()
    """What the file says of the motors; :mod:`orbit_assets.scene_files` makes actuators of it when asked."""
    home: tuple[tuple[str, float], ...] = ()
    """A joint's name and its position (rad or m) in the pose that the file names as home, for those that it names."""

    @property
    def root(self) -> Link:
        """The link that all others hang on."""
        return self.links[0]

    @cached_property
    def movable_joints(self) -> tuple[Joint, ...]:
        """The joints that have a position, in order."""
        return tuple(joint for joint in self.joints if joint.movable)

    @cached_property
    def link_names(self) -> tuple[str, ...]:
        """Names of all links, the root first."""
        return tuple(link.name for link in self.links)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the movable joints."""
        return tuple(joint.name for joint in self.movable_joints)

    @property
    def joined_links(self) -> tuple[tuple[str, str], ...]:
        """Pairs of links that a joint connects, compound joints and loops included: they never collide.

        The simple joints of a compound one connect its ends through links without mass and shapes
        (:mod:`orbit_assets.joint_models`).
        """
        above = {joint.child: joint.parent for joint in self.joints}
        between = {link.name for link in self.links if link.mass == 0 and not link.collisions}
        pairs = [(joint.parent, joint.child) for joint in self.joints]
        for parent, child in tuple(pairs):
            while parent in between and parent in above:
                parent = above[parent]
                pairs.append((parent, child))
        return (*pairs, *((loop.first, loop.second) for loop in self.loops))

    @property
    def mass(self) -> float:
        """Total mass in kg."""
        return sum(link.mass for link in self.links)

    def frame(self, name: str) -> Frame:
        """The frame of that name; a link's own name gives the link's frame.

        Raises:
            KeyError: no link or frame has that name, or it is no text.
        """
        if not isinstance(name, str):
            raise KeyError(name)
        return self._frame_of[name]

    @cached_property
    def _frame_of(self) -> dict[str, Frame]:
        links = {link.name: Frame(link.name, link.name) for link in self.links}
        return links | {frame.name: frame for frame in reversed(self.frames)}


def single_link(
    name: str, shape: Shape, mass: float, inertia: npt.ArrayLike, center_of_mass: Vector3 = (0.0, 0.0, 0.0)
) -> Articulation:
    """A rigid body with one shape, for collision and drawing alike."""
    link = Link(name, mass, center_of_mass, np.asarray(inertia, dtype=float), (shape,), (shape,))
    return Articulation(name, (link,))
