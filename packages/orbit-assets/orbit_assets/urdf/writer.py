"""Writer of URDF files, with meshes in OBJ files next to them, and a list of what the format cannot hold."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

import numpy as np

from orbit_assets.losses import (
    JointTraits,
    LinkTraits,
    collides_otherwise_than_by_hulls,
    has_geometry,
    listed,
    missing_traits,
    raised_inertias,
)
from orbit_core.files import storage_faults, written_whole
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Color,
    Cylinder,
    Frame,
    HeightField,
    Joint,
    JointType,
    Link,
    Mesh,
    PhysicsMaterial,
    Plane,
    Pose,
    Shape,
    Sphere,
)
from orbit_core.scene.articulation import solid_moments
from orbit_core.scene.pose import Vector3

UNLIMITED = 1e30
"""Written for an infinite limit, and read as one from this value on: most parsers require a number."""


def numbers(values: Iterable[float]) -> str:
    """Format numbers in full precision, separated by spaces."""
    return " ".join(repr(float(value)) for value in values)


def origin(parent: Element, pose: Pose) -> None:
    """Add ``<origin>`` to an element, unless the pose is the identity."""
    if pose != Pose():
        SubElement(parent, "origin", xyz=numbers(pose.position), rpy=numbers(roll_pitch_yaw(pose)))


def roll_pitch_yaw(pose: Pose) -> Vector3:
    """Return fixed-axis angles in radians, the inverse of :meth:`Pose.from_euler`.

    Where pitch is a quarter turn, yaw is arbitrary; roll is computed from the chosen yaw, so that the rotation is also
    exact near that singularity.
    """
    r = pose.rotation_matrix()
    yaw = math.atan2(r[1, 0], r[0, 0])
    sine, cosine = math.sin(yaw), math.cos(yaw)
    pitch = math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
    roll = math.atan2(sine * r[0, 2] - cosine * r[1, 2], cosine * r[1, 1] - sine * r[0, 1])
    return (roll, pitch, yaw)


_OF_JOINTS: JointTraits = (
    ("armature", lambda joint: joint.movable and joint.armature),
    ("the stiffness of springs", lambda joint: joint.movable and joint.stiffness),
    ("higher powers of couplings", lambda joint: joint.mimic is not None and not joint.mimic.linear),
)
_OF_LINKS: LinkTraits = (
    ("planes and height fields", lambda link: has_geometry(link, Plane, HeightField)),
    ("collision with a mesh's own triangles or convex pieces", collides_otherwise_than_by_hulls),
    ("friction, restitution and compliance", lambda link: _has_material(link)),
    ("semantic labels", lambda link: link.semantic_label),
)


def losses(articulation: Articulation) -> tuple[str, ...]:
    """List what a URDF file of the articulation does not hold, or holds in elements that few parsers read."""
    traits = missing_traits("URDF", articulation, _OF_JOINTS, _OF_LINKS)
    return (*traits, *raised_inertias(articulation), *_of_the_whole(articulation))


def _of_the_whole(articulation: Articulation) -> Iterable[str]:
    if articulation.loops:
        yield f"URDF does not hold joints that close loops: {listed(loop.name for loop in articulation.loops)}"
    if articulation.drives:
        yield f"URDF does not hold drives' gains: {listed(drive.joint for drive in articulation.drives)}"
    if articulation.home:
        yield "URDF does not hold a home pose"
    if articulation.self_collisions:
        yield "URDF does not say that the links collide with each other"
    if articulation.collision_exclusions:
        yield f"URDF does not hold {len(articulation.collision_exclusions)} pairs of links that never collide"
    if any(has_geometry(link, Capsule) for link in articulation.links):
        yield "capsules are written as <capsule>, which physics engines read and ROS does not"
    moved = [joint.child for joint in articulation.joints if joint.child_pose != Pose()]
    if moved:
        yield f"frames of links are written at their joints' frames: {listed(moved)}"


def _has_material(link: Link) -> bool:
    return any(shape.material != PhysicsMaterial() for shape in link.collisions)


class ShapeWriter:
    """Writer of ``<visual>`` and ``<collision>`` elements of links, and of each mesh once.

    Args:
        folder: for the mesh files; made with the first.
        base: the URDF file's folder, from which they are named.
    """

    def __init__(self, folder: Path, base: Path) -> None:
        self.folder = folder
        self.base = base
        self._files: dict[int, tuple[Mesh, str]] = {}
        self._colors: dict[Color, str] = {}

    def write(self, link: Element, tag: str, shape: Shape) -> None:
        """Add one shape to a link's element; kinds that URDF lacks are left out."""
        if isinstance(shape.geometry, Plane | HeightField):
            return
        element = SubElement(link, tag, {"name": shape.name} if shape.name else {})
        origin(element, shape.pose)
        geometry = SubElement(element, "geometry")
        match shape.geometry:
            case Box(half_extents=half):
                SubElement(geometry, "box", size=numbers(2.0 * extent for extent in half))
            case Sphere(radius=radius):
                SubElement(geometry, "sphere", radius=repr(float(radius)))
            case Cylinder(radius=radius, half_length=half):
                SubElement(geometry, "cylinder", radius=repr(float(radius)), length=repr(2.0 * float(half)))
            case Capsule(radius=radius, half_length=half):
                SubElement(geometry, "capsule", radius=repr(float(radius)), length=repr(2.0 * float(half)))
            case Mesh() as mesh:
                SubElement(geometry, "mesh", filename=self._file(mesh, shape.name or f"{link.get('name')}_{tag}"))
        if tag == "visual":
            material = SubElement(element, "material", name=self._color_name(shape.color))
            SubElement(material, "color", rgba=numbers(shape.color))

    def _color_name(self, color: Color) -> str:
        return self._colors.setdefault(color, f"color_{len(self._colors)}")

    def _file(self, mesh: Mesh, name: str) -> str:
        """Return the mesh's file name, relative to the URDF file; the file is written with the first shape that uses
        it.
        """
        if id(mesh) not in self._files:
            path = write_mesh(mesh, self.folder, name)
            # The mesh is kept alive: else another one could get the same id.
            self._files[id(mesh)] = mesh, Path(os.path.relpath(path, self.base)).as_posix()
        return self._files[id(mesh)][1]


def write_mesh(mesh: Mesh, folder: Path, name: str) -> Path:
    """Write a mesh's triangles as Wavefront OBJ, in full single precision, and return the file.

    The file's name ends in a digest of its content. So no file is replaced by one that differs: a model of the same
    folder, or the one that is being overwritten, keeps its meshes.

    Args:
        mesh: the triangles.
        folder: for the file; made where it is missing.
        name: of the shape, with which the file's name begins.
    """
    vertices = "".join("v {:.9g} {:.9g} {:.9g}\n".format(*vertex) for vertex in np.asarray(mesh.vertices).tolist())
    faces = "".join("f {} {} {}\n".format(*face) for face in (np.asarray(mesh.faces) + 1).tolist())
    data = (vertices + faces).encode("ascii")
    # File systems differ in the characters and lengths that they allow.
    plain = "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in name)[:80]
    path = folder / f"{plain}_{hashlib.sha256(data).hexdigest()[:12]}.obj"
    folder.mkdir(parents=True, exist_ok=True)
    if not path.is_file() or path.read_bytes() != data:
        with written_whole(path) as written:
            written.write_bytes(data)
    return path


def write_urdf(articulation: Articulation, path: Path | str, meshes: Path | str | None = None) -> tuple[str, ...]:
    """Write one articulation to a ``.urdf`` file; return what the format cannot hold, a sentence each.

    A link's frame is its joint's in URDF: where the description has them apart, the file's links are the description's
    seen from their joints. Frames become links without mass on fixed joints. Limits that are infinite are written as
    1e30, for most parsers ask for a number; :func:`orbit_assets.urdf.read_urdf` takes that back.

    Args:
        articulation: what to write, in topological order.
        path: the file, which is overwritten.
        meshes: the folder for mesh files, made where it is missing; next to the file and named after it by default.

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
        # repr writes the shortest text that reads back as the same number.
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
    # URDF's continuous joints have no bounds, but still limits of effort and velocity.
    if joint.type is not JointType.CONTINUOUS:
        limit |= {"lower": joint.lower_limit, "upper": joint.upper_limit}
    SubElement(element, "limit", {key: _limit(value) for key, value in limit.items()})
    if joint.damping or joint.friction:
        SubElement(element, "dynamics", damping=repr(float(joint.damping)), friction=repr(float(joint.friction)))
    if joint.mimic is not None:
        law = {"multiplier": repr(float(joint.mimic.multiplier)), "offset": repr(float(joint.mimic.offset))}
        SubElement(element, "mimic", {"joint": joint.mimic.joint, **law})


def _frame(root: Element, frame: Frame, taken: set[str]) -> None:
    # URDF has no frames: a massless link on a fixed joint is the usual substitute.
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
    """Move each link's frame to its joint's, so that no joint has a pose in its child, as URDF requires."""
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
    """Return the link described in the frame in which its own has ``pose``."""

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
