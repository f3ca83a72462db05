"""Writes an articulation to URDF, its meshes as OBJ files beside it, and says what the format cannot hold."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

from orbit_assets.urdf.losses import losses
from orbit_assets.urdf.shapes_writer import ShapeWriter
from orbit_assets.urdf.text import UNLIMITED, numbers, origin, roll_pitch_yaw
from orbit_core.files import storage_faults, written_whole
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Articulation, Frame, Joint, JointType, Link, Pose, Shape
from orbit_core.scene.inertias import solid_moments


def write_urdf(articulation: Articulation, path: Path | str, meshes: Path | str | None = None) -> tuple[str, ...]:
    """Write one articulation to a ``.urdf`` file and give what the format cannot hold, a sentence each.

    A link's frame is its joint's in URDF: where the description has them apart, the file's links are the description's
    seen from their joints. Frames become links without mass on fixed joints. Limits that are infinite are written as
    1e30, for most parsers ask for a number; :func:`orbit_assets.urdf.read_urdf` takes that back.

    Args:
        articulation: what to write, in topological order.
        path: the file, which is overwritten.
        meshes: the folder for mesh files, made where it is missing; beside the file and of its name unless given.

    Raises:
        AssetError: the suffix is another.
        StorageError: a file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".urdf":
        raise AssetError(f"'{path}' is to be a URDF file: name it *.urdf")
    folder = Path(meshes) if meshes is not None else path.with_name(f"{path.stem}_meshes")
    with storage_faults(folder):
        root = _robot(_in_joint_frames(articulation), ShapeWriter(folder, path.parent))
    indent(root)
    with written_whole(path) as written:
        ElementTree(root).write(written, encoding="utf-8", xml_declaration=True)
    return losses(articulation)


def _robot(articulation: Articulation, shapes: ShapeWriter) -> Element:
    root = Element("robot", name=articulation.name)
    for link in articulation.links:
        _link(root, link, shapes)
    for joint in articulation.joints:
        _joint(root, joint)
    taken = {joint.name for joint in articulation.joints}
    for frame in articulation.frames:
        _frame(root, frame, taken)
    return root


def _link(root: Element, link: Link, shapes: ShapeWriter) -> None:
    element = SubElement(root, "link", name=link.name)
    if link.mass > 0 or link.inertia.any():
        inertial = SubElement(element, "inertial")
        # Readers that compute principal moments do so with an error, for which they refuse flat plates or drop their
        # inertia: the file gives the moments themselves, and turns the origin to their axes.
        moments, axes = solid_moments(link.inertia)
        SubElement(inertial, "origin", xyz=numbers(link.center_of_mass), rpy=numbers(roll_pitch_yaw(axes)))
        SubElement(inertial, "mass", value=repr(float(link.mass)))
        entries = zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), (*moments, 0.0, 0.0, 0.0), strict=True)
        SubElement(inertial, "inertia", {key: repr(float(value)) for key, value in entries})
    for tag, members in (("visual", link.visuals), ("collision", link.collisions)):
        for shape in members:
            shapes.write(element, tag, shape)


def _joint(root: Element, joint: Joint) -> None:
    element = SubElement(root, "joint", name=joint.name, type=joint.type.value)
    origin(element, joint.parent_pose)
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    if not joint.movable:
        return
    SubElement(element, "axis", xyz=numbers(joint.axis))
    limit = {"effort": joint.effort_limit, "velocity": joint.velocity_limit}
    if joint.type is not JointType.CONTINUOUS:
        limit |= {"lower": joint.lower_limit, "upper": joint.upper_limit}
    SubElement(element, "limit", {key: _limit(value) for key, value in limit.items()})
    if joint.damping or joint.friction:
        SubElement(element, "dynamics", damping=repr(float(joint.damping)), friction=repr(float(joint.friction)))
    if joint.mimic is not None:
        law = {"multiplier": repr(float(joint.mimic.multiplier)), "offset": repr(float(joint.mimic.offset))}
        SubElement(element, "mimic", {"joint": joint.mimic.joint, **law})


def _frame(root: Element, frame: Frame, taken: set[str]) -> None:
    name = f"{frame.name}_frame"
    while name in taken:
        name += "_"
    taken.add(name)
    SubElement(root, "link", name=frame.name)
    element = SubElement(root, "joint", name=name, type="fixed")
    origin(element, frame.pose)
    SubElement(element, "parent", link=frame.link)
    SubElement(element, "child", link=frame.name)


def _limit(value: float) -> str:
    return repr(math.copysign(UNLIMITED, value) if math.isinf(value) else float(value))


def _in_joint_frames(articulation: Articulation) -> Articulation:
    """The same mechanism with each link's frame at its joint's, so that no joint has a pose in its child."""
    at = {joint.child: joint.child_pose.inverse() for joint in articulation.joints if joint.child_pose != Pose()}
    if not at:
        return articulation
    return replace(
        articulation,
        links=tuple(_seen_from(link, at[link.name]) if link.name in at else link for link in articulation.links),
        joints=tuple(
            replace(joint, parent_pose=at.get(joint.parent, Pose()) @ joint.parent_pose, child_pose=Pose())
            for joint in articulation.joints
        ),
        frames=tuple(replace(f, pose=at.get(f.link, Pose()) @ f.pose) for f in articulation.frames),
    )


def _seen_from(link: Link, pose: Pose) -> Link:
    """The link described in the frame in which its own has ``pose``."""

    def moved(shapes: Iterable[Shape]) -> tuple[Shape, ...]:
        return tuple(replace(shape, pose=pose @ shape.pose) for shape in shapes)

    rotation = pose.rotation_matrix()
    x, y, z = (float(value) for value in pose.transform(link.center_of_mass))
    return replace(
        link,
        center_of_mass=(x, y, z),
        inertia=rotation @ link.inertia @ rotation.T,
        collisions=moved(link.collisions),
        visuals=moved(link.visuals),
    )
