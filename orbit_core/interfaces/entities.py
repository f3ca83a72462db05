"""Entities of a world: robots, objects, deformables and markers, simulated, recorded or real."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from functools import cached_property, partial
from types import MappingProxyType
from typing import Protocol

from torch import Tensor

from orbit_core.interfaces.errors import UnsupportedCapabilityError
from orbit_core.interfaces.names import match_names
from orbit_core.scene import DeformableSpec, Entity, Joint, MarkerSpec, Region, RobotSpec, Texture


# A protocol, because the classes that compute these laws are above the contract.
class ActivePart(Protocol):
    """One of an object's active models (:mod:`orbit_core.active`), which adds forces at each step."""

    @property
    def parameters(self) -> Mapping[str, Tensor]:
        """Values (N,) of each parameter, by name."""
        ...

    @property
    def nominal(self) -> Mapping[str, float]:
        """Each parameter's value in the scene, by name."""
        ...

    def set_parameter(self, name: str, values: Tensor, env_ids: Tensor | None = None) -> None:
        """Set (n,) values of a parameter; they outlast resets."""
        ...


class Object(ABC):
    """An articulation in N environments; a rigid object is one with a single link.

    Poses are (..., 7): position, quaternion (w, x, y, z); velocities (..., 6): linear of the frame's origin, then
    angular, world axes. Tensors read are valid until the next step or write: clone what you keep.
    """

    name: str
    """Name in the scene."""
    link_names: tuple[str, ...]
    """Names of the links, in the order of all tensors."""
    joint_names: tuple[str, ...]
    """Names of the movable joints, in the order of all tensors."""

    @property
    @abstractmethod
    def spec(self) -> Entity:
        """Specification that the entity was made from."""

    # Reading

    @property
    @abstractmethod
    def root_pose(self) -> Tensor:
        """Pose (N, 7) of the root link."""

    @property
    @abstractmethod
    def root_velocity(self) -> Tensor:
        """Velocity (N, 6) of the root link."""

    @property
    @abstractmethod
    def link_poses(self) -> Tensor:
        """Link poses (N, links, 7)."""

    @property
    @abstractmethod
    def link_velocities(self) -> Tensor:
        """Link velocities (N, links, 6)."""

    @property
    @abstractmethod
    def joint_positions(self) -> Tensor:
        """Joint positions (N, joints), rad or m."""

    @property
    @abstractmethod
    def joint_velocities(self) -> Tensor:
        """Joint velocities (N, joints), rad/s or m/s."""

    @property
    @abstractmethod
    def joint_efforts(self) -> Tensor:
        """Efforts (N, joints) of drives and commands over the last physics step after limits, N m or N."""

    @abstractmethod
    def frame_pose(self, name: str) -> Tensor:
        """Return (N, 7) of a link or named frame."""

    def frame_position(self, name: str) -> Tensor:
        """Return (N, 3) of a link or named frame's origin, m; it costs less than the pose."""
        return self.frame_pose(name)[:, :3]

    @abstractmethod
    def frame_velocity(self, name: str) -> Tensor:
        """Return (N, 6) of a link or named frame."""

    @abstractmethod
    def jacobian(self, frame: str, joints: Sequence[int] | None = None) -> Tensor:
        """Return the geometric Jacobian of a link or named frame.

        Args:
            frame: name of the link or frame.
            joints: that give the columns; all movable joints if None.

        Returns:
            (N, 6, k) linear, then angular, in world axes.
        """

    # Looking up

    def find_joints(self, *patterns: str) -> list[int]:
        """Return indices of the joints whose names a regular expression matches in full, in joint order."""
        return match_names(patterns, self.joint_names, "joint", f"'{self.name}'")

    def find_links(self, *patterns: str) -> list[int]:
        """Return indices of the links whose names a regular expression matches in full, in link order."""
        return match_names(patterns, self.link_names, "link", f"'{self.name}'")

    @property
    def joints(self) -> tuple[Joint, ...]:
        """The movable joints' descriptions."""
        # Fixed joints have no position and no column in any tensor.
        return self.spec.articulation.movable_joints

    @property
    @abstractmethod
    def home_positions(self) -> Tensor:
        """Joint positions (joints,) at reset, rad or m."""

    @property
    @abstractmethod
    def position_limits(self) -> Tensor:
        """Lower and upper position limits (joints, 2), rad or m."""

    # Writing state

    @abstractmethod
    def set_root_pose(self, pose: Tensor, env_ids: Tensor | None = None) -> None:
        """Set the root link's pose (n, 7)."""

    @abstractmethod
    def set_root_velocity(self, velocity: Tensor, env_ids: Tensor | None = None) -> None:
        """Set the root link's velocity (n, 6)."""

    @abstractmethod
    def set_joint_state(
        self,
        positions: Tensor | None = None,
        velocities: Tensor | None = None,
        joints: Sequence[int] | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        """Set positions and velocities (n, k) of some joints; position targets follow the positions."""

    # Parameters per environment; they outlast resets. Only simulated entities have them.

    # Immutable, since it is shared by all instances without active models.
    active: Mapping[str, ActivePart] = MappingProxyType({})
    """The object's active models, by name."""

    @cached_property
    def nominal_masses(self) -> Tensor:
        """Masses (N, links) of the scene in kg; :meth:`set_masses` does not change them.

        Raises:
            UnsupportedCapabilityError: as all parameters do where there are none to set.
        """
        # An error and no abstract method, as recorded and real worlds have no masses to change.
        raise self._unsupported("nominal masses")

    @cached_property
    def nominal_gains(self) -> Mapping[int, tuple[float, float]]:
        """Stiffness and damping in the scene, by joint, of those that have an actuator."""
        raise self._unsupported("nominal gains")

    def set_masses(self, masses: Tensor, links: Sequence[int] | None = None, env_ids: Tensor | None = None) -> None:
        """Set masses (n, k) in kg of some links; inertias scale with them."""
        raise self._unsupported("masses to set")

    def set_centers_of_mass(
        self, centers: Tensor, links: Sequence[int] | None = None, env_ids: Tensor | None = None
    ) -> None:
        """Set centres of mass (n, k, 3) of some links, in their own frames."""
        raise self._unsupported("centres of mass to set")

    def set_friction(
        self, coefficients: Tensor, links: Sequence[int] | None = None, env_ids: Tensor | None = None
    ) -> None:
        """Set friction (n, k), static and dynamic alike, of all shapes of some links."""
        raise self._unsupported("friction to set")

    def set_joint_parameters(
        self,
        damping: Tensor | None = None,
        friction: Tensor | None = None,
        armature: Tensor | None = None,
        stiffness: Tensor | None = None,
        joints: Sequence[int] | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        """Set parameters of the mechanism of joints; None leaves one as it is.

        Args:
            damping: (n, k) N s/m or N m s/rad.
            friction: (n, k) Coulomb friction, N or N m.
            armature: (n, k) kg or kg m^2.
            stiffness: (n, k) of springs, N/m or N m/rad.
            joints: (k,) indices; all movable joints if None.
            env_ids: indices (n,) or a mask (N,) bool; all if None.
        """
        raise self._unsupported("joint parameters to set")

    def set_joint_limits(
        self, lower: Tensor, upper: Tensor, joints: Sequence[int] | None = None, env_ids: Tensor | None = None
    ) -> None:
        """Set limits (n, k) in rad or m that some joints stop at; :attr:`position_limits` stay the scene's."""
        raise self._unsupported("joint limits to set")

    def set_colors(self, colors: Tensor, links: Sequence[int] | None = None, env_ids: Tensor | None = None) -> None:
        """Set red, green and blue (n, k, 3) in [0, 1] of all shapes of some links, in pictures."""
        raise self._unsupported("colours to set")

    def set_textures(
        self,
        textures: Sequence[Texture],
        chosen: Tensor,
        links: Sequence[int] | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        """Give all shapes of some links one of ``textures`` each, by index (n, k) int64; -1 takes it away."""
        raise self._unsupported("textures to set")

    def set_wrenches(self, wrenches: Tensor, links: Sequence[int] | None = None, env_ids: Tensor | None = None) -> None:
        """Set force at the centre of mass and torque, (n, k, 6), world axes, on some links until set again or reset."""
        raise self._unsupported("wrenches to set")

    def set_gains(
        self, stiffness: Tensor, damping: Tensor, joints: Sequence[int] | None = None, env_ids: Tensor | None = None
    ) -> None:
        """Set stiffness and damping (n, k) of the actuators of some joints, implicit and explicit alike."""
        raise self._unsupported("gains to set")

    # One sentence for all: the user has to choose another kind of world, whichever call failed.
    def _unsupported(self, what: str) -> UnsupportedCapabilityError:
        return UnsupportedCapabilityError(f"'{self.name}' has no {what}: {type(self).__name__} provides none")


class JointTarget(StrEnum):
    """Quantity that is commanded to a joint; the value names the port that carries it, (N, k) for k joints."""

    POSITION = "position_targets"
    """rad or m."""
    VELOCITY = "velocity_targets"
    """rad/s or m/s."""
    EFFORT = "effort_targets"
    """N m or N."""


class Robot(Object):
    """An articulation with actuator groups that take commands."""

    @property
    @abstractmethod
    def spec(self) -> RobotSpec:
        """Specification that the entity was made from."""

    @property
    def motor_temperatures(self) -> Tensor:
        """Temperatures (N, J) of the motors' windings in degrees Celsius, 25 for motors without windings.

        Raises:
            ConfigurationError: no motor has windings.
        """
        raise self._unsupported("motor temperatures")

    @abstractmethod
    def set_position_targets(self, targets: Tensor, joints: Sequence[int] | None = None) -> None:
        """Set position targets (N, k), rad or m."""

    @abstractmethod
    def set_velocity_targets(self, targets: Tensor, joints: Sequence[int] | None = None) -> None:
        """Set velocity targets (N, k), rad/s or m/s."""

    @abstractmethod
    def set_effort_targets(self, efforts: Tensor, joints: Sequence[int] | None = None) -> None:
        """Set effort targets (N, k), N m or N, which are added to the actuators' PD law."""

    def target_writer(
        self, target: JointTarget, joints: Sequence[int], checked: bool = True
    ) -> Callable[[Tensor], object]:
        """Return a function that writes targets (N, k) of some joints.

        A controller makes one when it is built, so that a step looks up no joints.

        Args:
            target: quantity that is written.
            joints: indices (k,).
            checked: False for targets that the caller has just clamped: float32, finite and on the device. A world may
                then skip its checks.
        """
        setter = {
            JointTarget.POSITION: self.set_position_targets,
            JointTarget.VELOCITY: self.set_velocity_targets,
            JointTarget.EFFORT: self.set_effort_targets,
        }[target]
        return partial(setter, joints=joints)


class Deformable(ABC):
    """Cloth, rope, a soft body or a fluid in N environments: P particles, one at each vertex or point of its spec.

    Tensors read are valid until the next step or write: clone what you keep.
    """

    name: str
    """Name in the scene."""
    spec: DeformableSpec
    """Description in the scene."""

    @property
    @abstractmethod
    def positions(self) -> Tensor:
        """Positions (N, P, 3) in m, in the environment's world frame."""

    @property
    @abstractmethod
    def velocities(self) -> Tensor:
        """Velocities (N, P, 3) in m/s."""

    @abstractmethod
    def set_state(self, positions: Tensor, velocities: Tensor | None = None, env_ids: Tensor | None = None) -> None:
        """Set positions (n, P, 3) and velocities (n, P, 3) of the particles; at rest if no velocities are given.

        Raises:
            UnsupportedCapabilityError: the engine cannot set velocities of particles, or particles at all.
        """

    @abstractmethod
    def anchor(self, points: Sequence[int], to: tuple[str, str] | None = None, env_ids: Tensor | None = None) -> None:
        """Hold particles where they now are, until released; resets keep them held, from the initial state on.

        Args:
            points: indices of particles.
            to: names of a robot or an object and of its link, which then carries them; the world if None.
            env_ids: indices (n,) or a mask (N,) bool; all environments if None.

        Raises:
            UnknownNameError: no such robot, object or link.
            UnsupportedCapabilityError: the engine holds no particles.
        """

    @abstractmethod
    def release(self, points: Sequence[int] | None = None, env_ids: Tensor | None = None) -> None:
        """Release particles that :meth:`anchor` holds, all of them if ``points`` is None; others are left as they are.

        Raises:
            UnsupportedCapabilityError: the engine holds no particles.
        """

    # Derived from positions

    @property
    def key_points(self) -> Tensor:
        """Positions (N, K, 3) of the spec's key points, in its order."""
        # Derived quantities have no default: a solver may compute them more cheaply than from positions.
        raise self._unsupported("key points")

    def key_point(self, name: str) -> Tensor:
        """Return the position (N, 3) of a key point.

        Raises:
            UnknownNameError: there is none of that name.
        """
        raise self._unsupported("key points")

    @property
    def covered_area(self) -> Tensor:
        """Area (N,) in m^2 that a cloth covers seen from above, layers counted once."""
        raise self._unsupported("covered area")

    def share_inside(self, region: Region) -> Tensor:
        """Return the share (N,) of the particles that is in a box, in [0, 1].

        Raises:
            UnknownNameError: there is no such entity, link or frame.
        """
        raise self._unsupported("share inside a region")

    # Forces and parameters. Only deformables of a matter solver have them.

    def contact_force(self, entity: str, link: str) -> Tensor:
        """Return the force (N, 3) that it exerts on a link: newtons, world axes, mean of the last physics step.

        Raises:
            UnknownNameError: no such robot, object or link.
            UnsupportedCapabilityError: the engine does not report it.
        """
        raise self._unsupported("contact forces")

    def contact_pressure(self, entity: str, link: str) -> Tensor:
        """Return the mean pressure (N,) in Pa of its contact with a link: normal force over area, last physics step.

        Raises:
            UnknownNameError: no such robot, object or link.
            UnsupportedCapabilityError: the engine does not report it, or it is no soft body.
        """
        raise self._unsupported("contact pressures")

    def set_parameter(self, name: str, values: Tensor, env_ids: Tensor | None = None) -> None:
        """Set one of ``"density"``, ``"stiffness"``, ``"bending"`` (scales of the spec's) and ``"friction"``, (n,).

        It outlasts resets.

        Raises:
            UnknownNameError: there is no such parameter.
            UnsupportedCapabilityError: the engine has one value for all.
        """
        raise self._unsupported("parameters to set")

    def _unsupported(self, what: str) -> UnsupportedCapabilityError:
        return UnsupportedCapabilityError(f"'{self.name}' has no {what}: {type(self).__name__} provides none")


class Marker(ABC):
    """Something drawn for people, with no physics."""

    spec: MarkerSpec
    """Description in the scene."""

    @property
    @abstractmethod
    def pose(self) -> Tensor:
        """Pose (N, 7) of the marker."""

    @abstractmethod
    def set_pose(self, pose: Tensor, env_ids: Tensor | None = None) -> None:
        """Set the pose (n, 7)."""
