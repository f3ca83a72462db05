"""The one articulation description that every reader produces and every engine builds from: links, joints, loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from itertools import permutations
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.scene.pose import Pose, Quaternion, Vector3
from orbit_core.scene.shapes import Shape

# Principal moments of inertia, and their rounding to moments that a solid can have ------------------------------------
# No principal moment of a solid exceeds the sum of the other two. Those of a flat plate meet that bound, and their
# tensor misses it by the last digit where it is rounded downwards.

FloatArray = npt.NDArray[np.float64]

DOUBLE = 1e-12
"""Margin, as a share of the largest moment, that rounding to double precision leaves."""
SINGLE = 1e-6
"""Margin, as a share of the largest moment, that rounding to single precision leaves."""


def principal_axes(inertia: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return principal moments (3,), ascending, and the rotation (3, 3) whose columns are the principal axes."""
    moments, axes = np.linalg.eigh(np.asarray(inertia, dtype=float))
    # eigh may return a reflection; flipping one axis makes it a rotation.
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    return moments, axes


def lacking_moment(moments: npt.ArrayLike) -> float:
    """Return the excess of the largest of three principal moments over the sum of the others, which may be negative."""
    small, middle, large = np.sort(np.asarray(moments, dtype=float))
    return float(large - small - middle)


def raised_moments(moments: npt.ArrayLike, margin: float = 0.0) -> FloatArray:
    """Return principal moments (3,) of which none is negative or exceeds the sum of the other two.

    Half of what lacks is added to each of the two smaller ones; the largest stays as it is.

    Args:
        moments: (3,) ascending.
        margin: by which the sum is to exceed the largest moment, as a share of it.
    """
    small, middle, large = np.maximum(np.asarray(moments, dtype=float), 0.0)
    lacking = max(0.0, large * (1.0 + margin) - small - middle) / 2.0
    return np.array((small + lacking, middle + lacking, large))


def solid_moments(inertia: npt.ArrayLike, margin: float = DOUBLE) -> tuple[FloatArray, Pose]:
    """Return the raised principal moments (3,) of a tensor, and the rotation that takes their axes to the tensor's.

    Each axis is the one nearest to the tensor's own, so that a diagonal tensor needs no rotation.

    Args:
        inertia: (3, 3) symmetric.
        margin: as of :func:`raised_moments`: the precision in which the moments are written or compared.
    """
    moments, axes = principal_axes(inertia)
    near = np.abs(axes)
    # eigh sorts by size; this order keeps the axes of a tensor that is diagonal already.
    order = max(permutations(range(3)), key=lambda columns: near[(0, 1, 2), columns].sum())
    axes = axes[:, order]
    axes = axes * np.where(np.diag(axes) < 0.0, -1.0, 1.0)
    if np.linalg.det(axes) < 0:
        axes[:, np.argmin(np.diag(axes))] *= -1.0
    return raised_moments(moments, margin)[list(order)], Pose.from_matrix(axes)


class JointType(Enum):
    """Kinds of joints, by the motion of the child link."""

    FIXED = "fixed"
    """No motion: the child is welded to the parent."""
    REVOLUTE = "revolute"
    """Rotation about the axis within limits, in radians."""
    CONTINUOUS = "continuous"
    """Rotation about the axis without limits; the position counts whole turns."""
    PRISMATIC = "prismatic"
    """Translation along the axis within limits, in metres."""


@dataclass(frozen=True)
class Mimic:
    """The joint follows another: ``position = offset + multiplier * x + higher_powers[0] * x^2 + ...``.

    ``x`` is the position of ``joint``, the leader. ``higher_powers`` are the coefficients of its square, its cube and
    its fourth power, three at most; without them the law is linear.
    """

    joint: str
    multiplier: float = 1.0
    """Position of this joint for a unit of the leader's."""
    offset: float = 0.0
    """Position of this joint where the leader's is zero, rad or m."""
    higher_powers: tuple[float, ...] = ()

    @property
    def linear(self) -> bool:
        """True if the follower moves in proportion to its leader."""
        return not any(self.higher_powers)

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Coefficients of the leader's powers, from the zeroth on."""
        return (self.offset, self.multiplier, *self.higher_powers)

    def position(self, leader: Any) -> Any:
        """Return the follower's position where the leader is at ``leader``: a number, an array or a tensor."""
        return _polynomial(self.coefficients, leader)

    def slope(self, leader: Any) -> Any:
        """Return velocity of the follower per unit of the leader's, where the leader is at ``leader``."""
        return _polynomial([power * factor for power, factor in enumerate(self.coefficients)][1:], leader)


def _polynomial(coefficients: Sequence[float], x: Any) -> Any:
    """Evaluate a polynomial by Horner's scheme; the result has the shape of ``x``."""
    # Multiplying by x keeps its type, shape and device, whether it is a number, an array or a tensor.
    value = x * 0.0 + coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        value = value * x + coefficient
    return value


@dataclass(frozen=True)
class Joint:
    """Connects ``child`` to ``parent``.

    The joint frame is fixed at ``parent_pose`` in the parent link and at ``child_pose`` in the child link; the two
    coincide at position zero, and the joint moves the second along or about ``axis`` (unit vector in the joint frame).
    Efforts are N or N m, velocities m/s or rad/s, after the joint's type.

    ``damping`` (N s/m or N m s/rad), ``friction`` (N or N m, Coulomb) and the spring are the mechanism's own, not a
    drive's. The spring's effort is ``-stiffness * (position - rest_position)``, ``stiffness`` in N/m or N m/rad,
    ``rest_position`` in m or rad; effort limits do not bound it. ``armature`` is the reflected inertia of the motor
    (kg or kg m^2).
    """

    name: str
    """Unique among the articulation's joints."""
    type: JointType
    """Motion of the child link."""
    parent: str
    child: str
    # Two poses, as in USD, so that neither link frame has to be at the joint.
    parent_pose: Pose = field(default_factory=Pose)
    child_pose: Pose = field(default_factory=Pose)
    axis: Vector3 = (0.0, 0.0, 1.0)
    # Infinite means unlimited; readers never invent a limit that the file does not state.
    lower_limit: float = -np.inf
    """rad or m; positions stop there."""
    upper_limit: float = np.inf
    """rad or m."""
    effort_limit: float = np.inf
    """N m or N of actuators, either way."""
    velocity_limit: float = np.inf
    """rad/s or m/s, either way."""
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    # Fields that not every file format has come last, with the value that has no effect.
    mimic: Mimic | None = None
    """Law by which the joint follows another; None for a joint that moves freely."""
    stiffness: float = 0.0
    rest_position: float = 0.0

    @property
    def movable(self) -> bool:
        """True if the joint has a position."""
        return self.type is not JointType.FIXED


class LoopType(Enum):
    """Kinds of joints that close a loop, by what they constrain."""

    BALL = "ball"
    """A point of one link at a point of the other."""
    WELD = "weld"
    """The point, and the second link's orientation in the first."""


@dataclass(frozen=True)
class LoopJoint:
    """Closes a kinematic loop: holds a point of one link at a point of another, and a weld their orientation too.

    Each point is in its link's frame; ``orientation`` (w, x, y, z) is the second link's in the first and counts for a
    weld alone. The joint has no position: the positions of the tree's joints must satisfy it, at home and whenever
    they are written.
    """

    name: str
    """Unique among the articulation's joints and loops."""
    first: str
    """Link that the second is held to."""
    second: str
    """Link that is held."""
    first_point: Vector3 = (0.0, 0.0, 0.0)
    """m, in the first link's frame."""
    second_point: Vector3 = (0.0, 0.0, 0.0)
    """m, in the second link's frame."""
    type: LoopType = LoopType.BALL
    """Freedom that the closure leaves: a ball joint turns freely."""
    orientation: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class DriveGains:
    """Gains of the drive on ``joint`` as a file states them; no actuator uses them until a program makes one of them.

    The effort is ``stiffness * (target - position) + damping * (target velocity - velocity)``, at most
    ``effort_limit`` (N or N m); stiffness is N/m or N m/rad, damping N s/m or N m s/rad. With both zero the drive is a
    plain motor.
    """

    joint: str
    stiffness: float = 0.0
    """N m/rad or N/m."""
    damping: float = 0.0
    """N m s/rad or N s/m."""
    effort_limit: float = np.inf


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid body.

    ``inertia`` (3, 3) in kg m^2 is about the centre of mass, in the link's axes; ``center_of_mass`` is in the link
    frame. ``semantic_label`` names the kind of thing in segmentation images; empty takes the entity's. A link without
    mass and inertia may be the root of a fixed base, or stand between two joints of a tree, as those of a compound
    joint do (:mod:`orbit_assets.joint_models`).
    """

    name: str
    """Unique among the articulation's links."""
    mass: float = 0.0
    """kg."""
    center_of_mass: Vector3 = (0.0, 0.0, 0.0)
    # An array as default would be shared between instances, which a factory avoids.
    inertia: npt.NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 3)))
    collisions: tuple[Shape, ...] = ()
    """Shapes that collide, in the link's frame."""
    visuals: tuple[Shape, ...] = ()
    """Shapes that cameras and viewers draw, in the link's frame."""
    semantic_label: str = ""


@dataclass(frozen=True)
class Frame:
    """A named frame fixed to a link: a tool centre point, a sensor's mount, a link merged away."""

    name: str
    """Unique among the articulation's links and frames."""
    link: str
    """Link that carries it."""
    pose: Pose = field(default_factory=Pose)
    """Pose in the link's frame."""


@dataclass(frozen=True, eq=False)
class Articulation:
    """A tree of links, and joints that close loops in it. A rigid object is an articulation with one link.

    Links stand in topological order, the root first, and joints in the order of their child links; this order is the
    order of every tensor on every engine. :func:`orbit_core.preparation.validation.validate` checks it.
    """

    name: str
    """Name of the model."""
    links: tuple[Link, ...]
    """Bodies, the root first."""
    joints: tuple[Joint, ...] = ()
    """One for each link but the root."""
    frames: tuple[Frame, ...] = ()
    """Named frames on links."""
    self_collisions: bool = False
    """Whether links that no joint connects (:attr:`joined_links`) may collide with each other."""
    collision_exclusions: tuple[tuple[str, str], ...] = ()
    """Pairs of links that never collide, whatever ``self_collisions`` says."""
    notes: tuple[str, ...] = ()
    """What a reader or the catalogue changed against the source, for the build report."""
    loops: tuple[LoopJoint, ...] = ()
    """Closures of kinematic loops, in addition to the tree's joints."""
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
        # A compound joint is a chain of simple ones: its ends touch each other although no single joint connects them.
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
        """Return the frame of that name; a link's own name gives the link's frame.

        Raises:
            KeyError: no link or frame has that name, or it is no text.
        """
        # A pattern or a tuple would raise a TypeError where it cannot be hashed; all wrong names raise the same error.
        if not isinstance(name, str):
            raise KeyError(name)
        return self._frame_of[name]

    @cached_property
    def _frame_of(self) -> dict[str, Frame]:
        # Named frames win over links, and the first of two frames of one name over the second.
        links = {link.name: Frame(link.name, link.name) for link in self.links}
        return links | {frame.name: frame for frame in reversed(self.frames)}


def single_link(
    name: str, shape: Shape, mass: float, inertia: npt.ArrayLike, center_of_mass: Vector3 = (0.0, 0.0, 0.0)
) -> Articulation:
    """Return a rigid body with one shape, for collision and drawing alike."""
    link = Link(name, mass, center_of_mass, np.asarray(inertia, dtype=float), (shape,), (shape,))
    return Articulation(name, (link,))
