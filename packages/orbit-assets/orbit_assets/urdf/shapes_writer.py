"""Shapes of a link as URDF writes them, meshes in OBJ files that several shapes may share."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from orbit_assets.urdf.text import numbers, origin
from orbit_core.files import written_whole
from orbit_core.scene import Box, Capsule, Color, Cylinder, HeightField, Mesh, Plane, Shape, Sphere


class ShapeWriter:
    """Adds ``<visual>`` and ``<collision>`` elements to links, and writes each mesh once.

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
        """The mesh's file, named from the URDF file; written with the first shape that uses it."""
        if id(mesh) not in self._files:
            path = write_mesh(mesh, self.folder, name)
            # The mesh is kept with its file's name, so that no other takes its place in memory meanwhile.
            self._files[id(mesh)] = mesh, Path(os.path.relpath(path, self.base)).as_posix()
        return self._files[id(mesh)][1]


def write_mesh(mesh: Mesh, folder: Path, name: str) -> Path:
    """Write a mesh's triangles as Wavefront OBJ, in full single precision, and return the file.

    The file's name ends in a digest of what it holds. So no file is replaced by one that differs: a model of the same
    folder, or the one that is being overwritten, keeps its meshes.

    Args:
        mesh: the triangles.
        folder: for the file; made where it is missing.
        name: of the shape, with which the file's name begins.
    """
    vertices = "".join("v {:.9g} {:.9g} {:.9g}\n".format(*vertex) for vertex in np.asarray(mesh.vertices).tolist())
    faces = "".join("f {} {} {}\n".format(*face) for face in (np.asarray(mesh.faces) + 1).tolist())
    data = (vertices + faces).encode("ascii")
    plain = "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in name)[:80]
    path = folder / f"{plain}_{hashlib.sha256(data).hexdigest()[:12]}.obj"
    folder.mkdir(parents=True, exist_ok=True)
    if not path.is_file() or path.read_bytes() != data:
        with written_whole(path) as written:
            written.write_bytes(data)
    return path
