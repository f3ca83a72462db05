"""Layout of a scene in the flat tensors that core and engine share, and the model that an engine built of it.

All links of a scene are numbered through, and so are all movable joints: entity by entity in the scene's order, within
an entity in the articulation's order. An engine then moves one tensor per kind of state for any scene.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError
from orbit_core.interfaces.names import find_name, match_names, match_values
from orbit_core.scene import (
    ActuatorConfig,
    ContactSensorSpec,
    DcMotor,
    Entity,
    ForceTorqueSpec,
    Gripper,
    ImplicitPd,
    Joint,
    RobotSpec,
    Scene,
)
from orbit_core.scene.articulation import Link

TERRAIN = -2
"""Index of the terrain where a link index is expected."""
BACKGROUND = -1
"""Index of the background where a link index is expected."""


@dataclass(frozen=True, eq=False)
class EntityLayout:
    """One entity's place: its index and its ranges of links and movable joints."""

    index: int
    """Number of the entity: robots first, then objects."""
    spec: Entity
    """Description in the scene."""
    links: slice
    """Columns of its links in (N, L, ...) tensors."""
    joints: slice
    """Columns of its movable joints in (N, J) tensors."""

    @property
    def root_link(self) -> int:
        """Index of the entity's root link."""
        return self.links.start

    @property
    def name(self) -> str:
        """Name of the entity in the scene."""
        return self.spec.name


@dataclass(frozen=True)
class ContactQuery:
    """The net contact force on ``link`` that the links of ``others`` exert; ``None`` means everything.

    ``others`` may hold :data:`TERRAIN`.
    """

    link: int
    # A frozen set makes equal queries equal, so that sensors share them.
    others: frozenset[int] | None = None


@dataclass(frozen=True, eq=False)
class JointParameters:
    """Per movable joint (J,), after the actuator groups' overrides. Infinite means unlimited."""

    lower_limit: npt.NDArray[np.float64]
    """rad or m."""
    upper_limit: npt.NDArray[np.float64]
    """rad or m."""
    effort_limit: npt.NDArray[np.float64]
    """N m or N."""
    velocity_limit: npt.NDArray[np.float64]
    """rad/s or m/s."""
    damping: npt.NDArray[np.float64]
    """Viscous damping of the mechanism, N m s/rad or N s/m."""
    friction: npt.NDArray[np.float64]
    """Coulomb friction of the mechanism, N m or N."""
    armature: npt.NDArray[np.float64]
    """Reflected inertia of the motor, kg m^2 or kg."""
    spring_stiffness: npt.NDArray[np.float64]
    """Stiffness of the mechanism's own spring, N/m or N m/rad."""
    spring_rest: npt.NDArray[np.float64]
    """Position at which the spring exerts nothing, rad or m."""
    drive_stiffness: npt.NDArray[np.float64]
    """Gain of the engine's own drive; zero where the core computes the effort."""
    drive_damping: npt.NDArray[np.float64]
    """The same for velocities, N m s/rad or N s/m."""
    home: npt.NDArray[np.float64]
    """Position at reset."""


@dataclass(frozen=True, eq=False)
class SceneLayout:
    """Numbering of one scene, and the measurements that the engine must take in it."""

    scene: Scene
    """Scene that is numbered."""
    entities: tuple[EntityLayout, ...]
    """Robots, then objects, each with its ranges."""
    contact_queries: tuple[ContactQuery, ...]
    """Contact forces that sensors need."""
    wrench_links: tuple[int, ...]
    """Links whose incoming joint wrench is measured."""
    joint_parameters: JointParameters
    """Parameters of all movable joints."""

    @staticmethod
    def of(scene: Scene) -> SceneLayout:
        """Build the layout of a scene.

        Raises:
            ConfigurationError: two entities or sensors share a name, or two actuator groups a joint.
            UnknownNameError: a sensor, actuator group or home position names what the scene lacks.
        """
        _refuse_duplicates("entity", [entity.name for entity in scene.entities])
        _refuse_duplicates("sensor", [sensor.name for sensor in scene.sensors])
        entities = _number(scene.entities)
        by_name = {entity.name: entity for entity in entities}
        return SceneLayout(
            scene, entities, _contact_queries(scene, by_name), _wrench_links(scene, by_name), _parameters(entities)
        )

    @cached_property
    def variants(self) -> tuple[SceneLayout, ...]:
        """The layout of each kind of environment, no choice left: environment i is of kind i modulo their number."""
        # With 2 and 3 alternatives there are 6 kinds of environments, each of which an engine builds once.
        count = math.lcm(*(len(entity.spec.alternatives) for entity in self.entities))
        return (self,) if count == 1 else tuple(self._variant(kind) for kind in range(count))

    def _variant(self, kind: int) -> SceneLayout:
        objects = (
            replace(thing, articulation=thing.alternatives[kind % len(thing.alternatives)], variants=())
            for thing in self.scene.objects
        )
        return SceneLayout.of(replace(self.scene, objects=tuple(objects)))

    @cached_property
    def links(self) -> tuple[Link, ...]:
        """Every link of the scene."""
        return tuple(link for entity in self.entities for link in entity.spec.articulation.links)

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """Every movable joint of the scene."""
        return tuple(joint for entity in self.entities for joint in entity.spec.articulation.movable_joints)

    @property
    def links_by_name(self) -> tuple[tuple[str, str], ...]:
        """Entity and name of every link of the scene."""
        return tuple((e.name, link.name) for e in self.entities for link in e.spec.articulation.links)

    @property
    def joints_by_name(self) -> tuple[tuple[str, str], ...]:
        """Entity and name of every movable joint of the scene."""
        return tuple((e.name, joint) for e in self.entities for joint in e.spec.articulation.joint_names)

    @cached_property
    def entity_of_link(self) -> npt.NDArray[np.int64]:
        """Entity index of each link (L,)."""
        sizes = [entity.links.stop - entity.links.start for entity in self.entities]
        # Images hold link indices; this table turns them into instances.
        return np.repeat(np.arange(len(self.entities)), sizes)

    @cached_property
    def semantic_labels(self) -> tuple[str, ...]:
        """Every label of the scene, sorted; an image's semantic channel holds indices into it."""
        return tuple(sorted({*self._label_of_link, *(d.semantic_label for d in self.scene.deformables), "terrain"}))

    @cached_property
    def semantic_of_link(self) -> npt.NDArray[np.int64]:
        """Label index of each link (L,)."""
        return np.array([self.semantic_labels.index(label) for label in self._label_of_link], dtype=np.int64)

    @cached_property
    def semantic_of_deformable(self) -> npt.NDArray[np.int64]:
        """Label index of each deformable (D,)."""
        labels = [self.semantic_labels.index(spec.semantic_label) for spec in self.scene.deformables]
        return np.array(labels, dtype=np.int64)

    @property
    def _label_of_link(self) -> list[str]:
        return [
            link.semantic_label or entity.spec.semantic_label or entity.name
            for entity in self.entities
            for link in entity.spec.articulation.links
        ]

    def entity(self, name: str) -> EntityLayout:
        """Return the entity of that name.

        Raises:
            UnknownNameError: there is none.
        """
        return self.entities[find_name(name, [entity.name for entity in self.entities], "entity", "the scene")]


def contact_queries_of(sensor: ContactSensorSpec, entities: dict[str, EntityLayout]) -> tuple[ContactQuery, ...]:
    """Return the queries of a contact sensor: for each link the total, then one query per filter."""
    entity = _named(entities, sensor.entity, sensor.name)
    names = entity.spec.articulation.link_names
    # The sensor finds its columns by this order: the total of a link, then its filters.
    queries: list[ContactQuery] = []
    for index in match_names(sensor.links, names, "link", f"sensor '{sensor.name}'"):
        link = entity.links.start + index
        queries.append(ContactQuery(link))
        queries += [ContactQuery(link, _links_of(entities, name, sensor.name)) for name in sensor.filters]
    return tuple(queries)


def _links_of(entities: dict[str, EntityLayout], name: str, sensor: str) -> frozenset[int]:
    if name == "terrain":
        return frozenset({TERRAIN})
    links = _named(entities, name, sensor).links
    return frozenset(range(links.start, links.stop))


def _named(entities: dict[str, EntityLayout], name: str, sensor: str) -> EntityLayout:
    if name not in entities:
        raise UnknownNameError("entity", name, entities, f"sensor '{sensor}'")
    return entities[name]


def _contact_queries(scene: Scene, entities: dict[str, EntityLayout]) -> tuple[ContactQuery, ...]:
    sensors = [contacts for sensor in scene.sensors for contacts in sensor.contacts]
    # Engines measure a query once, however many sensors ask for it; dictionaries keep the order.
    return tuple(dict.fromkeys(query for sensor in sensors for query in contact_queries_of(sensor, entities)))


def _wrench_links(scene: Scene, entities: dict[str, EntityLayout]) -> tuple[int, ...]:
    links: list[int] = []
    for sensor in scene.sensors:
        if isinstance(sensor, ForceTorqueSpec):
            entity = _named(entities, sensor.entity, sensor.name)
            names = entity.spec.articulation.link_names
            links.append(entity.links.start + find_name(sensor.link, names, "link", f"sensor '{sensor.name}'"))
    return tuple(dict.fromkeys(links))


def _refuse_duplicates(kind: str, names: list[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ConfigurationError(f"two {kind} specifications share the name '{name}': give each its own")


def _number(specs: tuple[Entity, ...]) -> tuple[EntityLayout, ...]:
    entities: list[EntityLayout] = []
    link = joint = 0
    for index, spec in enumerate(specs):
        links = len(spec.articulation.links)
        joints = len(spec.articulation.movable_joints)
        entities.append(EntityLayout(index, spec, slice(link, link + links), slice(joint, joint + joints)))
        link, joint = link + links, joint + joints
    return tuple(entities)


def _parameters(entities: tuple[EntityLayout, ...]) -> JointParameters:
    columns = [_entity_parameters(entity.spec) for entity in entities]
    names = JointParameters.__dataclass_fields__
    return JointParameters(**{n: np.concatenate([c[n] for c in columns]) if columns else np.zeros(0) for n in names})


def _entity_parameters(entity: Entity) -> dict[str, npt.NDArray[np.float64]]:
    joints = entity.articulation.movable_joints
    names = entity.articulation.joint_names
    own = ("lower_limit", "upper_limit", "effort_limit", "velocity_limit", "damping", "friction", "armature")
    values = {name: np.array([getattr(joint, name) for joint in joints], dtype=np.float64) for name in own}
    values["spring_stiffness"] = np.array([joint.stiffness for joint in joints], dtype=np.float64)
    values["spring_rest"] = np.array([joint.rest_position for joint in joints], dtype=np.float64)
    for name in ("drive_stiffness", "drive_damping"):
        values[name] = np.zeros(len(joints))
    # Two groups on one joint would add their efforts, which no robot means.
    driven: set[int] = set()
    for group in entity.actuators:
        indices = match_names(group.joints, names, "joint", f"an actuator group of '{entity.name}'")
        if shared := driven.intersection(indices):
            raise ConfigurationError(f"joint '{names[min(shared)]}' of '{entity.name}' is in two actuator groups")
        driven.update(indices)
        for name in ("effort_limit", "velocity_limit", "armature", "friction"):
            if (override := getattr(group, name)) is not None:
                values[name][indices] = override
        # Only implicit drives are the engine's; the core computes all others and leaves the engine's gains at zero.
        if isinstance(group, ImplicitPd):
            values["drive_stiffness"][indices] = group.stiffness
            values["drive_damping"][indices] = group.damping
    values["home"] = _home(entity, values["lower_limit"], values["upper_limit"])
    for index, group in actuator_of_joint(entity).items():
        if isinstance(group, DcMotor) and group.transmission is not None:
            ratio = group.transmission.ratio(values["home"][index])
            # Engines take one armature per joint: the rotor's, reflected by the ratio at home.
            values["armature"][index] += group.transmission.rotor_inertia * ratio**2
    return values


def actuator_of_joint(entity: Entity) -> dict[int, ActuatorConfig]:
    """Return the actuator group of each movable joint that has one, by the joint's index.

    Raises:
        UnknownNameError: a group names no joint of the entity.
    """
    names, where = entity.articulation.joint_names, f"an actuator group of '{entity.name}'"
    return {index: group for group in entity.actuators for index in match_names(group.joints, names, "joint", where)}


def gripper_positions(spec: RobotSpec, gripper: Gripper, value: float | tuple[float, ...]) -> Mapping[int, float]:
    """Return the positions of a gripper's joints, by joint index.

    Args:
        spec: of the robot.
        gripper: one of its grippers.
        value: ``open_position`` or ``closed_position`` of the gripper, rad or m.
    """
    values = value if isinstance(value, tuple) else (value,) * len(gripper.joints)
    names = spec.articulation.joint_names
    return match_values(dict(zip(gripper.joints, values, strict=True)), names, "joint", f"the gripper of '{spec.name}'")


def home_positions(entity: Entity) -> npt.NDArray[np.float64]:
    """Return positions (J,) of the movable joints at reset."""
    return _entity_parameters(entity)["home"]


def _home(entity: Entity, lower: npt.NDArray[np.float64], upper: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    # Zero where it is allowed, else the nearest limit: a start outside of the limits would be pushed back by force.
    home = np.clip(np.zeros_like(lower), lower, upper)
    names = entity.articulation.joint_names
    for index, position in match_values(entity.home, names, "joint", f"the home pose of '{entity.name}'").items():
        # Files round both limits and home positions.
        if not lower[index] - 1e-6 <= position <= upper[index] + 1e-6:
            raise ConfigurationError(
                f"home position {position} of joint '{names[index]}' of '{entity.name}' is outside of its limits "
                f"[{lower[index]}, {upper[index]}]: give the entity's home a position within them, or widen the limits "
                "by edit_joints"
            )
        home[index] = position
    for index, joint in enumerate(entity.articulation.movable_joints):
        # A home position of a follower would contradict its leader's.
        if joint.mimic:
            home[index] = joint.mimic.position(home[names.index(joint.mimic.joint)])
    return home


def joint_constants(entity: Entity, name: Literal["armature", "damping", "friction"]) -> npt.NDArray[np.float64]:
    """Return reflected inertias, damping or dry friction (J,) of the movable joints, with overrides of actuators."""
    return _entity_parameters(entity)[name]


def joint_limits(entity: Entity, name: Literal["effort_limit", "velocity_limit"]) -> npt.NDArray[np.float64]:
    """Return limits (J,) of the movable joints, with overrides of actuators."""
    return _entity_parameters(entity)[name]


@dataclass(frozen=True)
class Approximation:
    """A line of the build report: what the scene asked for, what the engine got, and why they differ."""

    subject: str
    """Part of the scene, for the report."""
    asked: str
    """Quantity or behaviour that the scene specifies."""
    got: str
    """Value or behaviour in the engine."""
    why: str
    """Reason for the difference, and what would avoid it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BuiltModel:
    """One kind of environment, for L links and J movable joints in the layout's order.

    An engine fills it from the objects that it simulates, never from the description. A field is None where the engine
    keeps no such number, as where the core or the plugin applies a limit itself at each step.
    """

    masses: npt.NDArray[np.float64]
    """(L,) kg. The number of a fixed root, which no motion depends on, is not compared."""
    centers_of_mass: npt.NDArray[np.float64]
    """(L, 3) metres, in the link frame."""
    inertias: npt.NDArray[np.float64] | None
    """(L, 3, 3) kg m^2, about the centre of mass, in the link's axes."""
    lower_limits: npt.NDArray[np.float64] | None = None
    """(J,) rad or m; minus infinity, or less than -1e8, where there is none."""
    upper_limits: npt.NDArray[np.float64] | None = None
    """(J,) rad or m; infinity, or more than 1e8, where there is none."""
    # None skips the comparison where an engine has no such number.
    armatures: npt.NDArray[np.float64] | None = None
    """(J,) kg or kg m^2 of reflected motor inertia."""
    effort_limits: npt.NDArray[np.float64] | None = None
    """(J,) N or N m; infinity, or more than 1e8, where there is none."""
