"""Writes an articulation to USD, in SI units with z up, such that :func:`orbit_core.assets.usd.read_usd` gives it back.

Bodies stand side by side below one root prim, where all joint positions are zero. A shape that only collides has the
purpose "guide". Numbers that UsdPhysics holds in single precision come back rounded to it.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from orbit_core.assets.inertia import principal_axes
from orbit_core.assets.usd_contents import FRAME
from orbit_core.assets.usd_library import pxr
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Cylinder,
    Joint,
    JointType,
    Link,
    Mesh,
    MeshCollision,
    PhysicsMaterial,
    Plane,
    Pose,
    Shape,
    Sphere,
)
from orbit_core.scene.pose import Vector3


def write_usd(articulation: Articulation, path: str | Path) -> None:
    """Write one articulation to a ``.usda``, ``.usdc`` or ``.usd`` file; overwrites it.

    Raises:
        AssetError: the file's suffix is another, a link collides but has no mass, a shape is of a kind that USD lacks,
            the links close a loop, or USD is not installed.
    """
    if articulation.loops:
        loop = articulation.loops[0].name
        raise AssetError(f"'{articulation.name}': files hold trees of links and not loop '{loop}': remove it first")
    if Path(path).suffix not in (".usda", ".usdc", ".usd"):
        raise AssetError(f"{path} is to be a USD file: name it *.usda, *.usdc or *.usd")
    writer = _Writer(articulation)
    writer.write()
    writer.stage.GetRootLayer().Export(str(path))


class _Writer:
    def __init__(self, articulation: Articulation) -> None:
        self.articulation = articulation
        self.stage: Any = pxr().Usd.Stage.CreateInMemory()
        self.materials: dict[PhysicsMaterial, Any] = {}
        self.links: dict[str, Any] = {}
        self.joints: dict[str, Any] = {}

    def write(self) -> None:
        pxr().UsdGeom.SetStageMetersPerUnit(self.stage, 1.0)
        pxr().UsdGeom.SetStageUpAxis(self.stage, pxr().UsdGeom.Tokens.z)
        pxr().UsdPhysics.SetStageKilogramsPerUnit(self.stage, 1.0)
        top = self._define(None, self.articulation.name, "Xform")
        self.stage.SetDefaultPrim(top)
        _set(top, "NewtonArticulationRootAPI", {"newton:selfCollisionEnabled": self.articulation.self_collisions})
        poses = _zero_poses(self.articulation)
        for link in self.articulation.links:
            self.links[link.name] = self._link(top, link, poses[link.name])
        for frame in self.articulation.frames:
            prim = self._define(self.links[frame.link], frame.name, "Xform")
            _place(prim, frame.pose)
            prim.CreateAttribute(FRAME, pxr().Sdf.ValueTypeNames.Bool, custom=True).Set(True)
        for first, second in self.articulation.collision_exclusions:
            pairs = pxr().UsdPhysics.FilteredPairsAPI.Apply(self.links[first]).CreateFilteredPairsRel()
            pairs.AddTarget(self.links[second].GetPath())
        if self.articulation.joints:
            scope = self._define(top, "joints", "Scope")
            for joint in self.articulation.joints:
                self.joints[joint.name] = self._joint(scope, joint)
            for joint in self.articulation.joints:
                self._mimic(joint)

    def _define(self, parent: Any, name: str, kind: str) -> Any:
        """A new prim below ``parent``; USD's name for it is made valid and unique, and its display name is ``name``."""
        base = parent.GetPath() if parent else self.stage.GetPseudoRoot().GetPath()
        valid = pxr().Tf.MakeValidIdentifier(name)
        path, number = base.AppendChild(valid), 1
        while self.stage.GetPrimAtPath(path):
            path, number = base.AppendChild(f"{valid}_{number}"), number + 1
        prim = self.stage.DefinePrim(path, kind)
        if prim.GetName() != name:
            prim.SetDisplayName(name)
        return prim

    def _link(self, top: Any, link: Link, pose: Pose) -> Any:
        if link.collisions and link.mass <= 0:
            raise AssetError(
                f"link '{link.name}' of '{self.articulation.name}' collides but has no mass: USD takes that as "
                f"'compute it'; give it one"
            )
        prim = self._define(top, link.name, "Xform")
        _place(prim, pose)
        pxr().UsdPhysics.RigidBodyAPI.Apply(prim)
        if link.mass > 0:
            moments, axes = principal_axes(link.inertia)
            diagonal = pxr().Gf.Vec3f(*(float(moment) for moment in moments))
            attributes = {"mass": link.mass, "centerOfMass": link.center_of_mass, "diagonalInertia": diagonal}
            _set(prim, "PhysicsMassAPI", {f"physics:{name}": value for name, value in attributes.items()})
            prim.GetAttribute("physics:principalAxes").Set(_quatf(Pose.from_matrix(axes)))
        if link.semantic_label:
            pxr().UsdSemantics.LabelsAPI.Apply(prim, "class").CreateLabelsAttr([link.semantic_label])
        for shape in link.collisions:
            gprim = self._shape(prim, shape)
            self._make_collider(gprim, shape)
            if shape not in link.visuals:
                gprim.GetAttribute("purpose").Set("guide")
        for shape in link.visuals:
            if shape not in link.collisions:
                self._shape(prim, shape)
        return prim

    def _shape(self, parent: Any, shape: Shape) -> Any:
        geometry = shape.geometry
        kind = "Cube" if isinstance(geometry, Box) else type(geometry).__name__
        prim = self._define(parent, shape.name or "shape", kind)
        _place(prim, shape.pose, geometry.half_extents if isinstance(geometry, Box) else None)
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
        _set(prim, None, attributes)
        _paint(prim, shape)
        return prim

    def _make_collider(self, prim: Any, shape: Shape) -> None:
        pxr().UsdPhysics.CollisionAPI.Apply(prim)
        if isinstance(shape.geometry, Mesh):
            triangles = shape.geometry.collision is MeshCollision.TRIANGLES
            _set(prim, "PhysicsMeshCollisionAPI", {"physics:approximation": "none" if triangles else "convexHull"})
        material = pxr().UsdShade.Material(self._material(shape.material))
        pxr().UsdShade.MaterialBindingAPI.Apply(prim).Bind(
            material, pxr().UsdShade.Tokens.weakerThanDescendants, "physics"
        )

    def _material(self, material: PhysicsMaterial) -> Any:
        if material in self.materials:
            return self.materials[material]
        top = self.stage.GetDefaultPrim()
        scope = self.stage.GetPrimAtPath(top.GetPath().AppendChild("materials")) or self._define(
            top, "materials", "Scope"
        )
        prim = self._define(scope, f"material_{len(self.materials)}", "Material")
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
        _set(prim, "NewtonMaterialAPI", standard | further)
        self.materials[material] = prim
        return prim

    def _joint(self, scope: Any, joint: Joint) -> Any:
        angular = joint.type in (JointType.REVOLUTE, JointType.CONTINUOUS)
        kind = "Revolute" if angular else "Prismatic" if joint.movable else "Fixed"
        prim = self._define(scope, joint.name, f"Physics{kind}Joint")
        axis, turn = _usd_axis(joint.axis)
        for side, link, pose in (("0", joint.parent, joint.parent_pose), ("1", joint.child, joint.child_pose)):
            frame = pose @ turn
            prim.GetRelationship(f"physics:body{side}").SetTargets([self.links[link].GetPath()])
            prim.GetAttribute(f"physics:localPos{side}").Set(frame.position)
            prim.GetAttribute(f"physics:localRot{side}").Set(_quatf(frame))
        if not joint.movable:
            return prim
        position = math.degrees(1.0) if angular else 1.0
        attributes: dict[str, Any] = {"physics:axis": axis}
        if joint.type is not JointType.CONTINUOUS:
            limits = {"physics:lowerLimit": joint.lower_limit, "physics:upperLimit": joint.upper_limit}
            attributes |= {name: value * position for name, value in limits.items() if math.isfinite(value)}
        _set(prim, None, attributes)
        if math.isfinite(joint.effort_limit):
            drive = "angular" if angular else "linear"
            _set(prim, f"PhysicsDriveAPI:{drive}", {f"drive:{drive}:physics:maxForce": joint.effort_limit})
        dynamics = {
            "newton:armature": joint.armature,
            "newton:damping": joint.damping / position,
            "newton:friction": joint.friction,
            "newton:velocityLimit": joint.velocity_limit * position,
        }
        _set(prim, "NewtonJointAPI", dynamics)
        return prim

    def _mimic(self, joint: Joint) -> None:
        if joint.mimic is None:
            return
        leader = next(other for other in self.articulation.joints if other.name == joint.mimic.joint)
        follower_unit, leader_unit = (
            1.0 if each.type is JointType.PRISMATIC else math.degrees(1.0) for each in (joint, leader)
        )
        prim = self.joints[joint.name]
        coefficients = {
            "newton:mimicCoef0": joint.mimic.offset * follower_unit,
            "newton:mimicCoef1": joint.mimic.multiplier * follower_unit / leader_unit,
        }
        _set(prim, "NewtonMimicAPI", coefficients)
        prim.GetRelationship("newton:mimicJoint").SetTargets([self.joints[leader.name].GetPath()])


def _set(prim: Any, schema: str | None, attributes: dict[str, Any]) -> None:
    """Apply a schema by name, ``Schema:instance`` where it may be applied several times, and set attributes of it."""
    if schema:
        name, *instance = schema.split(":")
        prim.ApplyAPI(name, *instance)
    for key, value in attributes.items():
        prim.GetAttribute(key).Set(value)


def _place(prim: Any, pose: Pose, scale: Vector3 | None = None) -> None:
    transform = pxr().UsdGeom.Xformable(prim)
    transform.AddTranslateOp().Set(pxr().Gf.Vec3d(*pose.position))
    w, x, y, z = pose.orientation
    transform.AddOrientOp(pxr().UsdGeom.XformOp.PrecisionDouble).Set(pxr().Gf.Quatd(w, x, y, z))
    if scale:
        transform.AddScaleOp(pxr().UsdGeom.XformOp.PrecisionDouble).Set(pxr().Gf.Vec3d(*scale))


def _paint(prim: Any, shape: Shape) -> None:
    gprim = pxr().UsdGeom.Gprim(prim)
    red, green, blue, alpha = shape.color
    gprim.CreateDisplayColorAttr(pxr().Vt.Vec3fArray([pxr().Gf.Vec3f(red, green, blue)]))
    if alpha != 1.0:
        gprim.CreateDisplayOpacityAttr(pxr().Vt.FloatArray([alpha]))


def _quatf(pose: Pose) -> Any:
    w, x, y, z = pose.orientation
    return pxr().Gf.Quatf(w, x, y, z)


def _usd_axis(axis: Vector3) -> tuple[str, Pose]:
    """The name of a joint axis, and the turn of the joint's frames that takes that axis to the one given."""
    for name, basis in zip("XYZ", np.eye(3), strict=True):
        if np.array_equal(axis, basis):
            return name, Pose()
    z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    return "Z", Pose.from_matrix(np.stack((x, np.cross(z, x), z), axis=1))


def _zero_poses(articulation: Articulation) -> dict[str, Pose]:
    """Each link's pose in the root's frame where all joint positions are zero."""
    poses = {articulation.root.name: Pose()}
    for joint in articulation.joints:
        poses[joint.child] = poses[joint.parent] @ joint.parent_pose @ joint.child_pose.inverse()
    return poses
