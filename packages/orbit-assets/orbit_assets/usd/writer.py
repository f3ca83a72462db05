"""Writes an articulation to USD, in SI units with z up, such that :func:`orbit_assets.usd.read_usd` gives it back.

Bodies stand side by side below one root prim, where the joints are at home. A shape that only collides has the purpose
"guide". Springs, higher powers of mimics and shapes without names are attributes ``orbit:...``, which no schema has.
Numbers that UsdPhysics holds in single precision come back rounded to it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from orbit_assets.losses import raised_inertias
from orbit_assets.usd.contents import FRAME, MASSLESS
from orbit_assets.usd.geometry import APPROXIMATIONS, UNNAMED
from orbit_assets.usd.joint_writer import JointWriter
from orbit_assets.usd.library import pxr
from orbit_assets.usd.prims import assign, assign_custom, define, place, quatf
from orbit_core.files import written_whole
from orbit_core.interfaces.errors import AssetError, StorageError
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Cylinder,
    JointType,
    Link,
    Mesh,
    PhysicsMaterial,
    Plane,
    Pose,
    Shape,
    Sphere,
)
from orbit_core.scene.inertias import SINGLE, solid_moments

_REASON = re.compile(r" : '(.*)'")
"""What USD's errors say went wrong, behind where."""


def write_usd(articulation: Articulation, path: str | Path) -> tuple[str, ...]:
    """Write one articulation to a ``.usda``, ``.usdc`` or ``.usd`` file, and give what it cannot hold, a sentence each.

    The file is overwritten. Bodies stand at the home positions that the articulation names.

    Raises:
        AssetError: the file's suffix is another, a shape is of a kind that USD lacks, or USD is not installed.
        StorageError: the file cannot be written.
    """
    path = Path(path)
    if path.suffix not in (".usda", ".usdc", ".usd"):
        raise AssetError(f"{path} is to be a USD file: name it *.usda, *.usdc or *.usd")
    with pxr().Tf.DiagnosticTrap() as trap:
        writer = _Writer(articulation)
        writer.write()
        with written_whole(path) as written:
            try:
                writer.stage.GetRootLayer().Export(str(written))
            except pxr().Tf.ErrorException as error:
                reason = _REASON.search(str(error))
                raise StorageError(f"cannot write {path}: {reason.group(1) if reason else error}") from None
        trap.Clear()
    return tuple(_losses(articulation))


def _losses(articulation: Articulation) -> Iterator[str]:
    limits = {joint.name: joint.effort_limit for joint in articulation.joints}
    for drive in articulation.drives:
        if drive.effort_limit != limits.get(drive.joint):
            yield f"USD has one effort limit of a joint and its drive: of '{drive.joint}' it holds the joint's"
    yield from raised_inertias(articulation)
    for link in articulation.links:
        if link.mass > 0 and not link.inertia.any():
            yield f"USD takes the inertia of link '{link.name}', which is zero, as one to be computed"
        if link.mass <= 0 and link.collisions:
            yield f"readers other than ORBIT's compute a mass of link '{link.name}', which has none, of its colliders"


class _Writer:
    def __init__(self, articulation: Articulation) -> None:
        self.articulation = articulation
        self.stage: Any = pxr().Usd.Stage.CreateInMemory()
        self.materials: dict[PhysicsMaterial, Any] = {}
        self.links: dict[str, Any] = {}

    def write(self) -> None:
        pxr().UsdGeom.SetStageMetersPerUnit(self.stage, 1.0)
        pxr().UsdGeom.SetStageUpAxis(self.stage, pxr().UsdGeom.Tokens.z)
        pxr().UsdPhysics.SetStageKilogramsPerUnit(self.stage, 1.0)
        top = define(self.stage, None, self.articulation.name, "Xform")
        self.stage.SetDefaultPrim(top)
        assign(top, "NewtonArticulationRootAPI", {"newton:selfCollisionEnabled": self.articulation.self_collisions})
        poses = _home_poses(self.articulation)
        for link in self.articulation.links:
            self.links[link.name] = self._link(top, link, poses[link.name])
        for frame in self.articulation.frames:
            prim = define(self.stage, self.links[frame.link], frame.name, "Xform")
            place(prim, frame.pose)
            assign_custom(prim, {FRAME: True})
        for first, second in self.articulation.collision_exclusions:
            pairs = pxr().UsdPhysics.FilteredPairsAPI.Apply(self.links[first]).CreateFilteredPairsRel()
            pairs.AddTarget(self.links[second].GetPath())
        JointWriter(self.articulation, self.stage, self.links).write(top)

    def _link(self, top: Any, link: Link, pose: Pose) -> Any:
        prim = define(self.stage, top, link.name, "Xform")
        place(prim, pose)
        pxr().UsdPhysics.RigidBodyAPI.Apply(prim)
        if link.mass > 0:
            moments, axes = solid_moments(link.inertia, SINGLE)
            diagonal = pxr().Gf.Vec3f(*(float(moment) for moment in moments))
            attributes = {"mass": link.mass, "centerOfMass": link.center_of_mass, "diagonalInertia": diagonal}
            assign(prim, "PhysicsMassAPI", {f"physics:{name}": value for name, value in attributes.items()})
            prim.GetAttribute("physics:principalAxes").Set(quatf(axes))
        elif link.collisions:
            assign_custom(prim, {MASSLESS: True})
        if link.semantic_label:
            pxr().UsdSemantics.LabelsAPI.Apply(prim, "class").CreateLabelsAttr([link.semantic_label])
        for shape, collides, drawn in _interleaved(link):
            gprim = self._shape(prim, shape)
            if collides:
                self._make_collider(gprim, shape)
            if not drawn:
                gprim.GetAttribute("purpose").Set("guide")
        return prim

    def _shape(self, parent: Any, shape: Shape) -> Any:
        geometry = shape.geometry
        kind = "Cube" if isinstance(geometry, Box) else type(geometry).__name__
        prim = define(self.stage, parent, shape.name or "shape", kind)
        place(prim, shape.pose, geometry.half_extents if isinstance(geometry, Box) else None)
        match geometry:
            case Box():
                attributes: dict[str, Any] = {"size": 2.0}
            case Sphere(radius=radius):
                attributes = {"radius": radius}
            case Capsule(radius=radius, half_length=half) | Cylinder(radius=radius, half_length=half):
                attributes = {"radius": radius, "height": 2.0 * half, "axis": "Z"}
            case Plane():
                attributes = {"axis": "Z"}
            case Mesh(vertices=vertices, faces=faces):
                attributes = {
                    "points": np.asarray(vertices, dtype=np.float32),
                    "faceVertexCounts": np.full(len(faces), 3, dtype=np.int32),
                    "faceVertexIndices": np.asarray(faces, dtype=np.int32).ravel(),
                    "subdivisionScheme": "none",
                }
            case _:
                raise AssetError(f"USD has no {kind} for shape '{shape.name}': write it as a mesh")
        assign(prim, None, attributes)
        if not shape.name:
            assign_custom(prim, {UNNAMED: True})
        _paint(prim, shape)
        return prim

    def _make_collider(self, prim: Any, shape: Shape) -> None:
        pxr().UsdPhysics.CollisionAPI.Apply(prim)
        if isinstance(shape.geometry, Mesh):
            (approximation,) = (name for name, kind in APPROXIMATIONS.items() if kind is shape.geometry.collision)
            assign(prim, "PhysicsMeshCollisionAPI", {"physics:approximation": approximation})
        material = pxr().UsdShade.Material(self._material(shape.material))
        pxr().UsdShade.MaterialBindingAPI.Apply(prim).Bind(
            material, pxr().UsdShade.Tokens.weakerThanDescendants, "physics"
        )

    def _material(self, material: PhysicsMaterial) -> Any:
        if material in self.materials:
            return self.materials[material]
        top = self.stage.GetDefaultPrim()
        scope = self.stage.GetPrimAtPath(top.GetPath().AppendChild("materials")) or define(
            self.stage, top, "materials", "Scope"
        )
        prim = define(self.stage, scope, f"material_{len(self.materials)}", "Material")
        standard = {
            "physics:staticFriction": material.static_friction,
            "physics:dynamicFriction": material.dynamic_friction,
            "physics:restitution": material.restitution,
        }
        further = {
            "newton:torsionalFriction": material.torsional_friction,
            "newton:rollingFriction": material.rolling_friction,
        }
        if material.compliance:
            further["newton:contactStiffness"] = material.compliance.stiffness
            further["newton:contactDamping"] = material.compliance.damping
        assign(prim, "NewtonMaterialAPI", standard | further)
        self.materials[material] = prim
        return prim


def _paint(prim: Any, shape: Shape) -> None:
    gprim = pxr().UsdGeom.Gprim(prim)
    red, green, blue, alpha = shape.color
    shown = pxr().Gf.Vec3f(float(red), float(green), float(blue))
    gprim.CreateDisplayColorAttr(pxr().Vt.Vec3fArray([shown]))
    if alpha != 1.0:
        gprim.CreateDisplayOpacityAttr(pxr().Vt.FloatArray([alpha]))


def _interleaved(link: Link) -> list[tuple[Shape, bool, bool]]:
    """All shapes of a link with whether each collides and is drawn, in an order that keeps both of the link's orders.

    Where no order keeps both, or a shape stands in one of them twice, what is drawn is written apart from the rest.
    """
    colliding = dict.fromkeys(link.collisions)
    both = [shape for shape in dict.fromkeys(link.visuals) if shape in colliding]
    twice = len(colliding) < len(link.collisions) or len(set(link.visuals)) < len(link.visuals)
    if twice or both != [shape for shape in colliding if shape in set(both)]:
        return [*((shape, True, False) for shape in link.collisions), *((s, False, True) for s in link.visuals)]
    written: list[tuple[Shape, bool, bool]] = []
    solid, drawn = iter(link.collisions), iter(link.visuals)
    for shared in both:
        written += [(shape, True, False) for shape in iter(lambda: next(solid), shared)]
        written += [(shape, False, True) for shape in iter(lambda: next(drawn), shared)]
        written.append((shared, True, True))
    return [*written, *((shape, True, False) for shape in solid), *((shape, False, True) for shape in drawn)]


def _home_poses(articulation: Articulation) -> dict[str, Pose]:
    """Each link's pose in the root's frame at home: zero, where the articulation names nothing else."""
    home = dict(articulation.home)
    for joint in articulation.joints:
        if joint.mimic is not None:
            home[joint.name] = float(joint.mimic.position(home.get(joint.mimic.joint, 0.0)))
    poses = {articulation.root.name: Pose()}
    for joint in articulation.joints:
        position = home.get(joint.name, 0.0)
        x, y, z = joint.axis
        moved = Pose.from_axis_angle(joint.axis, position)
        if joint.type is JointType.PRISMATIC:
            moved = Pose((position * x, position * y, position * z))
        poses[joint.child] = poses[joint.parent] @ joint.parent_pose @ moved @ joint.child_pose.inverse()
    return poses
