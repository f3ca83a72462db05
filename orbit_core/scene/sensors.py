"""Specifications of sensors: quantity, rate, delay and noise."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from orbit_core.scene.pose import Pose, Vector3


@dataclass(frozen=True)
class Noise:
    """Additive noise: white of deviation ``std``, and a constant ``bias`` drawn at each reset with ``bias_std``."""

    std: float = 0.0
    bias_std: float = 0.0


@dataclass(frozen=True, kw_only=True)
class SensorSpec:
    """A timed measurement. ``rate`` in Hz must divide the physics rate; ``None`` measures whenever the world steps.

    ``delay`` in seconds, a multiple of the sensor's period, holds measurements back.
    """

    name: str
    """Unique among the scene's sensors."""
    # None is lazy: the sensor measures at the first read after a step, and costs nothing unread.
    rate: float | None = None
    delay: float = 0.0
    noise: Noise = field(default_factory=Noise)
    """White noise and a bias that each episode draws."""

    @property
    def contacts(self) -> tuple[ContactSensorSpec, ...]:
        """Contact forces that the sensor measures, which the engine must report; none by default."""
        return ()


@dataclass(frozen=True, kw_only=True)
class JointSensorSpec(SensorSpec):
    """Joint positions and velocities of an entity."""

    entity: str
    """Name of the robot or object."""
    # All joints by default, as encoders usually cover a whole robot.
    joints: tuple[str, ...] = (".*",)
    """Regular expressions over joint names (full match)."""


@dataclass(frozen=True, kw_only=True)
class FrameSensorSpec(SensorSpec):
    """Pose and velocity of a link or named frame, in the environment's frame or in that of ``relative_to``."""

    entity: str
    """Name of the robot or object."""
    frame: str
    """Link or named frame that is measured."""
    relative_to: str | None = None
    """A link or frame of the same entity."""


@dataclass(frozen=True, kw_only=True)
class ContactSensorSpec(SensorSpec):
    """Net contact force on each link matched by ``links``, in world axes, averaged over the sensor's period.

    ``filters`` names entities; each adds the force that this entity alone exerts. ``"terrain"`` means the terrain.
    """

    entity: str
    """Name of the robot or object."""
    links: tuple[str, ...] = (".*",)
    # Without filters an engine measures net forces only, which all of them have at no cost per pair.
    filters: tuple[str, ...] = ()

    @property
    def contacts(self) -> tuple[ContactSensorSpec, ...]:
        """The sensor's own forces."""
        return (self,)


@dataclass(frozen=True, kw_only=True)
class TactileSpec(ContactSensorSpec):
    """A rectangular pad of taxels on a link, as soft as a gel.

    It feels the contact force on the link that carries ``frame``, or the part of it that the entities in ``filters``
    exert. The pad is flat, its middle at ``pose`` in the frame, z outwards. Columns of taxels run along x, rows along
    y.

    Raises:
        ValueError: a size, a number of taxels or a constant is out of its range.
    """

    frame: str
    pose: Pose = field(default_factory=Pose)
    """Pose of the pad's middle in the frame."""
    size: tuple[float, float] = (0.02, 0.02)
    """Full extent along x and y, m."""
    taxels: tuple[int, int] = (16, 16)
    """Columns along x and rows along y."""
    young: float = 2.0e5
    """Modulus of elasticity of the gel, Pa; the default is a soft silicone's."""
    poisson: float = 0.48
    """Poisson's ratio of the gel."""
    friction: float = 0.8
    """Coefficient of friction by which shear is shared between taxels that stick and those that slip."""
    reach: float = 0.004
    """Metres in front of the pad and behind it within which a surface counts as touching."""
    shear: bool = False
    """True to require shear: an engine that reports contact forces without friction refuses the scene."""

    def __post_init__(self) -> None:
        lengths = (*self.size, self.young, self.friction, self.reach)
        # A ratio of 0.5 is a gel that keeps its volume; negative ones are no gel.
        if min(lengths) <= 0.0 or not 0.0 <= self.poisson <= 0.5 or min(self.taxels) < 2 or max(self.taxels) > 64:
            raise ValueError(
                f"tactile sensor '{self.name}' has size {self.size} m, taxels {self.taxels}, young {self.young} Pa, "
                f"poisson {self.poisson}, friction {self.friction} and reach {self.reach} m: give numbers above zero, "
                "2 to 64 taxels a side, and poisson from 0 to 0.5"
            )


@dataclass(frozen=True, kw_only=True)
class ImuSpec(SensorSpec):
    """Angular velocity and proper acceleration of a frame, in its own axes."""

    entity: str
    """Name of the robot or object."""
    frame: str
    """Link or named frame that carries it."""


@dataclass(frozen=True, kw_only=True)
class ForceTorqueSpec(SensorSpec):
    """The wrench that a link receives from its parent through the joint between them.

    Force (N) and torque (N m) about the link frame's origin, in the link's axes. For a root link with a fixed base the
    parent is the world. What holds an entity up whose gravity is compensated acts on each of its links, so that its
    joints do not bear its weight.
    """

    entity: str
    """Name of the robot or object."""
    link: str
    """Link whose incoming joint is measured."""


@dataclass(frozen=True, kw_only=True)
class RayCasterSpec(SensorSpec):
    """Distances along a pattern of rays from a frame.

    ``directions`` (R) are in the sensor frame; ``origins`` (R) default to its origin. ``yaw_only`` keeps the pattern
    level as a height scan needs, turning with the frame's heading alone.
    """

    entity: str
    """Name of the robot or object."""
    frame: str
    """Link or named frame that carries it."""
    directions: tuple[Vector3, ...]
    origins: tuple[Vector3, ...] = ()
    pose: Pose = field(default_factory=Pose)
    """Pose of the sensor in the frame."""
    max_distance: float = 10.0
    """m; a ray that meets nothing nearer shows it."""
    yaw_only: bool = False


class Channel(Enum):
    """One kind of image. Shapes are (num_envs, height, width, channels)."""

    RGB = "rgb"
    """uint8, 3 channels."""
    DEPTH = "depth"
    """float32, 1 channel, metres along the optical axis; infinite where nothing is seen."""
    POSITION = "position"
    """float32, 3 channels, metres: where the surface is, in the environment's frame; infinite where nothing is seen."""
    NORMALS = "normals"
    """float32, 3 channels, unit surface normals in world axes; zero where nothing is seen."""
    ALBEDO = "albedo"
    """uint8, 3 channels: the surface's own colour, whatever light falls on it; black where nothing is seen."""
    INSTANCE = "instance"
    """int32, 1 channel: the index of the entity in the scene; -1 background, -2 terrain."""
    SEMANTIC = "semantic"
    """int32, 1 channel: the index of the semantic label in the world's label list; -1 background."""


@dataclass(frozen=True, kw_only=True)
class CameraSpec(SensorSpec):
    """A pinhole camera: -z forward, y up in its own frame (the convention of USD and OpenGL).

    ``pose`` is in the environment's frame, or in that of ``frame`` of ``entity`` where these are given.
    """

    width: int = 128
    """Columns, pixels."""
    height: int = 128
    """Rows, pixels."""
    vertical_fov: float = 0.9
    """Radians."""
    channels: tuple[Channel, ...] = (Channel.RGB,)
    """Images that are taken; colour only by default."""
    pose: Pose = field(default_factory=Pose)
    entity: str | None = None
    frame: str | None = None
    # The near plane sets the depth resolution of rasterisers: with 24 bits, 1 cm resolves 6 micrometres at 1 m.
    near: float = 0.01
    """m along the optical axis; nearer surfaces are not drawn."""
    far: float = 100.0
    """m along the optical axis; farther surfaces are not drawn."""


@dataclass(frozen=True, kw_only=True)
class RayCameraSpec(CameraSpec):
    """A camera whose pixels are rays against collision shapes, cast by the engine: no renderer draws it.

    It has depth, positions, normals and segmentation. Rays pass through the link that carries the camera, and see what
    the engine collides with, which may differ from what is drawn.

    Raises:
        ValueError: a channel is a colour, which rays do not see.
    """

    channels: tuple[Channel, ...] = (Channel.DEPTH,)
    """Images that are taken; depth only by default."""

    def __post_init__(self) -> None:
        if {Channel.RGB, Channel.ALBEDO} & {*self.channels}:
            raise ValueError(
                f"ray camera '{self.name}' sees no colours: give channels of depth, position, normals, instance and "
                "semantic, or a CameraSpec"
            )


@dataclass(frozen=True, kw_only=True)
class EventCameraSpec(CameraSpec):
    """A camera that reports changes of brightness: the logarithm's steps of ``threshold`` since the last measurement.

    Raises:
        ValueError: the threshold is not above zero, the camera has other channels than colour, or noise.
    """

    threshold: float = 0.2
    """Change of the natural logarithm of brightness that makes an event."""

    def __post_init__(self) -> None:
        if not self.threshold > 0.0 or self.channels != (Channel.RGB,) or self.noise != Noise():
            raise ValueError(
                f"event camera '{self.name}' has a threshold of {self.threshold:g}, channels "
                f"{[channel.value for channel in self.channels]} and noise {self.noise}: give a threshold above zero, "
                "the colour channel only, and no noise"
            )
