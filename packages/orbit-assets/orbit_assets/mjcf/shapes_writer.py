"""Shapes of a link as MJCF's geoms, meshes in OBJ files that several geoms may share."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from orbit_assets.urdf.shapes_writer import write_mesh
from orbit_assets.urdf.text import numbers
from orbit_core.scene import (
    Box,
    Capsule,
    Cylinder,
    HeightField,
    Link,
    Mesh,
    PhysicsMaterial,
    Plane,
    Pose,
    Shape,
    Sphere,
)

_DRAWN, _HIDDEN = "0", "3"
"""Groups of geoms that MuJoCo's viewer draws, and that it hides."""


class GeomWriter:
    """Adds ``<geom>`` elements to bodies, and writes each mesh once.

    Args:
        asset: the element that lists the model's meshes.
        folder: for the mesh files; made with the first.
        base: the MJCF file's folder, from which they are named.
        self_collisions: whether the links collide with each other.
    """

    def __init__(self, asset: Element, folder: Path, base: Path, *, self_collisions: bool) -> None:
        self.asset = asset
        self.folder = folder
        self.base = base
        self.affinity = "1" if self_collisions else "0"
        self._meshes: dict[int, tuple[Mesh, str]] = {}
        self._names: set[str] = set()

    def write(self, body: Element, link: Link, *, is_root: bool) -> None:
        """Add a link's shapes: one that collides and is drawn alike is one geom."""
        drawn = list(link.visuals)
        for shape in link.collisions:
            both = shape in drawn
            if both:
                drawn.remove(shape)
            masks = {"contype": "1", "conaffinity": self.affinity, "group": _DRAWN if both else _HIDDEN}
            self._geom(body, shape, masks, is_root=is_root)
        for shape in drawn:
            self._geom(body, shape, {"contype": "0", "conaffinity": "0", "group": "1"}, is_root=is_root)

    def _geom(self, body: Element, shape: Shape, masks: dict[str, str], *, is_root: bool) -> None:
        if isinstance(shape.geometry, HeightField) or (isinstance(shape.geometry, Plane) and not is_root):
            return
        named = {"name": self._unique(shape.name)} if shape.name else {}
        element = SubElement(body, "geom", {**named, **self._form(shape), **masks, "rgba": numbers(shape.color)})
        place(element, shape.pose)
        if masks["contype"] != "0":
            _rub(element, shape.material)

    def _form(self, shape: Shape) -> dict[str, str]:
        match shape.geometry:
            case Box(half_extents=half):
                return {"type": "box", "size": numbers(half)}
            case Sphere(radius=radius):
                return {"type": "sphere", "size": numbers((radius,))}
            case Capsule(radius=radius, half_length=half):
                return {"type": "capsule", "size": numbers((radius, half))}
            case Cylinder(radius=radius, half_length=half):
                return {"type": "cylinder", "size": numbers((radius, half))}
            case Mesh() as mesh:
                return {"type": "mesh", "mesh": self._mesh(mesh, shape.name)}
            case _:
                return {"type": "plane", "size": "0 0 1"}

    def _mesh(self, mesh: Mesh, name: str) -> str:
        """The name of a mesh; its file is written with the first geom that uses it."""
        if id(mesh) not in self._meshes:
            # MuJoCo asks for four corners at least, though the faces need not use them all.
            vertices = np.concatenate([mesh.vertices, *[mesh.vertices[-1:]] * max(0, 4 - len(mesh.vertices))])
            path = write_mesh(replace(mesh, vertices=vertices), self.folder, name or "mesh")
            if all(path.stem != called for _, called in self._meshes.values()):
                file = Path(os.path.relpath(path, self.base)).as_posix()
                # Bodies have inertias of their own, and a mesh drawn alone need enclose no volume.
                SubElement(self.asset, "mesh", name=path.stem, file=file, inertia="shell")
            self._meshes[id(mesh)] = mesh, path.stem
        return self._meshes[id(mesh)][1]

    def _unique(self, name: str) -> str:
        """MJCF has one name for each geom of a model, where the description has one for each of a link."""
        number, own = 1, name
        while own in self._names:
            number += 1
            own = f"{name}_{number}"
        self._names.add(own)
        return own


def place(element: Element, pose: Pose) -> None:
    """Give an element the position and quaternion of a pose, unless that is the identity."""
    if pose != Pose():
        element.set("pos", numbers(pose.position))
        element.set("quat", numbers(pose.orientation))


def _rub(element: Element, material: PhysicsMaterial) -> None:
    """Friction, in as many directions of a contact as have some."""
    sliding, torsional, rolling = material.dynamic_friction, material.torsional_friction, material.rolling_friction
    dimensions = 6 if rolling > 0 else 4 if torsional > 0 else 3 if sliding > 0 else 1
    element.set("condim", str(dimensions))
    element.set("friction", numbers((sliding, torsional, rolling)))
