"""Entities as URDF files, the form in which Bullet takes names, masses, limits and shapes exactly.

A URDF link's frame is the frame of the joint above it, so a link stands in it at ``child_pose^-1``. Link ``i`` of an
entity is named ``l<i>``, and the joint above it ``j<i>``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import ConfigurationError
from orbit_core.plugin_kit.bodies import with_stand_in
from orbit_core.plugin_kit.meshes import convex_faces, fans
from orbit_core.scene import (
    Box,
    Capsule,
    Cylinder,
    Entity,
    Joint,
    JointType,
    Link,
    Mesh,
    MeshCollision,
    Plane,
    Pose,
    Shape,
    Sphere,
)
from orbit_core.scene.articulation import solid_moments

_KINDS = {
    JointType.FIXED: "fixed",
    JointType.REVOLUTE: "revolute",
    JointType.CONTINUOUS: "continuous",
    JointType.PRISMATIC: "prismatic",
}
HULL_MARGIN = 0.001
"""Metres around a hull, which Bullet fixes when it reads the file."""
# The value in the place of infinity in the file.
_UNLIMITED = 1e9


class MeshFiles:
    """Writes each mesh once, as OBJ, into a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        """Folder that gets them."""
        self._names: dict[tuple[Mesh, bool], Path] = {}

    def hull(self, mesh: Mesh) -> Path:
        """The corners of the convex hull, with its faces."""
        return self._file(mesh, True)

    def surface(self, mesh: Mesh) -> Path:
        """The triangles, as few as make the same surface: a ball that rolls over an edge between two loses speed."""
        return self._file(mesh, False)

    def _file(self, mesh: Mesh, hull: bool) -> Path:
        key = (mesh, hull)
        if key not in self._names:
            self._names[key] = self.folder / f"mesh{len(self._names)}.obj"
            vertices = np.asarray(mesh.vertices, dtype=np.float64)
            write_obj(self._names[key], *(_hull(vertices) if hull else fans(convex_faces(vertices, mesh.faces))))
        return self._names[key]


def write_obj(path: Path, vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.integer]) -> None:
    """A triangle mesh in Wavefront's format."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    path.write_text("\n".join(lines) + "\n")


def _hull(vertices: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.integer]]:
    """The hull that, with Bullet's margin around it, is that of ``vertices``."""
    from scipy.spatial import ConvexHull

    vertices = _without_margin(vertices)
    hull = ConvexHull(vertices)
    corners = np.unique(hull.simplices)
    triangles = np.searchsorted(corners, hull.simplices)
    middle = vertices[corners].mean(axis=0)
    a, b, c = (vertices[corners][triangles[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a - middle) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return vertices[corners], triangles


def _without_margin(vertices: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """The corners of the hull with every face moved inward by Bullet's margin; as they are where it is too thin."""
    from scipy.spatial import ConvexHull, HalfspaceIntersection

    planes = np.unique(ConvexHull(vertices).equations.round(9), axis=0)
    planes[:, 3] += HULL_MARGIN
    inside = vertices.mean(axis=0)
    if (planes[:, :3] @ inside + planes[:, 3] > -1e-6).any():
        return vertices
    return np.unique(HalfspaceIntersection(planes, inside).intersections.round(9), axis=0)


def child_poses(entity: Entity) -> list[Pose]:
    """Each link's frame in its URDF link."""
    incoming = {joint.child: joint for joint in entity.articulation.joints}
    return [
        incoming[link.name].child_pose.inverse() if link.name in incoming else Pose()
        for link in entity.articulation.links
    ]


def write_entity(entity: Entity, path: Path, meshes: MeshFiles) -> None:
    """Write an entity's physics.

    Raises:
        ConfigurationError: Bullet has no such shape.
    """
    articulation = entity.articulation
    robot = ET.Element("robot", name="entity")
    places = child_poses(entity)
    numbers = {name: number for number, name in enumerate(articulation.link_names)}
    for number, link in enumerate(articulation.links):
        subject = f"link '{link.name}' of '{entity.name}'"
        static = entity.fixed_base and number == 0
        solid = with_stand_in(articulation, link)
        _add_link(robot, number, solid, places[number], meshes, static, subject)
    for joint in articulation.joints:
        parent = numbers[joint.parent]
        _add_joint(robot, joint, parent, numbers[joint.child], places[parent])
    write_urdf(robot, path)


def write_urdf(robot: ET.Element, path: Path) -> None:
    """Write a URDF file with a line for each element.

    Bullet reads lines into a buffer of 8,192 bytes and puts line breaks between what it read, so that a longer line is
    cut in two where the buffer ends: within a word, or a number. No element is nearly as long.
    """
    ET.indent(robot, space="")
    ET.ElementTree(robot).write(path)


def _add_link(
    robot: ET.Element, number: int, link: Link, place: Pose, meshes: MeshFiles, static: bool, subject: str
) -> None:
    element = ET.SubElement(robot, "link", name=f"l{number}")
    if link.mass > 0:
        inertial = ET.SubElement(element, "inertial")
        # Bullet finds the moments of a tensor to 1e-6 of the largest, and sets those that no solid has to zero.
        moments, axes = solid_moments(link.inertia)
        _add_origin(inertial, place @ Pose(link.center_of_mass, axes.orientation))
        ET.SubElement(inertial, "mass", value=repr(float(link.mass)))
        names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        ET.SubElement(inertial, "inertia", dict(zip(names, map(_number, (*moments, 0.0, 0.0, 0.0)), strict=True)))
    for shape in link.collisions:
        collision = ET.SubElement(element, "collision")
        _add_origin(collision, place @ shape.pose)
        concave = isinstance(shape.geometry, Mesh) and shape.geometry.collision is MeshCollision.TRIANGLES
        if concave:
            collision.set("concave", "yes")
        _add_geometry(ET.SubElement(collision, "geometry"), shape, meshes, static, subject)


def _add_geometry(element: ET.Element, shape: Shape, meshes: MeshFiles, static: bool, subject: str) -> None:
    match shape.geometry:
        case Box(half_extents):
            ET.SubElement(element, "box", size=_numbers([2 * half for half in half_extents]))
        case Sphere(radius):
            ET.SubElement(element, "sphere", radius=_number(radius))
        case Capsule(radius, half_length):
            ET.SubElement(element, "capsule", radius=_number(radius), length=_number(2 * half_length))
        case Cylinder(radius, half_length):
            ET.SubElement(element, "cylinder", radius=_number(radius), length=_number(2 * half_length))
        case Plane() if static:
            ET.SubElement(element, "plane", normal="0 0 1")
        case Mesh(collision=MeshCollision.CONVEX_HULL) as mesh:
            ET.SubElement(element, "mesh", filename=str(meshes.hull(mesh)))
        case Mesh() as mesh if static:
            ET.SubElement(element, "mesh", filename=str(meshes.surface(mesh)))
        case other:
            raise ConfigurationError(f"Bullet cannot collide the {type(other).__name__} of {subject} as it is")


def _add_joint(robot: ET.Element, joint: Joint, parent: int, child: int, place: Pose) -> None:
    element = ET.SubElement(robot, "joint", name=f"j{child}", type=_KINDS[joint.type])
    ET.SubElement(element, "parent", link=f"l{parent}")
    ET.SubElement(element, "child", link=f"l{child}")
    _add_origin(element, place @ joint.parent_pose)
    ET.SubElement(element, "axis", xyz=_numbers(joint.axis))
    if joint.type in (JointType.REVOLUTE, JointType.PRISMATIC):
        lower, upper = max(joint.lower_limit, -_UNLIMITED), min(joint.upper_limit, _UNLIMITED)
        ET.SubElement(element, "limit", lower=_number(lower), upper=_number(upper), effort="0", velocity="0")


def _add_origin(element: ET.Element, pose: Pose) -> None:
    ET.SubElement(element, "origin", xyz=_numbers(pose.position), rpy=_numbers(roll_pitch_yaw(pose)))


def roll_pitch_yaw(pose: Pose) -> tuple[float, float, float]:
    """Fixed-axis angles of ``Rz(yaw) Ry(pitch) Rx(roll)``, the reverse of :meth:`Pose.from_euler`."""
    rotation = pose.rotation_matrix()
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    if np.hypot(rotation[0, 0], rotation[1, 0]) < 1e-9:  # the axes of roll and yaw coincide
        return float(np.arctan2(-rotation[1, 2], rotation[1, 1])), float(pitch), 0.0
    roll, yaw = np.arctan2(rotation[2, 1], rotation[2, 2]), np.arctan2(rotation[1, 0], rotation[0, 0])
    return float(roll), float(pitch), float(yaw)


def _number(value: float) -> str:
    return repr(float(value))


def _numbers(values: Sequence[float]) -> str:
    return " ".join(_number(value) for value in values)
