"""Writer of USD files, in SI units with z up, which :func:`orbit_assets.usd.read_usd` reads back unchanged.

Bodies stand side by side below one root prim, where the joints are at home. A shape that only collides has the purpose
"guide". Springs, higher powers of mimics and shapes without names are attributes ``orbit:...``, which no schema has.
Numbers that UsdPhysics holds in single precision come back rounded to it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from orbit_assets.losses import raised_inertias
from orbit_assets.mass_properties import mass_properties
from orbit_assets.meshes import MeshPart, load_mesh, load_parts
from orbit_assets.options import ReadOptions
from orbit_assets.source_text import names_file
from orbit_assets.usd.appearance import FinishWriter
from orbit_assets.usd.contents import FRAME, MASSLESS
from orbit_assets.usd.dynamics import HIGHER_POWERS, SPRING, SPRING_REST
from orbit_assets.usd.geometry import APPROXIMATIONS, UNNAMED
from orbit_assets.usd.library import assign, assign_custom, define, place, pxr, quatf
from orbit_core.files import written_whole
from orbit_core.interfaces.errors import AssetError, StorageError
from orbit_core.preparation.validation import validate
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Cylinder,
    DriveGains,
    Joint,
    JointType,
    Link,
    LoopJoint,
    LoopType,
    Mesh,
    MeshCollision,
    PhysicsMaterial,
    Plane,
    Pose,
    Shape,
    Sphere,
)
from orbit_core.scene.articulation import SINGLE, solid_moments
from orbit_core.scene.pose import Vector3

# Mesh files as one rigid body: visual and collision shapes, mass and friction -----------------------------------------

# Formats that have y up by their specification.
_Y_UP = (".glb", ".gltf")
# Density (kg/m^3) of an object for which the caller gives none.
_SOFT_WOOD = 500.0


@dataclass(frozen=True, kw_only=True)
class MeshBody:
    """Properties of a rigid body that its mesh file does not describe."""

    friction: float = 1.0
    """Static and dynamic."""
    restitution: float = 0.0
    """Speed after an impact by speed before it, 0 to 1."""
    density: float | None = None
    """kg/m^3; 500, that of soft wood, where neither it nor the mass is given."""
    mass: float | None = None
    """kg; overrides the density."""
    collision: MeshCollision = MeshCollision.CONVEX_HULL
    """Geometry for contacts."""
    scale: float = 1.0
    """Metres of one unit of the file, on top of a unit that the file itself names."""
    up: Literal["y", "z"] | None = None
    """The file's up axis; y for glTF, z for others, where it is left out."""


@names_file
def mesh_articulation(
    path: Path | str, body: MeshBody = MeshBody(), *, options: ReadOptions = ReadOptions()
) -> Articulation:
    """Build one rigid body with the surface of an OBJ, STL, glTF or other mesh file, z up, its frame the file's own.

    The whole mesh collides as one shape; what is drawn has a shape for each colour of the file. Mass is spread evenly
    over the volume within the mesh, or over that of its hull where it is not closed.

    Raises:
        AssetError: the file cannot be read, the mesh encloses no volume, or a number cannot be.
    """
    path = Path(path)
    for name in ("friction", "restitution", "density", "mass", "scale"):
        _check(name, getattr(body, name), may_be_zero=name in ("friction", "restitution"))
    scale = (body.scale, body.scale, body.scale)
    upright = Pose() if (body.up or ("y" if path.suffix.lower() in _Y_UP else "z")) == "z" else _Y_TO_Z
    whole = _upright(load_mesh(path, scale, options=options), upright)
    parts = load_parts(path, scale, options=options)
    material = PhysicsMaterial(body.friction, body.friction, restitution=body.restitution)
    # A mass overrides the density: with both given, the density is not used.
    density = (body.density or _SOFT_WOOD) if body.mass is None else None
    properties = mass_properties(whole, mass=body.mass, density=density)
    solid = Shape(replace(whole, collision=body.collision), material=material, name="collision")
    visuals = tuple(_visual(part, upright, number) for number, part in enumerate(parts, start=1))
    notes = (f"mesh {path.name} is one rigid body of {properties.mass:.4g} kg",)
    if any(part.textured and part.texture is None for part in parts):
        notes = (*notes, "surfaces with a picture but no coordinates on it are drawn in its median colour")
    link = Link(path.stem, properties.mass, properties.center_of_mass, properties.inertia, (solid,), visuals)
    return validate(Articulation(path.stem, (link,), notes=notes))


def mesh_to_usd(
    path: Path | str, out: Path | str, body: MeshBody = MeshBody(), *, options: ReadOptions = ReadOptions()
) -> tuple[str, ...]:
    """Write a mesh file as a rigid body to USD; return changes and losses, a sentence each.

    Raises:
        AssetError: as :func:`mesh_articulation`, or the name of ``out`` is no USD file's.
        StorageError: ``out`` cannot be written.
    """
    articulation = mesh_articulation(path, body, options=options)
    return (*articulation.notes, *write_usd(articulation, out))


# The rotation that takes y to z.
_Y_TO_Z = Pose.from_euler(math.pi / 2, 0.0, 0.0)


def _upright(mesh: Mesh, turn: Pose) -> Mesh:
    return replace(mesh, vertices=turn.transform(mesh.vertices)) if turn != Pose() else mesh


def _visual(part: MeshPart, upright: Pose, number: int) -> Shape:
    return part.shown(Shape(_upright(part.mesh, upright), name=f"visual_{number}"))


def _check(name: str, value: float | None, *, may_be_zero: bool) -> None:
    if value is None or (math.isfinite(value) and (value > 0 or (may_be_zero and value == 0))):
        return
    wanted = "that is not negative" if may_be_zero else "above zero"
    raise AssetError(f"{name} is {value}: give a finite number {wanted}")


@dataclass(eq=False)
class JointWriter:
    """Writer of the joints of one articulation, whose links have prims already."""

    articulation: Articulation
    """Joints that are written."""
    stage: Any
    """``Usd.Stage`` that they are written to."""
    links: Mapping[str, Any]
    """Prims of links by name."""
    joints: dict[str, Any] = field(default_factory=dict)
    """Prims of joints by name."""

    def write(self, top: Any) -> None:
        """Write all joints below a scope ``joints`` of the prim ``top``."""
        if not self.articulation.joints and not self.articulation.loops:
            return
        scope = define(self.stage, top, "joints", "Scope")
        drives = {drive.joint: drive for drive in self.articulation.drives}
        home = dict(self.articulation.home)
        for joint in self.articulation.joints:
            prim = self._joint(scope, joint)
            self.joints[joint.name] = prim
            if joint.movable:
                _set_dynamics(prim, joint)
                _set_drive(prim, joint, drives.get(joint.name))
            if joint.name in home:
                assign_custom(prim, {f"state:{_instance(joint)}:physics:position": home[joint.name] * _unit(joint)})
        # After all joints: a follower may come before its leader.
        for joint in self.articulation.joints:
            self._mimic(joint)
        for loop in self.articulation.loops:
            self._loop(scope, loop)

    def _joint(self, scope: Any, joint: Joint) -> Any:
        kind = "Revolute" if _angular(joint) else "Prismatic" if joint.movable else "Fixed"
        # USD has the axes X, Y and Z only: another one is reached by turning both frames.
        prim = define(self.stage, scope, joint.name, f"Physics{kind}Joint")
        axis, turn = _usd_axis(joint.axis)
        self._connect(prim, (joint.parent, joint.child), (joint.parent_pose @ turn, joint.child_pose @ turn))
        if joint.movable:
            assign(prim, None, {"physics:axis": axis})
        return prim

    def _connect(self, prim: Any, links: tuple[str, str], frames: tuple[Pose, Pose]) -> None:
        for side, link, frame in zip("01", links, frames, strict=True):
            prim.GetRelationship(f"physics:body{side}").SetTargets([self.links[link].GetPath()])
            prim.GetAttribute(f"physics:localPos{side}").Set(frame.position)
            prim.GetAttribute(f"physics:localRot{side}").Set(quatf(frame))

    def _mimic(self, joint: Joint) -> None:
        if joint.mimic is None:
            return
        leader = next(other for other in self.articulation.joints if other.name == joint.mimic.joint)
        own, other = _unit(joint), _unit(leader)
        prim = self.joints[joint.name]
        coefficients = {
            "newton:mimicCoef0": joint.mimic.offset * own,
            "newton:mimicCoef1": joint.mimic.multiplier * own / other,
        }
        assign(prim, "NewtonMimicAPI", coefficients)
        prim.GetRelationship("newton:mimicJoint").SetTargets([self.joints[leader.name].GetPath()])
        if not joint.mimic.linear:
            powers = enumerate(joint.mimic.higher_powers, start=2)
            assign_custom(prim, {HIGHER_POWERS: [value * own / other**power for power, value in powers]})

    def _loop(self, scope: Any, loop: LoopJoint) -> None:
        weld = loop.type is LoopType.WELD
        prim = define(self.stage, scope, loop.name, f"Physics{'Fixed' if weld else 'Spherical'}Joint")
        turned = Pose(orientation=loop.orientation) if weld else Pose()
        self._connect(
            prim,
            (loop.first, loop.second),
            (Pose(loop.first_point, turned.orientation), Pose(loop.second_point)),
        )
        # Marks the joint as no part of the tree, as UsdPhysics has it.
        assign(prim, None, {"physics:excludeFromArticulation": True})


def _set_dynamics(prim: Any, joint: Joint) -> None:
    position = _unit(joint)
    if joint.type is not JointType.CONTINUOUS:
        limits = {"physics:lowerLimit": joint.lower_limit, "physics:upperLimit": joint.upper_limit}
        assign(prim, None, {name: value * position for name, value in limits.items() if math.isfinite(value)})
    dynamics = {
        "newton:armature": joint.armature,
        "newton:damping": joint.damping / position,
        "newton:friction": joint.friction,
        "newton:velocityLimit": joint.velocity_limit * position,
    }
    assign(prim, "NewtonJointAPI", dynamics)
    if joint.stiffness:
        assign_custom(prim, {SPRING: joint.stiffness / position, SPRING_REST: joint.rest_position * position})


def _set_drive(prim: Any, joint: Joint, drive: DriveGains | None) -> None:
    """Write the drive of a joint and its effort limit, for which USD has one attribute."""
    instance, position = _instance(joint), _unit(joint)
    attributes: dict[str, Any] = {}
    if math.isfinite(joint.effort_limit):
        attributes["maxForce"] = joint.effort_limit
    if drive is not None:
        attributes |= {"stiffness": drive.stiffness / position, "damping": drive.damping / position}
    if attributes:
        named = {f"drive:{instance}:physics:{name}": value for name, value in attributes.items()}
        assign(prim, f"PhysicsDriveAPI:{instance}", named)


def _angular(joint: Joint) -> bool:
    return joint.type in (JointType.REVOLUTE, JointType.CONTINUOUS)


def _instance(joint: Joint) -> str:
    return "angular" if _angular(joint) else "linear"


def _unit(joint: Joint) -> float:
    """Return USD's units of position per radian or metre: degrees, and the stage's metres."""
    return math.degrees(1.0) if _angular(joint) else 1.0


def _usd_axis(axis: Vector3) -> tuple[str, Pose]:
    """Return the name of a joint axis, and the rotation of the joint's frames that takes that axis to the one given."""
    for name, basis in zip("XYZ", np.eye(3), strict=True):
        if np.array_equal(axis, basis):
            return name, Pose()
    z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    # Any vector that is not parallel serves: the smallest component is farthest from it.
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    return "Z", Pose.from_matrix(np.stack((x, np.cross(z, x), z), axis=1))


# The reason in USD's errors, which follows the place in its source code.
_REASON = re.compile(r" : '(.*)'")


def write_usd(articulation: Articulation, path: str | Path) -> tuple[str, ...]:
    """Write one articulation to a ``.usda``, ``.usdc`` or ``.usd`` file; return what it cannot hold, a sentence each.

    The file is overwritten. Bodies stand at the home positions that the articulation names.

    Raises:
        AssetError: the file's suffix is another, a shape is of a kind that USD lacks, or USD is not installed.
        StorageError: the file cannot be written.
    """
    path = usd_path(path)
    with pxr().Tf.DiagnosticTrap() as trap:
        # In memory first: an error leaves the old file as it is.
        stage = new_stage()
        top = define(stage, None, articulation.name, "Xform")
        stage.SetDefaultPrim(top)
        ArticulationWriter(articulation, ShapeWriter(stage, path)).write(top)
        export(stage, path)
        trap.Clear()
    return tuple(losses(articulation))


def usd_path(path: str | Path) -> Path:
    """Return the path of a USD file that is to be written.

    Raises:
        AssetError: its suffix is another.
    """
    path = Path(path)
    if path.suffix not in (".usda", ".usdc", ".usd"):
        raise AssetError(f"{path} is to be a USD file: name it *.usda, *.usdc or *.usd")
    return path


def new_stage() -> Any:
    """Return an empty stage in memory, in metres and kilograms, z up."""
    stage = pxr().Usd.Stage.CreateInMemory()
    pxr().UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    pxr().UsdGeom.SetStageUpAxis(stage, pxr().UsdGeom.Tokens.z)
    pxr().UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    return stage


def export(stage: Any, path: Path) -> None:
    """Write a stage to a file, whole or not at all.

    Raises:
        StorageError: the file cannot be written.
    """
    with written_whole(path) as written:
        try:
            stage.GetRootLayer().Export(str(written))
        except pxr().Tf.ErrorException as error:
            reason = _REASON.search(str(error))
            raise StorageError(f"cannot write {path}: {reason.group(1) if reason else error}") from None


def losses(articulation: Articulation) -> Iterator[str]:
    """Yield what a USD file cannot hold of an articulation, a sentence each."""
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


class ArticulationWriter:
    """Writer of one articulation below a prim of a stage.

    Args:
        articulation: to be written.
        shapes: writer of the stage's shapes.
    """

    def __init__(self, articulation: Articulation, shapes: ShapeWriter) -> None:
        self.articulation = articulation
        self.shapes = shapes
        self.stage = shapes.stage
        """USD stage that is written to, that of the shapes' writer."""
        self.links: dict[str, Any] = {}
        """Prims by the names of links, filled by :meth:`write`."""

    def write(self, top: Any) -> None:
        """Write links, frames and joints below ``top``, in its frame."""
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
            # Single precision breaks the triangle inequality of thin bodies: moments are raised before rounding.
            moments, axes = solid_moments(link.inertia, SINGLE)
            diagonal = pxr().Gf.Vec3f(*(float(moment) for moment in moments))
            attributes = {"mass": link.mass, "centerOfMass": link.center_of_mass, "diagonalInertia": diagonal}
            assign(prim, "PhysicsMassAPI", {f"physics:{name}": value for name, value in attributes.items()})
            prim.GetAttribute("physics:principalAxes").Set(quatf(axes))
        # Readers compute a mass from colliders: the mark keeps ours from it.
        elif link.collisions:
            assign_custom(prim, {MASSLESS: True})
        if link.semantic_label:
            pxr().UsdSemantics.LabelsAPI.Apply(prim, "class").CreateLabelsAttr([link.semantic_label])
        for shape, collides, drawn in _interleaved(link):
            self.shapes.write(prim, shape, collides=collides, drawn=drawn)
        return prim


@dataclass(eq=False)
class ShapeWriter:
    """Writer of shapes; equal materials share a prim below the stage's default prim."""

    stage: Any
    """USD stage that is written to."""
    path: Path
    """The USD file, next to which pictures are written."""
    materials: dict[PhysicsMaterial, Any] = field(default_factory=dict)
    """Prims of the physics materials that have been written."""

    def __post_init__(self) -> None:
        self._finishes = FinishWriter(self.stage, self.path)

    def write(self, parent: Any, shape: Shape, *, collides: bool = True, drawn: bool = True) -> None:
        """Write a shape in the frame of ``parent``.

        Raises:
            AssetError: USD has no such geometry.
        """
        prim = self._shape(parent, shape)
        if collides:
            self._make_collider(prim, shape)
        # A link without visuals shows its collision shapes.
        self._finishes.write(prim, shape)
        if not drawn:
            prim.GetAttribute("purpose").Set("guide")

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
        # Equal materials are one prim: scenes of many shapes have few.
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
    """Return all shapes of a link, with flags for colliding and drawn, in an order that keeps both of the link's
    orders.

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
    """Return each link's pose in the root's frame at home; joints without a home position are at zero."""
    home = dict(articulation.home)
    # Followers first: the chain below needs their positions.
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
