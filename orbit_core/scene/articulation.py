"""The one articulation description that every reader produces and every engine builds from."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property

import numpy as np
import numpy.typing as npt

from orbit_core.scene.pose import Pose, Vector3
from orbit_core.scene.shapes import Shape


class JointType(Enum):
    """How a joint lets its child link move."""

    FIXED = "fixed"
    REVOLUTE = "revolute"
    """Rotation about the axis within limits, in radians."""
    CONTINUOUS = "continuous"
    """Rotation about the axis without limits; the position counts whole turns."""
    PRISMATIC = "prismatic"
    """Translation along the axis within limits, in metres."""


@dataclass(frozen=True)
class Mimic:
    """The joint follows another: ``position = multiplier * position(joint) + offset``."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Joint:
    """Connects ``child`` to ``parent``.

    The joint frame is fixed at ``parent_pose`` in the parent link and at ``child_pose`` in the child link; the two
    coincide at position zero, and the joint moves the second along or about ``axis`` (unit vector in the joint frame).
    Efforts are N or N m, velocities m/s or rad/s, after the joint's type. ``damping`` (N s/m or N m s/rad) and
    ``friction`` (N or N m, Coulomb) are the mechanism's own, not a drive's. ``armature`` is the reflected inertia of
    the motor (kg or kg m^2).
    """

    name: str
    type: JointType
    parent: str
    child: str
    parent_pose: Pose = field(default_factory=Pose)
    child_pose: Pose = field(default_factory=Pose)
    axis: Vector3 = (0.0, 0.0, 1.0)
    lower_limit: float = -np.inf
    upper_limit: float = np.inf
    effort_limit: float = np.inf
    velocity_limit: float = np.inf
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    mimic: Mimic | None = None

    @property
    def movable(self) -> bool:
        """Whether the joint has a position."""
        return self.type is not JointType.FIXED


@dataclass(frozen=True)
class LoopJoint:
    """A ball joint that closes a kinematic loop: holds a point of one link at a point of another.

    Each point is in its link's frame. The joint has no position of its own: those of the tree's joints must satisfy it,
    at home and whenever they are written.
    """

    name: str
    first: str
    second: str
    first_point: Vector3 = (0.0, 0.0, 0.0)
    second_point: Vector3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid body.

    ``inertia`` (3, 3) in kg m^2 is about the centre of mass, in the link's axes; ``center_of_mass`` is in the link
    frame. ``semantic_label`` names the kind of thing in segmentation images; empty takes the entity's.
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
    order of every tensor on every engine. :func:`orbit_core.assets.validation.validate` checks it.
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...] = ()
    frames: tuple[Frame, ...] = ()
    self_collisions: bool = False
    """Whether links that no joint connects directly may collide with each other."""
    collision_exclusions: tuple[tuple[str, str], ...] = ()
    """Pairs of links that never collide, whatever ``self_collisions`` says."""
    notes: tuple[str, ...] = ()
    """What a reader or the catalogue changed against the source, for the build report."""
    loops: tuple[LoopJoint, ...] = ()

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
        """Pairs of links that a joint connects, loops included: they never collide."""
        tree = ((joint.parent, joint.child) for joint in self.joints)
        return (*tree, *((loop.first, loop.second) for loop in self.loops))

    @property
    def mass(self) -> float:
        """Total mass in kg."""
        return sum(link.mass for link in self.links)

    def frame(self, name: str) -> Frame:
        """The frame of that name; a link's own name gives the link's frame.

        Raises:
            KeyError: no link or frame has that name.
        """
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
