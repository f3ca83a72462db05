"""Writes an articulation to MJCF, its meshes as OBJ files beside it, and says what the format cannot hold."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

from orbit_assets.mjcf.bodies_writer import BodyWriter, renamed_world
from orbit_assets.mjcf.loops import OWN_SITES
from orbit_assets.mjcf.losses import losses
from orbit_assets.mjcf.shapes_writer import GeomWriter, place
from orbit_assets.urdf.text import numbers
from orbit_core.files import storage_faults, written_whole
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Articulation, DriveGains, LoopType, Pose


def write_mjcf(
    articulation: Articulation, path: Path | str, meshes: Path | str | None = None, *, fixed_base: bool = True
) -> tuple[str, ...]:
    """Write one articulation to an ``.xml`` or ``.mjcf`` file and give what the format cannot hold, a sentence each.

    Links without mass between joints become several joints on one body, and come back by the names that
    :func:`orbit_assets.compound_joints.chain` gives. Links come back depth first, joints and links without mass
    with axes along the child's, and the home pose with a position of every joint, zero where the description names
    none. A link ``world`` with mass comes back as ``world_1``, for MJCF keeps that name for the world itself.

    Args:
        articulation: what to write, in topological order.
        path: the file, which is overwritten.
        meshes: the folder for mesh files, made where it is missing; beside the file and of its name unless given.
        fixed_base: whether the root stands fixed in the world, which a description leaves to its scene.

    Raises:
        AssetError: the suffix is another, or a moving link without mass is more than the place between two joints.
        StorageError: a file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in (".xml", ".mjcf"):
        raise AssetError(f"'{path}' is to be an MJCF file: name it *.xml or *.mjcf")
    folder = Path(meshes) if meshes is not None else path.with_name(f"{path.stem}_meshes")
    articulation, renamed = renamed_world(articulation, fixed_base=fixed_base)
    root = Element("mujoco", model=articulation.name)
    SubElement(root, "compiler", angle="radian", inertiafromgeom="false")
    asset, worldbody = SubElement(root, "asset"), SubElement(root, "worldbody")
    geoms = GeomWriter(asset, folder, path.parent, self_collisions=articulation.self_collisions)
    writer = BodyWriter(articulation, geoms, fixed_base)
    with storage_faults(folder):
        bodies = writer.write(worldbody)
    _exclusions(root, articulation, bodies)
    _constraints(root, articulation, bodies)
    _actuators(root, articulation.drives)
    if articulation.home:
        _keyframe(root, worldbody, dict(articulation.home))
    indent(root)
    with written_whole(path) as written:
        ElementTree(root).write(written, encoding="utf-8", xml_declaration=True)
    return (*losses(articulation), *renamed, *writer.notes)


def _exclusions(root: Element, articulation: Articulation, bodies: dict[str, Element]) -> None:
    """Pairs that never collide: those excluded, and those joined that MuJoCo would let collide."""
    if not articulation.self_collisions:
        return
    contact = SubElement(root, "contact")
    # MuJoCo lets what hangs on a body fixed in the world collide with that; other parents and children it keeps apart.
    direct = {(joint.parent, joint.child) for joint in articulation.joints if joint.parent != articulation.root.name}
    joined = (pair for pair in articulation.joined_links if pair not in direct)
    for first, second in dict.fromkeys((*articulation.collision_exclusions, *joined)):
        if first in bodies and second in bodies:
            SubElement(contact, "exclude", body1=first, body2=second)


def _constraints(root: Element, articulation: Articulation, bodies: dict[str, Element]) -> None:
    equality = SubElement(root, "equality")
    for joint in articulation.joints:
        if joint.mimic is not None:
            law = numbers((*joint.mimic.coefficients, 0.0, 0.0, 0.0)[:5])
            SubElement(equality, "joint", joint1=joint.name, joint2=joint.mimic.joint, polycoef=law)
    for loop in articulation.loops:
        first, second = (f"{loop.name}{end}" for end in OWN_SITES)
        place(SubElement(bodies[loop.first], "site", name=first), Pose(loop.first_point, loop.orientation))
        place(SubElement(bodies[loop.second], "site", name=second), Pose(loop.second_point))
        kind = "weld" if loop.type is LoopType.WELD else "connect"
        SubElement(equality, kind, name=loop.name, site1=first, site2=second)


def _actuators(root: Element, drives: tuple[DriveGains, ...]) -> None:
    actuator = SubElement(root, "actuator")
    for drive in drives:
        named = {"name": drive.joint, "joint": drive.joint}
        if drive.stiffness:
            element = SubElement(actuator, "position", named, kp=repr(drive.stiffness), kv=repr(drive.damping))
        elif drive.damping:
            element = SubElement(actuator, "velocity", named, kv=repr(drive.damping))
        else:
            element = SubElement(actuator, "motor", named)
        if math.isfinite(drive.effort_limit) and drive.effort_limit > 0:
            element.set("forcelimited", "true")
            element.set("forcerange", numbers((-drive.effort_limit, drive.effort_limit)))


def _keyframe(root: Element, worldbody: Element, home: dict[str, float]) -> None:
    """Positions in the order of the file's joints; a floating root stands at the origin."""
    free = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0) if next(worldbody.iter("freejoint"), None) is not None else ()
    positions = (home.get(joint.get("name", ""), 0.0) for joint in worldbody.iter("joint"))
    SubElement(SubElement(root, "keyframe"), "key", name="home", qpos=numbers((*free, *positions)))
