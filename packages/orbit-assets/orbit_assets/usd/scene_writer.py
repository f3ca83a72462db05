"""Writer of whole scenes to USD files, which :func:`orbit_assets.scene_files.load_scene` reads back."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orbit_assets.usd.contents import ARTICULATION
from orbit_assets.usd.library import assign, assign_custom, define, place, pxr, quatf
from orbit_assets.usd.writer import ArticulationWriter, ShapeWriter, export, losses, new_stage, usd_path
from orbit_core.preparation.validation import validate
from orbit_core.scene import (
    AmbientLight,
    Articulation,
    DirectionalLight,
    DriveGains,
    Entity,
    HeightField,
    ImplicitPd,
    Mesh,
    MeshCollision,
    ObjectSpec,
    Plane,
    RobotSpec,
    Scene,
    Shape,
    look_at,
)


def write_usd_scene(scene: Scene, path: str | Path) -> tuple[str, ...]:
    """Write a scene to a ``.usda``, ``.usdc`` or ``.usd`` file; return what it cannot hold, a sentence each.

    Every robot and object is a prim of its name with its bodies and joints, at the pose and joint positions of a reset.
    A fixed base is a fixed joint to the world. The file is overwritten.

    Raises:
        AssetError: the file's suffix is another, a shape is of a kind that USD lacks, or USD is not installed.
        StorageError: the file cannot be written.
    """
    path = usd_path(path)
    with pxr().Tf.DiagnosticTrap() as trap:
        stage = new_stage()
        top = define(stage, None, "scene", "Xform")
        stage.SetDefaultPrim(top)
        shapes = ShapeWriter(stage, path)
        lost = list(_losses(scene))
        for entity in scene.entities:
            body = _with_state(entity)
            lost += [f"{entity.name}: {line}" for line in losses(body)]
            _write_entity(shapes, top, entity, body)
        for shape in scene.terrain:
            _write_terrain(shapes, top, shape)
        _write_physics(stage, top, scene)
        _write_lights(stage, top, scene)
        export(stage, path)
        trap.Clear()
    return tuple(lost)


def _write_entity(shapes: ShapeWriter, top: Any, entity: Entity, body: Articulation) -> None:
    prim = define(shapes.stage, top, entity.name, "Xform")
    place(prim, entity.pose)
    assign_custom(prim, {ARTICULATION: True})
    writer = ArticulationWriter(body, shapes)
    writer.write(prim)
    if entity.fixed_base:
        # One side names the root, the other nothing: the world, in which the frame is the entity's pose.
        joint = define(shapes.stage, prim, "fixed_base", "PhysicsFixedJoint")
        joint.GetRelationship("physics:body1").SetTargets([writer.links[body.root.name].GetPath()])
        joint.GetAttribute("physics:localPos0").Set(entity.pose.position)
        joint.GetAttribute("physics:localRot0").Set(quatf(entity.pose))


def _with_state(entity: Entity) -> Articulation:
    """Return the articulation with the entity's home, labels and drives, which a file holds of the articulation."""
    body = validate(entity.articulation)
    names = body.joint_names
    home = {name: value for pattern, value in entity.home.items() for name in names if re.fullmatch(pattern, name)}
    links = tuple(
        replace(link, semantic_label=link.semantic_label or entity.semantic_label or entity.name) for link in body.links
    )
    limits = {joint.name: joint.effort_limit for joint in body.joints}
    drives = tuple(
        DriveGains(
            name, group.stiffness, group.damping, limits[name] if group.effort_limit is None else group.effort_limit
        )
        for group in entity.actuators
        if isinstance(group, ImplicitPd)
        for name in names
        if any(re.fullmatch(pattern, name) for pattern in group.joints)
    )
    return replace(body, links=links, home=tuple((dict(body.home) | home).items()), drives=drives or body.drives)


def _write_terrain(shapes: ShapeWriter, top: Any, shape: Shape) -> None:
    if isinstance(shape.geometry, HeightField):
        from orbit_core.plugin_kit.meshes import height_field_mesh

        vertices, faces = height_field_mesh(shape.geometry)
        surface = Mesh(np.asarray(vertices), np.asarray(faces), MeshCollision.TRIANGLES)
        shape = replace(shape, geometry=surface)
    shapes.write(top, replace(shape, name=shape.name or "ground"))


def _write_physics(stage: Any, top: Any, scene: Scene) -> None:
    prim = define(stage, top, "physics", "PhysicsScene")
    length = float(np.linalg.norm(scene.gravity))
    direction = tuple(float(part) / length for part in scene.gravity) if length > 0.0 else (0.0, 0.0, -1.0)
    gravity = {"physics:gravityDirection": direction, "physics:gravityMagnitude": length}
    assign(prim, None, gravity)
    # Readers take whole steps a second.
    assign(prim, "NewtonSceneAPI", {"newton:timeStepsPerSecond": round(1.0 / scene.physics_dt)})


def _write_lights(stage: Any, top: Any, scene: Scene) -> None:
    usual = AmbientLight().color
    for light in scene.lights:
        if isinstance(light, DirectionalLight):
            prim = define(stage, top, "sun", "DistantLight")
            # A distant light shines along its own -z.
            place(prim, replace(look_at((0.0, 0.0, 0.0), light.unit_direction), position=(0.0, 0.0, 0.0)))
            assign(prim, None, {"inputs:intensity": light.intensity, "inputs:color": light.color})
            if not light.shadows:
                assign(prim, "ShadowAPI", {"inputs:shadow:enable": False})
        else:
            prim = define(stage, top, "dome", "DomeLight")
            color = tuple(part / own for part, own in zip(light.color, usual, strict=True))
            assign(prim, None, {"inputs:color": color})


def _losses(scene: Scene) -> Iterator[str]:
    for what, given in (
        ("deformable", scene.deformables),
        ("sensor", scene.sensors),
        ("marker", scene.markers),
    ):
        if given:
            yield f"{len(given)} {what}s are left out: {', '.join(each.name for each in given[:5])}"
    if any(isinstance(shape.geometry, HeightField) for shape in scene.terrain):
        yield "height fields are written as meshes of triangles"
    if any(not isinstance(shape.geometry, Plane | HeightField) for shape in scene.terrain):
        yield "terrain other than planes reads back as a fixed object"
    for entity in scene.entities:
        if isinstance(entity, ObjectSpec) and entity.active:
            yield f"{entity.name}: force laws are left out: {', '.join(law.name for law in entity.active)}"
        if isinstance(entity, ObjectSpec) and entity.variants:
            yield f"{entity.name}: its {len(entity.variants)} variants are left out"
        if isinstance(entity, RobotSpec) and (entity.end_effectors or entity.feet):
            yield f"{entity.name}: end effectors, feet and workspaces are the catalogue's, and left out"
        if any(not isinstance(group, ImplicitPd) for group in entity.actuators):
            yield f"{entity.name}: actuators that are no plain drives are left out"
        if entity.gravity_compensation:
            yield f"{entity.name}: that gravity is compensated is left out"
