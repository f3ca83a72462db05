"""Capabilities of engines: their levels, declared gaps, and which of them a scene needs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from enum import Enum

from orbit_core.scene import (
    CameraSpec,
    Channel,
    Cloth,
    ContactSensorSpec,
    DcMotor,
    Entity,
    Fluid,
    ForceTorqueSpec,
    HeightField,
    ImplicitPd,
    LoopType,
    Mesh,
    MeshCollision,
    PhysicsMaterial,
    RayCasterSpec,
    Rope,
    Scene,
    SensorSpec,
    Shape,
    SoftBody,
)


class Level(Enum):
    """Levels of support for a capability."""

    EXACT = "exact"
    APPROXIMATE = "approximate"
    UNSUPPORTED = "unsupported"


@dataclass(frozen=True)
class Support:
    """A level and, for anything but exact, the reason."""

    level: Level
    reason: str = ""

    def __post_init__(self) -> None:
        # Reports and refusals show the reason; without it a user could not choose another engine.
        if self.level is not Level.EXACT and not self.reason:
            raise ValueError(f"a capability declared {self.level.value} needs a reason")


EXACT = Support(Level.EXACT)


def approximate(reason: str) -> Support:
    """Return support that differs from the contract; ``reason`` says how."""
    return Support(Level.APPROXIMATE, reason)


def unsupported(reason: str) -> Support:
    """Return lack of support; ``reason`` says why."""
    return Support(Level.UNSUPPORTED, reason)


class Capability(Enum):
    """One thing that an engine may do. The value is the text that people read."""

    # The order is that of reports: joints, contact, measurements, randomisation, reproducibility, images, matter.
    ARTICULATIONS = "articulated robots and objects"
    FLOATING_BASE = "articulations with a free root"
    IMPLICIT_DRIVES = "native PD drives"
    EFFORT_LIMITS = "joint effort limits"
    VELOCITY_LIMITS = "joint velocity limits"
    JOINT_DAMPING = "joint damping"
    JOINT_SPRINGS = "joint springs"
    JOINT_FRICTION = "joint Coulomb friction"
    ARMATURE = "reflected motor inertia"
    MIMIC_JOINTS = "mimic joints"
    POLYNOMIAL_MIMICS = "mimic joints whose law is no straight line"
    LOOP_JOINTS = "joints that close kinematic loops"
    WELD_LOOPS = "welds that close kinematic loops"
    MASSLESS_LINKS = "links without mass between joints, as in compound joints"
    SELF_COLLISIONS = "self collisions"
    GRAVITY_COMPENSATION = "gravity compensation"
    FRICTION = "Coulomb friction, the larger coefficient of a pair"
    STATIC_FRICTION = "static friction above dynamic friction"
    TORSIONAL_FRICTION = "torsional friction"
    ROLLING_FRICTION = "rolling friction"
    RESTITUTION = "restitution"
    COMPLIANT_CONTACT = "contact stiffness and damping"
    CONVEX_MESHES = "convex mesh collision"
    TRIANGLE_MESHES = "static triangle mesh collision"
    DYNAMIC_TRIANGLE_MESHES = "moving triangle mesh collision"
    SIGNED_DISTANCE_FIELDS = "mesh collision by signed distance fields"
    HEIGHT_FIELDS = "height field terrain"
    CONTACT_FORCES = "contact forces per link and pair"
    JOINT_WRENCHES = "joint reaction wrenches"
    LOOP_WRENCHES = "joint reaction wrenches in kinematic loops"
    EXTERNAL_WRENCHES = "external wrenches on links"
    RAY_CASTS = "ray casts"
    RANDOMIZE_MASS = "mass per environment"
    RANDOMIZE_CENTER_OF_MASS = "centre of mass per environment"
    RANDOMIZE_FRICTION = "friction per environment"
    RANDOMIZE_GAINS = "drive gains per environment"
    RANDOMIZE_JOINTS = "joint damping, friction, armature and springs per environment"
    RANDOMIZE_LIMITS = "joint limits per environment"
    RANDOMIZE_GRAVITY = "gravity per environment"
    SHAPES_PER_ENVIRONMENT = "different object shapes per environment"
    SNAPSHOTS = "snapshots whose continuation repeats"
    COPIED_STATES = "states copied into other environments, whose continuation repeats"
    DETERMINISTIC = "the same run twice, whatever the number of environments"
    RGB = "colour images"
    LIGHTING = "colour images lit by the scene's lights"
    SHADOWS = "shadows of the scene's lights"
    COLORS_PER_ENVIRONMENT = "colours of links per environment, in images"
    DEPTH = "depth images"
    NORMALS = "surface normal images"
    ALBEDO = "albedo images"
    SEGMENTATION = "instance and semantic segmentation images"
    RAY_TRACED_RGB = "ray-traced colour images"
    GPU = "simulation on a GPU"
    CLOTH = "cloth"
    ROPES = "ropes"
    SOFT_BODIES = "soft bodies"
    FLUIDS = "fluids"

    @property
    def key(self) -> str:
        """The name in configuration and reports."""
        return self.name.lower()


class DriveIntegration(Enum):
    """State within a physics step at which an engine evaluates its native PD drives."""

    IMPLICIT = "implicit"
    """At the end of the step, or with as much damping added as keeps it stable: no gain makes it diverge."""
    EXPLICIT = "explicit"
    """At the beginning of the step, as the core's own actuators do: gains beyond a limit are refused."""


@dataclass(frozen=True)
class Capabilities:
    """Declared capabilities of a backend. Everything else is unsupported."""

    declared: Mapping[Capability, Support]

    def __getitem__(self, capability: Capability) -> Support:
        # Undeclared means unsupported, so that a new capability never becomes a false promise of an old plugin.
        return self.declared.get(capability, unsupported("not declared by the backend"))

    def has(self, capability: Capability) -> bool:
        """Return True if the engine supports it, exactly or approximately."""
        return self[capability].level is not Level.UNSUPPORTED


@dataclass(frozen=True)
class Gap:
    """A declared miss of one metric of one conformance scenario, or of one check of robots.

    The conformance suite fails when the miss grows beyond ``limit``, and also when it is gone: a declaration is held to
    be true both ways.
    """

    scenario: str
    metric: str
    limit: float
    """The largest error that the backend admits to, in the metric's unit: what was measured, with a margin.

    ``math.inf`` where the engine diverges and raises :class:`SimulationError`, or refuses the scene at its time step by
    a :class:`ConfigurationError`.
    """
    reason: str
    """Why the engine cannot do better."""
    robots: tuple[str, ...] = ()
    """Names of the robots that miss it, where ``scenario`` is a check of robots."""


IMAGES = (
    Capability.RGB, Capability.DEPTH, Capability.NORMALS, Capability.ALBEDO, Capability.SEGMENTATION,
    Capability.RAY_TRACED_RGB, Capability.LIGHTING, Capability.SHADOWS, Capability.COLORS_PER_ENVIRONMENT,
)  # fmt: skip
"""Needs of a scene that its renderer fulfils; the engine fulfils all others."""

MATTER = (Capability.CLOTH, Capability.ROPES, Capability.SOFT_BODIES, Capability.FLUIDS)
"""Needs of a scene that the matter solver fulfils where one is chosen, and otherwise the engine."""

_CHANNEL_NEEDS = {
    Channel.RGB: Capability.RGB,
    Channel.DEPTH: Capability.DEPTH,
    Channel.POSITION: Capability.DEPTH,
    Channel.NORMALS: Capability.NORMALS,
    Channel.ALBEDO: Capability.ALBEDO,
    Channel.INSTANCE: Capability.SEGMENTATION,
    Channel.SEMANTIC: Capability.SEGMENTATION,
}


_CONTACT = {
    Capability.FRICTION, Capability.STATIC_FRICTION, Capability.TORSIONAL_FRICTION, Capability.ROLLING_FRICTION,
    Capability.RESTITUTION, Capability.COMPLIANT_CONTACT,
}  # fmt: skip


def required_capabilities(scene: Scene) -> dict[Capability, str]:
    """Return each capability that the scene needs, with the first thing in it that needs it."""
    needs: dict[Capability, str] = {}
    for capability, culprit in _needs(scene):
        # A pendulum alone needs no friction, though its shapes have a material.
        if capability not in _CONTACT or _may_touch(scene):
            # Only the first culprit is named, to keep the message short.
            needs.setdefault(capability, culprit)
    return needs


def _may_touch(scene: Scene) -> bool:
    """Return True if the scene has two things that could touch."""
    articulations = [entity.alternatives for entity in scene.entities]
    # Entities with shapes; the terrain counts as one more for each of its shapes.
    solid = sum(any(link.collisions for each in kinds for link in each.links) for kinds in articulations)
    alone = any(each.self_collisions for kinds in articulations for each in kinds)
    return alone or bool(scene.deformables) or solid + len(scene.terrain) > 1


def _needs(scene: Scene) -> Iterator[tuple[Capability, str]]:
    for entity in scene.entities:
        for articulation in entity.alternatives:
            # Variants may need more than the entity's own articulation does.
            yield from _entity_needs(replace(entity, articulation=articulation))
        if len(entity.alternatives) > 1:
            yield Capability.SHAPES_PER_ENVIRONMENT, f"'{entity.name}'"
    for shape in scene.terrain:
        yield from _shape_needs(shape, f"terrain shape '{shape.name}'", moving=False)
    for deformable in scene.deformables:
        match deformable:
            case Cloth(name=name):
                yield Capability.CLOTH, f"cloth '{name}'"
            case Rope(name=name):
                yield Capability.ROPES, f"rope '{name}'"
            case SoftBody(name=name):
                yield Capability.SOFT_BODIES, f"soft body '{name}'"
            case Fluid(name=name):
                yield Capability.FLUIDS, f"fluid '{name}'"
    looped = {entity.name for entity in scene.entities if entity.articulation.loops}
    for sensor in scene.sensors:
        yield from _sensor_needs(sensor, looped)


def _entity_needs(entity: Entity) -> Iterator[tuple[Capability, str]]:
    articulation = entity.articulation
    culprit = f"'{entity.name}'"
    if articulation.movable_joints:
        yield Capability.ARTICULATIONS, culprit
        if not entity.fixed_base:
            yield Capability.FLOATING_BASE, culprit
        if articulation.self_collisions:
            yield Capability.SELF_COLLISIONS, culprit
    if entity.gravity_compensation:
        yield Capability.GRAVITY_COMPENSATION, culprit
    for loop in articulation.loops:
        kind = Capability.WELD_LOOPS if loop.type is LoopType.WELD else Capability.LOOP_JOINTS
        yield kind, f"loop '{loop.name}' of {culprit}"
    for joint in articulation.movable_joints:
        where = f"joint '{joint.name}' of {culprit}"
        if joint.mimic:
            yield Capability.MIMIC_JOINTS, where
            if not joint.mimic.linear:
                yield Capability.POLYNOMIAL_MIMICS, where
        if joint.damping:
            yield Capability.JOINT_DAMPING, where
        if joint.stiffness:
            yield Capability.JOINT_SPRINGS, where
        if joint.friction:
            yield Capability.JOINT_FRICTION, where
        if joint.armature:
            yield Capability.ARMATURE, where
    for group in entity.actuators:
        where = f"an actuator group of {culprit}"
        if isinstance(group, ImplicitPd):
            yield Capability.IMPLICIT_DRIVES, where
        if group.friction:
            yield Capability.JOINT_FRICTION, where
        through = group.transmission if isinstance(group, DcMotor) else None
        if group.armature or (through is not None and through.rotor_inertia):
            yield Capability.ARMATURE, where
    for link in articulation.links:
        if link.mass == 0 and link is not articulation.root:
            yield Capability.MASSLESS_LINKS, f"link '{link.name}' of {culprit}"
        for shape in link.collisions:
            # Static triangle meshes are common; moving ones only a few engines have.
            moving = not (entity.fixed_base and link is articulation.root)
            yield from _shape_needs(shape, f"link '{link.name}' of {culprit}", moving)


def _shape_needs(shape: Shape, culprit: str, moving: bool) -> Iterator[tuple[Capability, str]]:
    match shape.geometry:
        case Mesh(collision=MeshCollision.CONVEX_HULL | MeshCollision.CONVEX_DECOMPOSITION):
            yield Capability.CONVEX_MESHES, culprit
        case Mesh(collision=MeshCollision.SIGNED_DISTANCE):
            yield Capability.SIGNED_DISTANCE_FIELDS, culprit
        case Mesh():
            yield (Capability.DYNAMIC_TRIANGLE_MESHES if moving else Capability.TRIANGLE_MESHES), culprit
        case HeightField():
            yield Capability.HEIGHT_FIELDS, culprit
    material = shape.material
    yield Capability.FRICTION, culprit
    if material.restitution:
        yield Capability.RESTITUTION, culprit
    if material.static_friction != material.dynamic_friction:
        yield Capability.STATIC_FRICTION, culprit
    # Defaults are so small that engines without these coefficients leave them out.
    if material.torsional_friction > PhysicsMaterial.torsional_friction:
        yield Capability.TORSIONAL_FRICTION, culprit
    if material.rolling_friction > PhysicsMaterial.rolling_friction:
        yield Capability.ROLLING_FRICTION, culprit
    if material.compliance:
        yield Capability.COMPLIANT_CONTACT, culprit


def _sensor_needs(sensor: SensorSpec, looped: AbstractSet[str]) -> Iterator[tuple[Capability, str]]:
    """Yield the needs of a sensor; ``looped`` names the entities with closed loops."""
    culprit = f"sensor '{sensor.name}'"
    match sensor:
        case CameraSpec(channels=channels):
            for channel in channels:
                yield _CHANNEL_NEEDS[channel], culprit
        case ContactSensorSpec():
            yield Capability.CONTACT_FORCES, culprit
        case ForceTorqueSpec():
            yield Capability.JOINT_WRENCHES, culprit
            if sensor.entity in looped:
                yield Capability.LOOP_WRENCHES, culprit
        case RayCasterSpec():
            yield Capability.RAY_CASTS, culprit
