"""Shapes of an SDFormat link: primitives, planes and meshes, with friction and colour."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element

from orbit_assets.meshes import MeshFiles
from orbit_assets.naming import naming
from orbit_assets.options import ReadOptions
from orbit_assets.outside import resolve_file
from orbit_assets.sdf.fields import SdfFields
from orbit_assets.thin_shapes import touchable
from orbit_assets.urdf.shapes import SIZELESS, TEXTURES, facing, is_sizeless
from orbit_core.scene import Box, Capsule, Color, Cylinder, Geometry, PhysicsMaterial, Plane, Pose, Shape, Sphere
from orbit_core.scene.pose import Vector3

_HULLS = "collision meshes of the SDF collide as their convex hulls"
_KNOWN = {
    "visual": {"pose", "geometry", "material", "cast_shadows", "visibility_flags"},
    "collision": {"pose", "geometry", "surface", "density"},
    "material": {"ambient", "diffuse", "specular", "emissive", "lighting", "double_sided"},
}


class SdfShapes:
    """Reads ``<collision>`` and ``<visual>`` elements of one file.

    Args:
        path: the file, from which meshes are named.
        fields: for values, errors and notes.
        options: which files may be opened.
    """

    def __init__(self, path: Path, fields: SdfFields, options: ReadOptions) -> None:
        self.path = path
        self.fields = fields
        self.options = options
        self.meshes = MeshFiles(options, path)

    def collision(self, element: Element, pose: Pose, where: str) -> Iterator[Shape]:
        """What collides, at ``pose`` in the link.

        Raises:
            AssetError: a value, a file or the geometry is not as it should be.
        """
        self._note_unread(element, where)
        material, name = self._material(element, where), element.get("name", "")
        for kind, child in self._geometry(element, where):
            if kind == "mesh":
                self.fields.findings.note(_HULLS)
                solids = [(self.meshes.mesh(*self._mesh_file(child, where)), Pose())]
            else:
                solids = self._primitive(kind, child, where)
            for solid, turned in solids:
                shape = touchable(solid, self.fields.findings, where)
                if shape is not None:
                    yield Shape(shape, pose @ turned, material, name=name)

    def visual(self, element: Element, pose: Pose, where: str) -> Iterator[Shape]:
        """What is drawn, at ``pose`` in the link, one shape for each colour of a mesh.

        Raises:
            AssetError: as :meth:`collision`.
        """
        self._note_unread(element, where)
        color, name = self._color(element, where), element.get("name", "")
        for kind, child in self._geometry(element, where):
            if kind != "mesh":
                for solid, turned in self._primitive(kind, child, where):
                    if is_sizeless(solid):
                        self.fields.findings.leave_out(SIZELESS, where)
                        continue
                    shape = Shape(solid, pose @ turned, name=name)
                    yield shape if color is None else replace(shape, color=color)
                continue
            file, scale = self._mesh_file(child, where)
            if 0.0 in scale:
                self.fields.findings.leave_out(SIZELESS, where)
                continue
            for part in self.meshes.parts(file, scale):
                shown = color or part.color
                if part.textured and color is None:
                    self.fields.findings.note(TEXTURES)
                shape = Shape(part.mesh, pose, name=name)
                yield shape if shown is None else replace(shape, color=shown)

    def _geometry(self, element: Element, where: str) -> Iterator[tuple[str, Element]]:
        geometry = element.find("geometry")
        if geometry is None or not len(geometry):
            raise self.fields.findings.error(f"{where} has a <{element.tag}> without <geometry>", "add it")
        return ((child.tag, child) for child in geometry if child.tag != "empty")

    def _primitive(self, kind: str, child: Element, where: str) -> Iterator[tuple[Geometry, Pose]]:
        fields = self.fields
        match kind:
            case "box":
                x, y, z = fields.vector(child, "size", where)
                yield Box((x / 2, y / 2, z / 2)), Pose()
            case "sphere":
                yield Sphere(fields.number(child, "radius", where)), Pose()
            case "cylinder" | "capsule":
                radius, length = (fields.number(child, key, where) for key in ("radius", "length"))
                yield (Cylinder if kind == "cylinder" else Capsule)(radius, length / 2), Pose()
            case "plane":
                yield Plane(), facing(fields.vector(child, "normal", where, "0 0 1"))
            case _:
                remedy = "use box, sphere, cylinder, capsule, plane or mesh"
                fields.findings.unsupported(f"a <geometry> of kind <{kind}>", where, remedy)

    def _mesh_file(self, mesh: Element, where: str) -> tuple[Path, Vector3]:
        if mesh.find("submesh") is not None:
            self.fields.findings.unsupported("a <submesh>", where, "export the part as a file of its own")
        uri = self.fields.text(mesh, "uri", where)
        with naming(f"in {self.fields.findings.place}, {where}"):
            return resolve_file(uri, self.path, self.options), self.fields.vector(mesh, "scale", where, "1 1 1")

    def _material(self, element: Element, where: str) -> PhysicsMaterial:
        """Friction and restitution; what SDFormat leaves out has ORBIT's defaults, of which mu is the same."""
        surface = element.find("surface")
        material = PhysicsMaterial()
        if surface is None:
            return material
        ode, bounce = surface.find("friction/ode"), surface.find("bounce")
        if ode is not None:
            mu = self.fields.number(ode, "mu", where, 1.0)
            if self.fields.number(ode, "mu2", where, mu) != mu:
                self.fields.findings.note("friction that differs by direction has its first value in all")
            material = replace(material, static_friction=mu, dynamic_friction=mu)
        if bounce is not None:
            material = replace(material, restitution=self.fields.number(bounce, "restitution_coefficient", where, 0.0))
        for child in surface:
            if child.tag not in ("friction", "bounce"):
                self.fields.findings.leave_out(f"<{child.tag}> of surfaces", where)
        return material

    def _color(self, element: Element, where: str) -> Color | None:
        material = element.find("material")
        if material is None:
            return None
        self._note_unread(material, where)
        for tag in ("diffuse", "ambient"):
            text = self.fields.text(material, tag, where, "")
            if text:
                count = 3 if len(text.split()) == 3 else 4
                r, g, b, *a = self.fields.numbers(material, tag, where, count)
                return (r, g, b, a[0] if a else 1.0)
        return None

    def _note_unread(self, element: Element, where: str) -> None:
        for child in element:
            if child.tag not in _KNOWN[element.tag]:
                self.fields.findings.leave_out(f"<{child.tag}> of a {element.tag}", where)
