"""Robots and objects: an articulation, its pose, and what the core needs to drive and name it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from orbit_core.scene.actuators import ActuatorConfig
from orbit_core.scene.articulation import Articulation
from orbit_core.scene.pose import Pose, Vector3


@dataclass(frozen=True, kw_only=True)
class ActiveModel:
    """A force law of an object. Derive a frozen dataclass for a law of your own (:mod:`orbit_core.active`)."""

    name: str
    """Name of the law in its object."""


@dataclass(frozen=True, kw_only=True)
class MagneticSeal(ActiveModel):
    """A magnet that holds a door or a drawer shut, with a force that falls with the gap.

    ``F(g) = force / (1 + g / decay)^2`` pulls a joint towards where it is shut, g being the gap at the seal: the pull
    between poles whose circuit's reluctance is that of the iron and of the gap in series (Fitzgerald, Kingsley and
    Umans, Electric Machinery, 6th ed., sections 1.1 and 3.5). To pull it off takes the work ``force * decay``.
    """

    joint: str
    """Name of the joint that it holds."""
    force: float
    """Newtons at the seal where there is no gap."""
    decay: float = 0.004
    """Metres of gap at which the force has fallen to a quarter."""
    # With the arm a seal on a hinge has the same force law as one on a slide.
    arm: float = 1.0
    """Metres from a turning joint's axis to the seal; 1 for one that slides."""
    closed: float | None = None
    """Position in rad or m at which it is shut; None takes the joint's lower limit."""
    opens_up: bool = True
    """Whether the joint's position grows as it opens."""


@dataclass(frozen=True)
class Gripper:
    """The joints that open and close a hand, with their positions at either end.

    A position (rad or m) is of every joint, or one for each entry of ``joints``.

    Raises:
        ValueError: there are positions for more or fewer joints than ``joints`` has entries.
    """

    joints: tuple[str, ...]
    """Regular expressions over joint names (full match)."""
    open_position: float | tuple[float, ...]
    """rad or m at which the fingers are farthest apart."""
    closed_position: float | tuple[float, ...]
    """rad or m at which they meet."""

    # A missing position would shift those of all later joints.
    def __post_init__(self) -> None:
        for name, value in (("open_position", self.open_position), ("closed_position", self.closed_position)):
            if isinstance(value, tuple) and len(value) != len(self.joints):
                raise ValueError(
                    f"{name} of a gripper has {len(value)} positions for {len(self.joints)} entries of its joints: "
                    "give one for each, or one number for all"
                )


END_EFFECTOR = "end_effector"
"""Stands for the frame of a robot's first end effector, whatever it is called, where a sensor names its frame."""


@dataclass(frozen=True)
class Workspace:
    """A box of positions in the root link's frame, m, where tasks may place what a hand is to reach.

    The hand reaches every pose in it that is at most ``tilt`` from straight down about each horizontal axis and turned
    by at most ``yaw`` about the vertical.
    """

    low: Vector3 = (0.4, -0.25, 0.15)
    """Least x, y and z, m."""
    high: Vector3 = (0.65, 0.25, 0.5)
    """Greatest x, y and z, m."""
    tilt: float = 0.3
    """rad; zero for an arm of five joints, which cannot tilt its hand sideways."""
    yaw: float = 1.0
    """rad"""

    def placed(self, pose: Pose) -> Workspace:
        """Return the box in the frame in which the root has ``pose``; rotations are multiples of 90 degrees."""
        # Corners may swap under a rotation, so that each axis is sorted again.
        first, second = (pose @ Pose(self.low)).position, (pose @ Pose(self.high)).position
        x, y, z = (sorted(pair) for pair in zip(first, second, strict=True))
        return Workspace((x[0], y[0], z[0]), (x[1], y[1], z[1]), self.tilt, self.yaw)


@dataclass(frozen=True)
class Lean:
    """Lean of a hand that cannot point straight down, out from its arm: that of an arm of five joints.

    A first joint turns the arm about the root's z, two or three move the hand in the plane that this gives, and a last
    one rolls it about its approach. All lengths are in the root link's frame, which stands upright.
    """

    workspace: Workspace
    """Range that the hand reaches in this way; tilt and yaw are not used."""
    angle: float
    """rad from straight down, at the root's height."""
    rise: float
    """rad by which it leans more for each metre above."""
    pan: tuple[float, float] = (0.0, 0.0)
    """Axis of the first joint, x and y, m."""
    aside: tuple[float, float] = (0.0, 0.0)
    """Hand's frame as seen from the axis of its roll: x and y of the frame, m."""
    turn: float = 0.0
    """rad about the vertical from the arm's plane to the hand, in the middle of the roll's range."""


@dataclass(frozen=True)
class EndEffector:
    """The frame that a task moves, the joints that move it, and the gripper on it.

    ``frame`` has z out of the hand (approach) and y along the fingers' opening.
    """

    frame: str
    arm_joints: tuple[str, ...]
    """Regular expressions over joint names (full match); none where a hand stands by itself."""
    gripper: Gripper | None = None
    """Fingers that open and close; None for a bare flange or a hand of fingers."""
    finger_tips: tuple[str, ...] = ()
    """Links or frames at the ends of a hand's fingers."""
    # Optional, because it depends on the whole robot: the same arm reaches elsewhere on another base.
    workspace: Workspace | None = None
    """None: a task computes it (:func:`orbit_motion.workspace.with_workspace`)."""
    lean: Lean | None = None
    """None for a hand that points straight down wherever tasks need it."""


@dataclass(frozen=True, kw_only=True)
class JointCommands:
    """Joints of a robot that an action moves, and their range, where a task does not state them."""

    joints: tuple[str, ...]
    """Regular expressions over joint names (full match)."""
    position_scale: float | None = None
    """rad or m from home for one unit of action; None spans each joint's limits."""
    # Off by default: most policies were tuned with targets that may run ahead.
    limit_speed: bool = False
    """Whether position targets run ahead of the joints by no more than their velocity limits allow."""


@dataclass(frozen=True)
class PlanarBase:
    """Joints, by name, that carry a robot over a plane.

    ``x`` and ``y`` are prismatic along the root's axes, then comes ``yaw`` about its z.
    """

    x: str
    y: str
    yaw: str


@dataclass(frozen=True)
class DifferentialBase:
    """Two driven wheels, side by side, that carry a robot over the ground; a turning joint moves its wheel forward.

    ``left`` and ``right`` are joints by name, ``radius`` is that of both wheels and ``track`` the distance between
    where they touch the ground, m.
    """

    left: str
    right: str
    radius: float
    track: float


class RobotCategory(Enum):
    """A kind of robot; one robot may be of several."""

    ARM = "arm"
    """It has an end effector that joints move."""
    GRIPPER = "gripper"
    """It has jaws that open and close."""
    HAND = "hand"
    """It has fingers with tips."""
    MOBILE = "mobile"
    """It drives over the ground, on wheels or by joints that stand for them."""
    LEGGED = "legged"
    """It has feet."""
    HUMANOID = "humanoid"
    """It stands on two feet and has an end effector for each hand."""


@dataclass(frozen=True, kw_only=True)
class Entity:
    """An articulation in the scene.

    ``pose`` is where a reset puts the root link, in each environment's own frame; ``home`` gives joint positions at
    reset by regular expression over joint names (full match), zero or the nearest limit elsewhere.
    """

    name: str
    """Unique in the scene."""
    articulation: Articulation
    """Links and joints."""
    pose: Pose = field(default_factory=Pose)
    fixed_base: bool = False
    """True if the root link cannot move."""
    # By pattern and not by index: articulations are edited and merged after an entity is described.
    home: Mapping[str, float] = field(default_factory=dict)
    actuators: tuple[ActuatorConfig, ...] = ()
    """Drives by joint; joints without one move freely."""
    semantic_label: str = ""
    """Kind of thing in segmentation images; empty takes ``name``."""
    gravity_compensation: bool = False
    """Whether the controller of the thing cancels gravity on its links, as those of most robot arms do."""

    @property
    def alternatives(self) -> tuple[Articulation, ...]:
        """Articulations that the entity may have: environment i has the one of index i modulo their number."""
        return (self.articulation,)

    @property
    def is_free_body(self) -> bool:
        """True if it is one rigid body that is neither fixed nor has joints."""
        return not (self.fixed_base or self.articulation.joints)


@dataclass(frozen=True, kw_only=True)
class ObjectSpec(Entity):
    """A passive thing: rigid (one link) or articulated. With ``fixed_base`` its root does not move.

    ``variants`` are other rigid bodies that take the place of ``articulation`` in some environments: environment i has
    the one of index i modulo their number, ``articulation`` being the first. All are single links of one name.
    """

    variants: tuple[Articulation, ...] = ()
    active: tuple[ActiveModel, ...] = ()
    """Force laws of its own."""

    @property
    def alternatives(self) -> tuple[Articulation, ...]:
        return (self.articulation, *self.variants)


@dataclass(frozen=True, kw_only=True)
class RobotSpec(Entity):
    """An embodiment: an articulation with actuator groups."""

    end_effectors: tuple[EndEffector, ...] = ()
    """Hands; the first is the default of actions and tasks."""
    feet: tuple[str, ...] = ()
    """Frames of a legged robot where it is meant to touch the ground."""
    # Policies that walk need softer drives than those that hold a pose.
    walking_drives: tuple[ActuatorConfig, ...] = ()
    """What drives a robot that learns to walk, over ``actuators`` where both name a joint; none where those do."""
    joint_commands: JointCommands | None = None
    """None: as :func:`orbit_core.actions.joint_commands` makes it of the end effectors and feet."""
    planar_base: PlanarBase | None = None
    """Base of three joints over the floor; None without one."""
    differential_base: DifferentialBase | None = None
    """Base of two driven wheels; None without one."""
    wheels: tuple[str, ...] = ()
    """Links or frames of a mobile robot that roll on the ground."""
    licence: str = ""
    """Licence of the model, as its source states it."""
    source: str = ""
    """The package that the model comes from."""

    @property
    def has_arm(self) -> bool:
        """True if joints move the first end effector; a hand on its own has no such joints."""
        return bool(self.end_effectors and self.end_effectors[0].arm_joints)

    @property
    def end_effector(self) -> EndEffector:
        """The first end effector.

        Raises:
            ValueError: the robot has none.
        """
        if not self.end_effectors:
            raise ValueError(f"robot '{self.name}' has no end effector")
        return self.end_effectors[0]

    @property
    def base_link(self) -> str:
        """The link that carries the rest of the robot: what a planar base moves, else the root."""
        if self.planar_base is not None:
            # The yaw joint is the last of the three, so that its child carries the rest.
            return next(joint.child for joint in self.articulation.joints if joint.name == self.planar_base.yaw)
        return self.articulation.root.name

    @property
    def categories(self) -> tuple[RobotCategory, ...]:
        """Categories of the robot, derived from its end effectors, feet, wheels and planar base."""
        # Derived and not declared, so that a composed robot gets the categories of its parts.
        effectors = self.end_effectors
        holds = {
            RobotCategory.ARM: any(effector.arm_joints for effector in effectors),
            RobotCategory.GRIPPER: any(effector.gripper and not effector.finger_tips for effector in effectors),
            RobotCategory.HAND: any(effector.finger_tips for effector in effectors),
            RobotCategory.MOBILE: bool(self.planar_base or self.wheels),
            RobotCategory.LEGGED: bool(self.feet),
            RobotCategory.HUMANOID: len(self.feet) == 2 and len(effectors) >= 2,
        }
        return tuple(category for category, held in holds.items() if held)
