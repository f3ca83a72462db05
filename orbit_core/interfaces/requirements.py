"""Capabilities that a scene needs, so that a backend without one refuses it before anything is built.

Apart from the capabilities, so that a plugin's declaration is read without scenes.
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from dataclasses import replace

from orbit_core.interfaces.capabilities import Capability
from orbit_core.scene import (
    CameraSpec,
    Channel,
    Cloth,
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
    RayCameraSpec,
    RayCasterSpec,
    Rope,
    Scene,
    SensorSpec,
    Shape,
    SoftBody,
    TactileSpec,
)

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
    if any(isinstance(sensor, CameraSpec) and Channel.RGB in sensor.channels for sensor in scene.sensors):
        for name, shape in _finished(scene):
            yield Capability.TEXTURES, f"'{name}' with texture '{shape.name}'"
    looped = {entity.name for entity in scene.entities if entity.articulation.loops}
    for sensor in scene.sensors:
        yield from _sensor_needs(sensor, looped)


def _finished(scene: Scene) -> Iterator[tuple[str, Shape]]:
    """Yield the shapes that have a texture, each with the name of what it belongs to."""
    for entity in scene.entities:
        for link in (link for each in entity.alternatives for link in each.links):
            for shape in link.visuals or link.collisions:
                if shape.finish.texture is not None:
                    yield entity.name, shape
    for shape in scene.terrain:
        if shape.finish.texture is not None:
            yield "terrain", shape


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
    if sensor.contacts:
        yield Capability.CONTACT_FORCES, culprit
    match sensor:
        case RayCameraSpec() | RayCasterSpec():
            yield Capability.RAY_CASTS, culprit
        case CameraSpec(channels=channels):
            for channel in channels:
                yield _CHANNEL_NEEDS[channel], culprit
        case TactileSpec(shear=shear):
            yield Capability.RAY_CASTS, culprit
            if shear:
                yield Capability.FRICTION_FORCES, culprit
        case ForceTorqueSpec():
            yield Capability.JOINT_WRENCHES, culprit
            if sensor.entity in looped:
                yield Capability.LOOP_WRENCHES, culprit
