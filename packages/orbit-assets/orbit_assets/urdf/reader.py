"""Reader of URDF and xacro files."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from orbit_assets.compose import sort_links
from orbit_assets.joint_models import BALL, FLOATING, PLANAR, compound, resolve_chains
from orbit_assets.mass_properties import repaired
from orbit_assets.meshes import MeshFiles
from orbit_assets.options import ReadOptions, Repair
from orbit_assets.outside import resolve_file
from orbit_assets.source_text import Fields, Findings, names_file, naming
from orbit_assets.urdf.writer import UNLIMITED
from orbit_assets.xacro import read_expanded
from orbit_core.interfaces.errors import AssetError, UnknownNameError
from orbit_core.preparation.scene_data import extents
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
    Mesh,
    Mimic,
    Plane,
    Pose,
    Shape,
    Sphere,
)
from orbit_core.scene.pose import Vector3

# Shapes of a URDF link: primitives, and meshes from files that several links may share; flat ones thickened.

# Half the thickness (m) that a flat shape gets.
_HALF_THICKNESS = 0.5e-3


def touchable(geometry: Geometry, findings: Findings, where: str) -> Geometry | None:
    """Return a shape that can collide: the shape itself, or a plate 1 mm thick for a flat one.

    Args:
        geometry: of a ``<collision>``.
        findings: notes what is changed or left out.
        where: the link, for the note.

    Returns:
        The shape, or None for a point or a line, which nothing can touch.
    """
    match geometry:
        case Box(half_extents) if 0.0 in half_extents:
            x, y, z = (length or _HALF_THICKNESS for length in half_extents)
            solid = Box((x, y, z)) if half_extents.count(0.0) == 1 else None
        case Cylinder(radius, 0.0) if radius > 0.0:
            solid = Cylinder(radius, _HALF_THICKNESS)
        case Sphere(0.0) | Capsule(0.0) | Cylinder(0.0):
            solid = None
        case Mesh() if extents(geometry.vertices) == 2:
            solid = _thickened(geometry)
        case _:
            return geometry
    if solid is None:
        findings.leave_out("a <collision> of size zero, which nothing touches,", where)
    else:
        findings.note(f"a flat <collision> of {where} is a plate {2e3 * _HALF_THICKNESS:g} mm thick")
    return solid


def _thickened(mesh: Mesh) -> Mesh:
    """Return the convex hull of a flat mesh, with thickness."""
    from trimesh.convex import convex_hull

    points = np.asarray(mesh.vertices, dtype=np.float64)
    centred = points - points.mean(axis=0)
    # The eigenvector of the smallest eigenvalue is the plane's normal.
    normal = np.linalg.eigh(centred.T @ centred).eigenvectors[:, 0]
    hull = convex_hull(np.concatenate((points + _HALF_THICKNESS * normal, points - _HALF_THICKNESS * normal)))
    vertices, faces = np.asarray(hull.vertices, dtype=np.float32), np.asarray(hull.faces, dtype=np.int32)
    return replace(mesh, vertices=np.ascontiguousarray(vertices), faces=np.ascontiguousarray(faces))


# One object for all upright shapes, recognised by identity: composing with it would cost time for nothing.
_UPRIGHT = Pose()
HULLS = "collision meshes of the URDF collide as their convex hulls"
SIZELESS = "a <visual> of size zero, which shows nothing,"
TEXTURES = "surfaces with a picture but no coordinates on it are drawn in one colour, the median of its pixels"


class UrdfShapes:
    """Reader of ``<collision>`` and ``<visual>`` elements of one file, with its named materials.

    Args:
        root: the file's root element.
        path: the file.
        fields: for numbers, errors and notes.
        options: which files may be opened.
    """

    def __init__(self, root: Element, path: Path, fields: Fields, options: ReadOptions) -> None:
        self.path = path
        self.fields = fields
        self.options = options
        self.meshes = MeshFiles(options, path)
        """Reader of mesh files, which keeps each."""
        self.colors: dict[str, Color] = {}
        """Colours of named materials."""
        # Materials may be defined anywhere, and used by name before their definition.
        for material in root.iter("material"):
            color = material.find("color")
            if color is not None and material.get("name"):
                self.colors.setdefault(material.get("name", ""), self._color(color))

    def collision(self, element: Element, where: str) -> Iterator[Shape]:
        """Yield the shape that collides; nothing if the options have it left out.

        Raises:
            AssetError: a number, a file or the geometry is not as it should be.
        """
        pose, name = self.origin(element, where), element.get("name", "")
        geometry = self.fields.child(element, "geometry", where)
        mesh = geometry.find("mesh")
        if mesh is not None:
            self.fields.findings.note(HULLS)
            solids = [(self.meshes.mesh(*self._mesh_file(mesh, where)), _UPRIGHT)]
        else:
            solids = self._primitive(geometry, where)
        for solid, turned in solids:
            shape = touchable(solid, self.fields.findings, where)
            if shape is not None:
                yield Shape(shape, pose if turned is _UPRIGHT else pose @ turned, name=name)

    def visual(self, element: Element, where: str) -> Iterator[Shape]:
        """Yield the shapes that are drawn, one for each colour of a mesh.

        Raises:
            AssetError: as :meth:`collision`.
        """
        pose, name = self.origin(element, where), element.get("name", "")
        color = self._material(element, where)
        geometry = self.fields.child(element, "geometry", where)
        mesh = geometry.find("mesh")
        if mesh is None:
            for solid, turned in self._primitive(geometry, where):
                if is_sizeless(solid):
                    self.fields.findings.leave_out(SIZELESS, where)
                    continue
                shape = Shape(solid, pose @ turned, name=name)
                yield shape if color is None else replace(shape, color=color)
            return
        file, scale = self._mesh_file(mesh, where)
        if 0.0 in scale:
            self.fields.findings.leave_out(SIZELESS, where)
            return
        for part in self.meshes.parts(file, scale):
            shape = Shape(part.mesh, pose, name=name)
            if part.textured and part.texture is None and color is None:
                self.fields.findings.note(TEXTURES)
            yield part.shown(shape) if color is None else replace(shape, color=color)

    def origin(self, element: Element, where: str) -> Pose:
        """Return the pose of ``<origin>``, or the identity.

        Raises:
            AssetError: its numbers are not as they should be.
        """
        origin = element.find("origin")
        if origin is None:
            return Pose()
        position, angles = (self.fields.vector(origin, key, where, (0.0, 0.0, 0.0)) for key in ("xyz", "rpy"))
        return Pose.from_euler(*angles, position=position) if any(angles) else Pose(position)

    def _primitive(self, geometry: Element, where: str) -> Iterator[tuple[Geometry, Pose]]:
        fields = self.fields
        for child in geometry:
            match child.tag:
                case "box":
                    x, y, z = fields.vector(child, "size", where)
                    yield Box((x / 2, y / 2, z / 2)), _UPRIGHT
                case "sphere":
                    yield Sphere(fields.number(child, "radius", where)), _UPRIGHT
                case "cylinder" | "capsule":
                    radius, length = (fields.number(child, key, where) for key in ("radius", "length"))
                    yield (Cylinder if child.tag == "cylinder" else Capsule)(radius, length / 2), _UPRIGHT
                case "plane":  # not in the URDF specification, but in common files
                    yield Plane(), facing(fields.vector(child, "normal", where, (0.0, 0.0, 1.0)))
                case _:
                    fields.findings.unsupported(
                        f"a <geometry> of kind <{child.tag}>", where, "use box, sphere, cylinder, capsule or mesh"
                    )
            return
        raise fields.findings.error(f"{where} has an empty <geometry>", "use box, sphere, cylinder, capsule or mesh")

    def _mesh_file(self, mesh: Element, where: str) -> tuple[Path, Vector3]:
        uri = self.fields.attribute(mesh, "filename", where)
        scale = self.fields.vector(mesh, "scale", where, (1.0, 1.0, 1.0))
        with naming(f"in {self.fields.findings.place}, {where}"):
            return resolve_file(uri, self.path, self.options), scale

    def _material(self, element: Element, where: str) -> Color | None:
        material = element.find("material")
        if material is None:
            return None
        if material.find("texture") is not None:
            self.fields.findings.leave_out("the <texture> of materials", where)
        color = material.find("color")
        return self._color(color) if color is not None else self.colors.get(material.get("name", ""))

    def _color(self, element: Element) -> Color:
        r, g, b, a = self.fields.numbers(element, "rgba", "a material", 4)
        return (r, g, b, a)


def is_sizeless(solid: Geometry) -> bool:
    """Return True if a primitive has no volume, and nobody would see it."""
    match solid:
        case Box(half_extents):
            return 0.0 in half_extents
        case Cylinder(radius, half_length):
            return 0.0 in (radius, half_length)
        case Sphere(radius) | Capsule(radius):
            return radius == 0.0
        case _:
            return False


def facing(normal: Vector3) -> Pose:
    """Return a rotation that takes z to ``normal``, which need not have unit length; the identity for a zero vector."""
    length = float(np.linalg.norm(normal))
    if length == 0.0:
        return Pose()
    x, y, z = (component / length for component in normal)
    if z < -1.0 + 1e-12:
        return Pose.from_axis_angle((1.0, 0.0, 0.0), np.pi)
    # Half way between z and the normal: the shortest turn.
    axis = (-y, x, 0.0)
    angle = float(np.arctan2(np.hypot(x, y), z))
    return Pose() if angle == 0.0 else Pose.from_axis_angle(axis, angle)


def choose_tree(articulation: Articulation, root: str | None) -> Articulation:
    """Return the tree of a description whose root is the link ``root``, with that link's name; all of it for None.

    Raises:
        AssetError: no root is named, and there are several.
        UnknownNameError: no root has that name.
    """
    children = {joint.child for joint in articulation.joints}
    roots = [link.name for link in articulation.links if link.name not in children]
    if root is None:
        if len(roots) > 1:
            listed = ", ".join(f"'{name}'" for name in roots[:8])
            raise AssetError(
                f"'{articulation.name}': there are several roots, {listed}: connect them with joints, or name one by "
                "ReadOptions(articulation=...)"
            )
        return articulation
    if roots == [root] or (len(roots) == 1 and root == articulation.name):
        return articulation
    if root not in roots:
        raise UnknownNameError("articulation", root, roots, f"'{articulation.name}'")
    return _tree(articulation, root)


def _tree(articulation: Articulation, root: str) -> Articulation:
    followers: dict[str, list[str]] = {}
    for joint in articulation.joints:
        followers.setdefault(joint.parent, []).append(joint.child)
    kept, stack = {root}, [root]
    while stack:
        for child in followers.get(stack.pop(), []):
            if child not in kept:
                kept.add(child)
                stack.append(child)
    return replace(
        articulation,
        name=root,
        links=tuple(link for link in articulation.links if link.name in kept),
        joints=tuple(joint for joint in articulation.joints if joint.child in kept),
        loops=tuple(loop for loop in articulation.loops if kept.issuperset((loop.first, loop.second))),
        frames=tuple(frame for frame in articulation.frames if frame.link in kept),
        collision_exclusions=tuple(pair for pair in articulation.collision_exclusions if kept.issuperset(pair)),
        notes=(*articulation.notes, f"the file holds other articulations besides '{root}'"),
    )


_JOINT_TYPES = {type_.value: type_ for type_ in JointType}
# "spherical" and "ball" are not in the URDF specification, but in common files.
_COMPOUND = {"floating": FLOATING, "planar": PLANAR, "spherical": BALL, "ball": BALL}
# Elements that are read; all others are left out with a note.
_KNOWN = {
    "robot": {"link", "joint", "material"},
    "link": {"inertial", "visual", "collision"},
    "joint": {"origin", "parent", "child", "axis", "limit", "dynamics", "mimic"},
}


@names_file
def read_urdf(
    path: Path | str,
    packages: Mapping[str, Path] | None = None,
    name: str | None = None,
    *,
    options: ReadOptions = ReadOptions(),
) -> Articulation:
    """Read the articulation that a URDF or xacro file describes, in link order depth first, fixed joints kept.

    ``packages`` adds folders of packages that ``package://`` names to those of ``options``; one that neither has is
    looked for among the folders above the file. Collision meshes collide as their convex hulls. Visual meshes keep
    their files' colours and textures where the URDF gives none. Floating, planar and ball joints
    become chains of simple ones, but for a floating joint that carries the whole robot: it is left out, for the
    entity's ``fixed_base`` says that. A joint that mimics a mimic follows the leader of both. What is not read, such as
    transmissions, safety controllers and simulators' own elements, is in the notes. Of a file of several trees,
    ``options.articulation`` names the root link of the one to read.

    Raises:
        AssetError: the file, or one that it names, is missing, malformed or describes what ORBIT has no word for.
    """
    path = Path(path)
    return _Reader(path, replace(options, packages={**options.packages, **(packages or {})})).read(name)


class _Reader:
    """Reader of one file."""

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.path = path
        self.options = options
        self.findings = Findings(f"URDF file '{path}'", options)
        self.fields = Fields(self.findings)

    def read(self, name: str | None) -> Articulation:
        root = self._root()
        self.shapes = UrdfShapes(root, self.path, self.fields, self.options)
        self._note_unread(root, "the robot")
        self._leave_free_base(root)
        links = [self._link(element) for element in root.findall("link")]
        joints: list[Joint] = []
        # Joints after links: a compound joint adds links of its chain.
        for element in root.findall("joint"):
            made, single = self._joint(element)
            links += made
            joints += single
        articulation = Articulation(name or root.get("name") or self.path.stem, tuple(links), tuple(joints))
        # Before sorting: a tree is chosen by its root, and sorting accepts one root only.
        articulation = resolve_chains(self._without_lost_leaders(articulation))
        articulation = sort_links(choose_tree(articulation, self.options.articulation))
        return repaired(replace(articulation, notes=(*articulation.notes, *self.findings.notes)), self.options)

    def _root(self) -> Element:
        expanded = read_expanded(self.path, self.options)
        root = expanded.root
        for note in expanded.notes:
            self.findings.note(note)
        if root.tag != "robot":
            raise self.findings.error(f"its root element is <{root.tag}>", "give a URDF file, whose root is <robot>")
        return root

    def _link(self, element: Element) -> Link:
        name = self.fields.attribute(element, "name", "a link")
        where = f"link '{name}'"
        self._note_unread(element, where)
        shapes = self.shapes
        collisions = [shape for child in element.findall("collision") for shape in shapes.collision(child, where)]
        visuals = [shape for child in element.findall("visual") for shape in shapes.visual(child, where)]
        link = Link(name, collisions=tuple(collisions), visuals=tuple(visuals))
        inertial = element.find("inertial")
        if inertial is None:
            return link
        pose = shapes.origin(inertial, where)
        mass = self.fields.number(self.fields.child(inertial, "mass", where), "value", where)
        inertia = self._inertia(inertial, where)
        rotation = pose.rotation_matrix()
        return replace(link, mass=mass, center_of_mass=pose.position, inertia=rotation @ inertia @ rotation.T)

    def _joint(self, element: Element) -> tuple[tuple[Link, ...], tuple[Joint, ...]]:
        """Convert a joint; return the joints and links of the chain if it is compound."""
        name = self.fields.attribute(element, "name", "a joint")
        where = f"joint '{name}'"
        kind = self.fields.attribute(element, "type", where)
        if kind not in _JOINT_TYPES and kind not in _COMPOUND:
            known = ", ".join((*_JOINT_TYPES, *_COMPOUND))
            raise self.findings.error(f"{where} is of type '{kind}'", f"use one of {known}")
        self._note_unread(element, where)
        joint = Joint(
            name,
            _JOINT_TYPES.get(kind, JointType.CONTINUOUS),
            self.fields.attribute(self.fields.child(element, "parent", where), "link", where),
            self.fields.attribute(self.fields.child(element, "child", where), "link", where),
            parent_pose=self.shapes.origin(element, where),
        )
        if not joint.movable:
            return (), (joint,)
        joint = self._with_motion(joint, element, where)
        if kind not in _COMPOUND:
            return (), (joint,)
        return self._compound(joint, kind, where)

    def _compound(self, joint: Joint, kind: str, where: str) -> tuple[tuple[Link, ...], tuple[Joint, ...]]:
        if joint.mimic is not None:
            raise self.findings.error(f"{where}, of type '{kind}', mimics another", "mimic by simple joints")
        if kind == "planar":  # URDF's axis is the plane's normal
            normal = facing(joint.axis)
            joint = replace(joint, parent_pose=joint.parent_pose @ normal, child_pose=normal)
        freedoms = _COMPOUND[kind]
        self.findings.note(f"{where}, of type '{kind}', is {len(freedoms)} simple joints one after another")
        return compound(joint, freedoms)

    def _with_motion(self, joint: Joint, element: Element, where: str) -> Joint:
        axis, mimic, dynamics = (element.find(tag) for tag in ("axis", "mimic", "dynamics"))
        number = self.fields.number
        # URDF's default axis is x.
        joint = replace(joint, axis=(1.0, 0.0, 0.0) if axis is None else self.fields.vector(axis, "xyz", where))
        if dynamics is not None:
            damping, friction = (number(dynamics, key, where, 0.0) for key in ("damping", "friction"))
            joint = replace(joint, damping=damping, friction=friction)
        if mimic is not None:
            leader = self.fields.attribute(mimic, "joint", where)
            law = Mimic(leader, number(mimic, "multiplier", where, 1.0), number(mimic, "offset", where, 0.0))
            joint = replace(joint, mimic=law)
        return self._with_limits(joint, element, where)

    def _with_limits(self, joint: Joint, element: Element, where: str) -> Joint:
        limit = element.find("limit")
        if limit is None:
            if joint.type is JointType.CONTINUOUS:
                return joint
            raise self.findings.error(f"{where} has no <limit>", "give it one, or make the joint continuous")
        number = self.fields.number
        effort, velocity = (_limit(number(limit, key, where, math.inf)) for key in ("effort", "velocity"))
        joint = replace(joint, effort_limit=effort, velocity_limit=velocity)
        if joint.type is JointType.CONTINUOUS:
            return joint
        lower, upper = (_limit(number(limit, key, where, 0.0)) for key in ("lower", "upper"))
        return replace(joint, lower_limit=lower, upper_limit=upper)

    def _without_lost_leaders(self, articulation: Articulation) -> Articulation:
        """Remove laws that name a joint which does not exist, where the options allow it."""
        known = {joint.name for joint in articulation.joints}
        joints: list[Joint] = []
        for joint in articulation.joints:
            if joint.mimic is not None and joint.mimic.joint not in known:
                self.findings.unsupported(
                    f"a <mimic> of the unknown joint '{joint.mimic.joint}'",
                    f"joint '{joint.name}'",
                    "name a joint of the file",
                )
                joint = replace(joint, mimic=None)
            joints.append(joint)
        return replace(articulation, joints=tuple(joints))

    def _inertia(self, inertial: Element, where: str) -> npt.NDArray[np.float64]:
        """Return the inertia in the frame of ``<inertial>``; zero where it is missing and repairs are requested."""
        element = inertial.find("inertia")
        if element is None and self.options.repair is Repair.BALANCE:
            return np.zeros((3, 3))
        if element is None:
            raise self.findings.error(
                f"{where} lacks <inertia> in <inertial>",
                "add it, or have it that of a ball of water by ReadOptions(repair=Repair.BALANCE)",
            )
        number = self.fields.number
        xx, yy, zz = (number(element, key, where) for key in ("ixx", "iyy", "izz"))
        xy, xz, yz = (number(element, key, where, 0.0) for key in ("ixy", "ixz", "iyz"))
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def _leave_free_base(self, root: Element) -> None:
        """Remove a floating joint that carries the whole robot, and the empty link that holds it."""
        found = _free_base(root)
        if found is None:
            return
        joint, holder = found
        for tag, name in (("joint", joint), ("link", holder)):
            root.remove(next(element for element in root.findall(tag) if element.get("name", "") == name))
        self.findings.note(
            f"joint '{joint}' lets the whole robot float and is left out with link '{holder}': give the entity "
            "fixed_base=False"
        )

    def _note_unread(self, element: Element, where: str) -> None:
        for child in element:
            if child.tag not in _KNOWN[element.tag]:
                self.findings.leave_out(f"<{child.tag}>", where)


def _free_base(root: Element) -> tuple[str, str] | None:
    """Find the floating joint that carries the whole robot and its empty parent link; None if there is none."""
    links = {element.get("name"): element for element in root.findall("link")}
    ends = [[(joint.find(tag), joint) for tag in ("parent", "child")] for joint in root.findall("joint")]
    parents, children = ([end[at][0] for end in ends] for at in (0, 1))
    held = [element.get("link") for element in parents if element is not None]
    carried = {element.get("link") for element in children if element is not None}
    for parent, joint in (end[0] for end in ends):
        holder = parent.get("link") if parent is not None else None
        if joint.get("type") != "floating" or holder in carried or held.count(holder) > 1:
            continue
        link = links.get(holder)
        if link is not None and not any(link.find(tag) is not None for tag in _KNOWN["link"]):
            return joint.get("name", ""), holder or ""
    return None


def _limit(value: float) -> float:
    return math.copysign(math.inf, value) if abs(value) >= UNLIMITED else value
