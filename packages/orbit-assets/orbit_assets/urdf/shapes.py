"""Shapes of a URDF link: primitives, and meshes from files that several links may share; flat ones thickened."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from orbit_assets.meshes import MeshFiles
from orbit_assets.naming import naming
from orbit_assets.options import ReadOptions
from orbit_assets.outside import resolve_file
from orbit_assets.source_text import Fields, Findings
from orbit_core.preparation.scene_data import extents
from orbit_core.scene import Box, Capsule, Color, Cylinder, Geometry, Mesh, Plane, Pose, Shape, Sphere
from orbit_core.scene.pose import Vector3

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
TEXTURES = "surfaces with a texture are drawn in one colour, the median of its pixels"


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
        self.colors: dict[str, Color] = {}
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
            shown = color or part.color
            if part.textured and color is None:
                self.fields.findings.note(TEXTURES)
            yield shape if shown is None else replace(shape, color=shown)

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
