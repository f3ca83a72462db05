"""Kinds of objects that ORBIT brings: solids, a table, a cabinet, a dishwasher and a keyed block."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from orbit_assets.objects import (
    DENSITY,
    GRAY,
    WOOD,
    SolidOptions,
    box,
    cabinet,
    capsule,
    cylinder,
    dishwasher,
    keyed_block,
    mesh_object,
    sphere,
    table,
)
from orbit_core.interfaces.errors import AssetError
from orbit_core.objects import ObjectConfig
from orbit_core.scene import Color, Mesh, ObjectSpec, PhysicsMaterial, Pose
from orbit_core.scene.pose import Vector3


@dataclass(frozen=True, kw_only=True)
class SolidConfig(ObjectConfig):
    """One rigid body of uniform density."""

    mass: float | None = None
    """kg; None takes ``density``."""
    density: float = DENSITY
    """kg/m^3, where there is no ``mass``."""
    color: Color = GRAY
    """RGBA in [0, 1]."""
    material: PhysicsMaterial = field(default_factory=PhysicsMaterial)
    """Friction, restitution and compliance."""
    fixed_base: bool = False
    """True for a thing that does not move."""
    label: str = ""
    """Semantic label; the object's name where it is empty."""

    def options(self, pose: Pose | None) -> SolidOptions:
        """Return the options of the functions in :mod:`orbit_assets.objects` other than the shape."""
        options = SolidOptions(
            density=self.density,
            color=self.color,
            material=self.material,
            pose=pose or Pose(),
            fixed_base=self.fixed_base,
            label=self.label,
        )
        # ``mass`` is left out rather than None: the functions distinguish the two.
        if self.mass is not None:
            options["mass"] = self.mass
        return options


@dataclass(frozen=True, kw_only=True)
class BoxConfig(SolidConfig):
    """A solid box, its frame at the middle."""

    name: ClassVar[str] = "box"
    size: Vector3 = (0.05, 0.05, 0.05)
    """Full edge lengths along x, y and z in metres."""

    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        return box(name, self.size, **self.options(pose))

    @property
    def rest_height(self) -> float:
        return 0.5 * self.size[2]


@dataclass(frozen=True, kw_only=True)
class SphereConfig(SolidConfig):
    """A solid ball, its frame at the middle."""

    name: ClassVar[str] = "sphere"
    radius: float = 0.025
    """Metres."""

    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        return sphere(name, self.radius, **self.options(pose))

    @property
    def rest_height(self) -> float:
        return self.radius


@dataclass(frozen=True, kw_only=True)
class CylinderConfig(SolidConfig):
    """A solid cylinder along z, its frame at the middle."""

    name: ClassVar[str] = "cylinder"
    radius: float = 0.025
    """Metres."""
    length: float = 0.1
    """Metres."""

    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        return cylinder(name, self.radius, self.length, **self.options(pose))

    @property
    def rest_height(self) -> float:
        return 0.5 * self.length


@dataclass(frozen=True, kw_only=True)
class CapsuleConfig(SolidConfig):
    """A solid capsule along z, its frame at the middle."""

    name: ClassVar[str] = "capsule"
    radius: float = 0.025
    """Metres."""
    length: float = 0.05
    """Metres between the centres of the round caps."""

    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        return capsule(name, self.radius, self.length, **self.options(pose))

    @property
    def rest_height(self) -> float:
        return 0.5 * self.length + self.radius


@dataclass(frozen=True, kw_only=True)
class MeshConfig(SolidConfig):
    """A solid with the surface of a mesh file, in the file's own frame."""

    name: ClassVar[str] = "mesh"
    file: Path | None = None
    """OBJ, STL or another format that trimesh reads; needed."""
    scale: float = 1.0
    """Metres in the file's unit of length."""

    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        if self.file is None:
            raise AssetError(f"object '{name}' is of kind mesh and has no file: set its parameter 'file'")
        return mesh_object(name, self.file, self.scale, **self.options(pose))

    @property
    def rest_height(self) -> float:
        mesh = self.build(self.name).articulation.root.collisions[0].geometry
        assert isinstance(mesh, Mesh)
        return -float(np.asarray(mesh.vertices)[:, 2].min())


@dataclass(frozen=True, kw_only=True)
class TableConfig(ObjectConfig):
    """A static table with four legs, its frame in the middle of the top surface."""

    name: ClassVar[str] = "table"
    size: Vector3 = (0.8, 1.2, 0.7)
    """Depth (x), width (y) and height in metres."""
    color: Color = WOOD
    """RGBA in [0, 1]."""
    material: PhysicsMaterial = field(default_factory=PhysicsMaterial)
    """Friction, restitution and compliance."""
    label: str = "table"
    """Semantic label."""

    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        return table(name, self.size, color=self.color, material=self.material, pose=pose, label=self.label)

    @property
    def rest_height(self) -> float:
        return self.size[2]


@dataclass(frozen=True, kw_only=True)
class CabinetConfig(ObjectConfig):
    """A static cabinet with a drawer and a door, its frame on the floor in the middle of its footprint."""

    name: ClassVar[str] = "cabinet"

    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        return cabinet(name, pose=pose)

    @property
    def rest_height(self) -> float:
        return 0.0


@dataclass(frozen=True, kw_only=True)
class KeyedBlockConfig(ObjectConfig):
    """A cube with a ridge along one edge, which looks alike in no two orientations; its frame is the cube's middle."""

    name: ClassVar[str] = "keyed"
    edge: float = 0.06
    """Metres."""
    mass: float = 0.08
    """kg"""
    color: Color = GRAY
    """RGBA in [0, 1] of the cube."""
    key_color: Color = (0.75, 0.15, 0.1, 1.0)
    """RGBA in [0, 1] of the ridge."""

    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        return keyed_block(
            name, self.edge, mass=self.mass, color=self.color, key_color=self.key_color, pose=pose or Pose()
        )

    @property
    def rest_height(self) -> float:
        return 0.5 * self.edge


@dataclass(frozen=True, kw_only=True)
class DishwasherConfig(ObjectConfig):
    """A small static dishwasher with a door and a rack, its frame in the middle of its footprint."""

    name: ClassVar[str] = "dishwasher"
    seal: float = 25.0
    """Newtons with which the magnetic seal holds the door shut at its upper edge."""

    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        return dishwasher(name, seal=self.seal, pose=pose)

    @property
    def rest_height(self) -> float:
        return 0.0
