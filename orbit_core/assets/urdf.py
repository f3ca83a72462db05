"""URDF files read into the articulation description."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from orbit_core.assets.meshes import MeshPart, load_mesh, load_parts
from orbit_core.assets.naming import names_file, naming
from orbit_core.assets.options import ReadOptions
from orbit_core.assets.outside import resolve_file
from orbit_core.assets.source_text import read_xml
from orbit_core.assets.urdf_text import UNLIMITED
from orbit_core.assets.validation import sort_links
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Color,
    Cylinder,
    Geometry,
    Joint,
    JointType,
    Link,
    Mimic,
    Pose,
    Shape,
    Sphere,
)
from orbit_core.scene.pose import Vector3

_JOINT_TYPES = {type_.value: type_ for type_ in JointType}
_REMEDIES = {
    "floating": "leave the joint out, and give the entity fixed_base=False",
    "planar": "use two prismatic joints and a continuous one",
}


@names_file
def read_urdf(
    path: Path | str,
    packages: Mapping[str, Path] | None = None,
    name: str | None = None,
    *,
    options: ReadOptions = ReadOptions(),
) -> Articulation:
    """The articulation that a URDF file describes, in link order depth first, fixed joints kept.

    ``packages`` adds folders of packages that ``package://`` names to those of ``options``; one that neither has is
    looked for among the folders above the file. Collision meshes collide as their convex hulls. Visual meshes keep
    their files' colours where the URDF gives none, a texture as its median colour. Transmissions, safety controllers
    and simulators' own elements are not read.

    Raises:
        AssetError: the file, or one that it names, is missing, malformed or describes what ORBIT has no word for.
    """
    path = Path(path)
    return _Reader(path, replace(options, packages={**options.packages, **(packages or {})})).read(name)


class _Reader:
    """One file's reading: it knows the file for its messages, the named materials, and meshes met before."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.path = path
        self.options = options
        self.colors: dict[str, Color] = {}
        self.hulls: dict[tuple[Path, Vector3], Geometry] = {}
        self.parts: dict[tuple[Path, Vector3], tuple[MeshPart, ...]] = {}

    def read(self, name: str | None) -> Articulation:
        root = self._parse()
        for material in root.iter("material"):
            color = material.find("color")
            if color is not None and material.get("name"):
                self.colors.setdefault(material.get("name", ""), self._color(color))
        links = tuple(self._link(element) for element in root.findall("link"))
        joints = tuple(self._joint(element) for element in root.findall("joint"))
        articulation = sort_links(Articulation(name or root.get("name", self.path.stem), links, joints))
        if not self.hulls:
            return articulation
        return replace(articulation, notes=("collision meshes of the URDF collide as their convex hulls",))

    def _parse(self) -> Element:
        root = read_xml(self.path, self.options)
        if root.tag != "robot":
            raise self._error(f"its root element is <{root.tag}>", "give a URDF file, whose root is <robot>")
        if any(isinstance(child.tag, str) and "xacro" in child.tag for child in root):
            raise self._error("it holds xacro macros", "expand it with xacro first")
        return root

    def _link(self, element: Element) -> Link:
        name = self._attribute(element, "name", "a link")
        where = f"link '{name}'"
        collisions = [shape for child in element.findall("collision") for shape in self._collision(child, where)]
        visuals = [shape for child in element.findall("visual") for shape in self._visual(child, where)]
        link = Link(name, collisions=tuple(collisions), visuals=tuple(visuals))
        inertial = element.find("inertial")
        if inertial is None:
            return link
        pose = self._origin(inertial, where)
        mass = self._number(self._child(inertial, "mass", where), "value", where)
        inertia = self._inertia(self._child(inertial, "inertia", where), where)
        rotation = pose.rotation_matrix()
        return replace(link, mass=mass, center_of_mass=pose.position, inertia=rotation @ inertia @ rotation.T)

    def _joint(self, element: Element) -> Joint:
        name = self._attribute(element, "name", "a joint")
        where = f"joint '{name}'"
        kind = self._attribute(element, "type", where)
        if kind not in _JOINT_TYPES:
            remedy = _REMEDIES.get(kind, f"use one of {', '.join(_JOINT_TYPES)}")
            raise self._error(f"{where} is of type '{kind}'", remedy)
        joint = Joint(
            name,
            _JOINT_TYPES[kind],
            self._attribute(self._child(element, "parent", where), "link", where),
            self._attribute(self._child(element, "child", where), "link", where),
            parent_pose=self._origin(element, where),
        )
        return self._with_motion(joint, element, where) if joint.movable else joint

    def _with_motion(self, joint: Joint, element: Element, where: str) -> Joint:
        axis, mimic, dynamics = (element.find(tag) for tag in ("axis", "mimic", "dynamics"))
        # URDF's default axis is x.
        joint = replace(joint, axis=(1.0, 0.0, 0.0) if axis is None else self._vector(axis, "xyz", where))
        if dynamics is not None:
            joint = replace(
                joint,
                damping=self._number(dynamics, "damping", where, 0.0),
                friction=self._number(dynamics, "friction", where, 0.0),
            )
        if mimic is not None:
            leader = self._attribute(mimic, "joint", where)
            multiplier = self._number(mimic, "multiplier", where, 1.0)
            joint = replace(joint, mimic=Mimic(leader, multiplier, self._number(mimic, "offset", where, 0.0)))
        return self._with_limits(joint, element, where)

    def _with_limits(self, joint: Joint, element: Element, where: str) -> Joint:
        limit = element.find("limit")
        if limit is None:
            if joint.type is JointType.CONTINUOUS:
                return joint
            raise self._error(f"{where} has no <limit>", "give it one, or make the joint continuous")
        effort, velocity = (_limit(self._number(limit, key, where, np.inf)) for key in ("effort", "velocity"))
        joint = replace(joint, effort_limit=effort, velocity_limit=velocity)
        if joint.type is JointType.CONTINUOUS:
            return joint
        lower, upper = (_limit(self._number(limit, key, where, 0.0)) for key in ("lower", "upper"))
        return replace(joint, lower_limit=lower, upper_limit=upper)

    def _collision(self, element: Element, where: str) -> Iterator[Shape]:
        pose, name = self._origin(element, where), element.get("name", "")
        geometry = self._child(element, "geometry", where)
        mesh = geometry.find("mesh")
        if mesh is None:
            yield Shape(self._primitive(geometry, where), pose, name=name)
            return
        key = self._mesh_file(mesh, where)
        if key not in self.hulls:
            self.hulls[key] = load_mesh(*key, options=self.options, model=self.path)
        yield Shape(self.hulls[key], pose, name=name)

    def _visual(self, element: Element, where: str) -> Iterator[Shape]:
        pose, name = self._origin(element, where), element.get("name", "")
        color = self._material(element)
        geometry = self._child(element, "geometry", where)
        mesh = geometry.find("mesh")
        if mesh is None:
            shape = Shape(self._primitive(geometry, where), pose, name=name)
            yield shape if color is None else replace(shape, color=color)
            return
        key = self._mesh_file(mesh, where)
        if key not in self.parts:
            self.parts[key] = load_parts(*key, options=self.options, model=self.path)
        for part in self.parts[key]:
            shape = Shape(part.mesh, pose, name=name)
            shown = color or part.color
            yield shape if shown is None else replace(shape, color=shown)

    def _primitive(self, geometry: Element, where: str) -> Geometry:
        for child in geometry:
            match child.tag:
                case "box":
                    x, y, z = self._vector(child, "size", where)
                    return Box((x / 2, y / 2, z / 2))
                case "sphere":
                    return Sphere(self._number(child, "radius", where))
                case "cylinder" | "capsule":
                    radius, length = (self._number(child, key, where) for key in ("radius", "length"))
                    return (Cylinder if child.tag == "cylinder" else Capsule)(radius, length / 2)
        raise self._error(f"{where} has a <geometry> of no known kind", "use box, sphere, cylinder, capsule or mesh")

    def _mesh_file(self, mesh: Element, where: str) -> tuple[Path, Vector3]:
        uri = self._attribute(mesh, "filename", where)
        scale = self._vector(mesh, "scale", where, (1.0, 1.0, 1.0))
        with naming(f"in URDF file '{self.path}', {where}"):
            return resolve_file(uri, self.path, self.options), scale

    def _material(self, element: Element) -> Color | None:
        material = element.find("material")
        if material is None:
            return None
        color = material.find("color")
        return self._color(color) if color is not None else self.colors.get(material.get("name", ""))

    def _color(self, element: Element) -> Color:
        r, g, b, a = self._numbers(element, "rgba", "a material", 4)
        return (r, g, b, a)

    def _inertia(self, element: Element, where: str) -> npt.NDArray[np.float64]:
        xx, yy, zz = (self._number(element, key, where) for key in ("ixx", "iyy", "izz"))
        xy, xz, yz = (self._number(element, key, where, 0.0) for key in ("ixy", "ixz", "iyz"))
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def _origin(self, element: Element, where: str) -> Pose:
        origin = element.find("origin")
        if origin is None:
            return Pose()
        position, angles = (self._vector(origin, key, where, (0.0, 0.0, 0.0)) for key in ("xyz", "rpy"))
        return Pose.from_euler(*angles, position=position)

    def _vector(self, element: Element, key: str, where: str, default: Vector3 | None = None) -> Vector3:
        if default is not None and element.get(key) is None:
            return default
        x, y, z = self._numbers(element, key, where, 3)
        return (x, y, z)

    def _number(self, element: Element, key: str, where: str, default: float | None = None) -> float:
        if default is not None and element.get(key) is None:
            return default
        return self._numbers(element, key, where, 1)[0]

    def _numbers(self, element: Element, key: str, where: str, count: int) -> list[float]:
        text = self._attribute(element, key, where)
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            values = []
        if len(values) != count:
            raise self._error(f'{where} has {key}="{text}" in <{element.tag}>', f"give {count} number(s)")
        return values

    def _child(self, element: Element, tag: str, where: str) -> Element:
        child = element.find(tag)
        if child is None:
            raise self._error(f"{where} lacks <{tag}> in <{element.tag}>", "add it")
        return child

    def _attribute(self, element: Element, key: str, where: str) -> str:
        value = element.get(key)
        if value is None:
            raise self._error(f"{where} lacks attribute '{key}' of <{element.tag}>", "add it")
        return value

    def _error(self, fault: str, remedy: str) -> AssetError:
        return AssetError(f"in URDF file '{self.path}', {fault}: {remedy}")


def _limit(value: float) -> float:
    return math.copysign(math.inf, value) if abs(value) >= UNLIMITED else value
