"""Reader of SDFormat files (.sdf, of Gazebo and others): one articulation per model, with links, joints and loops."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from orbit_assets.compose import sort_links
from orbit_assets.joint_models import BALL, chain, compound, resolve_chains
from orbit_assets.mass_properties import repaired
from orbit_assets.options import ReadOptions
from orbit_assets.sdf.sources import SdfFiles, SdfSource, SdfWorld
from orbit_assets.sdf.structure import MODEL, WORLD, SdfScope, SdfStructure, world_frames
from orbit_assets.source_text import Findings, names_file
from orbit_core.interfaces.errors import AssetError, UnknownNameError
from orbit_core.scene import Articulation, Frame, Joint, JointType, Link, LoopJoint, LoopType, Mimic, Pose
from orbit_core.scene.pose import Vector3

_JOINT_TYPES = {type_.value: type_ for type_ in JointType}
_COMPOUND = ("ball", "universal", "revolute2")
# SDFormat's default limits are 1e16.
_UNLIMITED = 1e15
# First version in which axes are given in the joint's frame, instead of the model's.
_BEFORE_JOINT_FRAMES = (1, 5)
_KNOWN = {
    "link": {"pose", "inertial", "visual", "collision", "self_collide", "gravity", "kinematic"},
    "joint": {"pose", "parent", "child", "axis", "axis2"},
}
_DEFAULT_INERTIA = "links without <inertial> have SDFormat's default, 1 kg and 1 kg m^2"


class SdfModelReader:
    """Reader of one ``<model>``, with the models nested in it.

    Args:
        source: the model.
        findings: for errors and notes.
        options: which files may be opened.
    """

    def __init__(self, source: SdfSource, findings: Findings, options: ReadOptions) -> None:
        self.findings = findings
        self.options = options
        self.structure = SdfStructure(findings, options, MODEL)
        """Elements of the model, nested ones included."""
        self.structure.add_outermost(source)
        self.source = source
        self.fields = self.structure.fields
        """Reader of values."""
        self.frames = self.structure.frames
        """Poses of links and frames."""
        self.links = self.structure.links
        """Elements of links by scoped name."""
        self.loops: list[LoopJoint] = []
        """Closures of loops that have been read."""
        self.self_collisions = self.structure.self_collisions
        """True if any link of the model may collide with others."""

    def read(self) -> Articulation:
        """Return the articulation.

        Raises:
            AssetError: something is malformed, or the links make no single tree.
        """
        # Poses first: errors about frames are clearer than those about links that depend on them.
        for link in self.links:
            self.frames.pose(link)
        links = [self._link(link, element, scope) for link, (element, scope) in self.links.items()]
        joints: list[Joint] = []
        carried: set[str] = set()
        for joint, (element, scope) in self.structure.joints.items():
            made, single = self._joint(joint, element, scope, carried)
            links += made
            joints += single
        if any(joint.parent == WORLD for joint in joints) and WORLD not in self.links:
            links.insert(0, Link(WORLD))
        articulation = Articulation(
            self.source.name,
            tuple(links),
            tuple(joints),
            tuple(self._frame(name) for name in self.structure.named_frames),
            self.self_collisions,
            loops=tuple(self.loops),
        )
        articulation = sort_links(resolve_chains(articulation))
        return repaired(replace(articulation, notes=(*articulation.notes, *self.findings.notes)), self.options)

    def placement(self) -> Pose:
        """Return the pose, in the model, of the frame that is at the model's pose.

        Raises:
            AssetError: the model has no frame of that name.
        """
        return self.frames.pose(self.source.placement or MODEL)

    def pose_of(self, link: str) -> Pose:
        """Return the pose of a link in the model; the identity for the world's link, to which joints may connect."""
        return Pose() if link == WORLD and link not in self.links else self.frames.pose(link)

    def _link(self, name: str, element: Element, scope: SdfScope) -> Link:
        where = f"link '{name}'"
        self._note_unread(element, where)
        self.self_collisions |= self.fields.flag(element, "self_collide", where)
        if element.find("gravity") is not None and not self.fields.flag(element, "gravity", where):
            self.findings.unsupported("no gravity of its own", where, "let gravity act on all links")
        if self.fields.flag(element, "kinematic", where):
            self.findings.unsupported("<kinematic>", where, "fix it by a joint")
        shapes = {
            tag: tuple(
                shape
                for child in element.findall(tag)
                for shape in read(child, self._placed(child, name, scope, where), where)
            )
            for tag, read in (("collision", scope.shapes.collision), ("visual", scope.shapes.visual))
        }
        link = Link(name, collisions=shapes["collision"], visuals=shapes["visual"])
        inertial = element.find("inertial")
        if inertial is None:
            self.findings.note(_DEFAULT_INERTIA)
            return replace(link, mass=1.0, inertia=np.eye(3))
        if inertial.get("auto", "false") in ("true", "1"):
            raise self.findings.error(f"{where} has an <inertial> to be computed", "write its mass and inertia out")
        number = self.fields.number
        pose = self._placed(inertial, name, scope, where)
        entries = inertial.find("inertia")
        if entries is None:
            self.findings.note("an <inertial> without <inertia> has SDFormat's default, 1 kg m^2")
            entries = Element("inertia")
        xx, yy, zz = (number(entries, key, where, 1.0) for key in ("ixx", "iyy", "izz"))
        xy, xz, yz = (number(entries, key, where, 0.0) for key in ("ixy", "ixz", "iyz"))
        # The tensor is given in the inertial frame; a link has it in its own.
        rotation = pose.rotation_matrix()
        inertia = rotation @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ rotation.T
        mass = number(inertial, "mass", where, 1.0)
        return replace(link, mass=mass, center_of_mass=pose.position, inertia=inertia)

    def _placed(self, element: Element, link: str, scope: SdfScope, where: str) -> Pose:
        """Return the pose of a part of a link, in the link."""
        pose, frame = self.fields.pose(element, where)
        if not frame:
            return pose
        return self.frames.pose(link).inverse() @ self.frames.pose(scope.named(frame)) @ pose

    def _joint(
        self, name: str, element: Element, scope: SdfScope, carried: set[str]
    ) -> tuple[tuple[Link, ...], tuple[Joint, ...]]:
        """Convert a joint; return its chain if it is compound, and nothing if it closes a loop or fixes the base."""
        where = f"joint '{name}'"
        self._note_unread(element, where)
        kind = element.get("type", "")
        if kind not in _JOINT_TYPES and kind not in _COMPOUND:
            remedy = f"use one of {', '.join((*_JOINT_TYPES, *_COMPOUND))}"
            self.findings.unsupported(f"the type '{kind}'", where, remedy)
            return (), ()
        parent, child = (self._end(element, tag, scope, where) for tag in ("parent", "child"))
        if parent == WORLD and WORLD not in self.links and kind == "fixed":
            self.findings.note(f"{where} fixes link '{child}' to the world: give the entity fixed_base=True")
            return (), ()
        at = self.frames.pose(name)
        ends = [(self.pose_of(link).inverse() @ at) for link in (parent, child)]
        joint = Joint(name, _JOINT_TYPES.get(kind, JointType.CONTINUOUS), parent, child, ends[0], ends[1])
        # A link has one parent: a second joint to it closes a loop.
        if child in carried:
            self._close_loop(joint, kind, where)
            return (), ()
        carried.add(child)
        if kind == "ball":
            return compound(self._damped(joint, element, where), BALL)
        if kind in _COMPOUND:
            simple = [
                self._moving(replace(joint, name=f"{name}_{tag}"), element, tag, scope, where)
                for tag in ("axis", "axis2")
            ]
            return chain(simple)
        if not joint.movable:
            return (), (joint,)
        return (), (self._moving(joint, element, "axis", scope, where),)

    def _end(self, element: Element, tag: str, scope: SdfScope, where: str) -> str:
        """Return the link of a joint's end, which may name a frame on it or a nested model."""
        name = self.fields.text(element, tag, where)
        path = scope.named(name)
        return WORLD if name == WORLD and path not in self.links else self.frames.link_of(path)

    def _close_loop(self, joint: Joint, kind: str, where: str) -> None:
        first, second = joint.parent_pose, joint.child_pose
        if kind in ("ball", "fixed"):
            type_ = LoopType.BALL if kind == "ball" else LoopType.WELD
        elif kind in ("revolute", "continuous"):
            type_ = LoopType.BALL
            # A revolute loop joint removes five freedoms; the description's ball joint removes three, and the tree the
            # others.
            self.findings.note(f"{where} closes a loop and is held as a ball joint at its origin, without its axis")
        else:
            remedy = "close loops by ball, revolute or fixed joints"
            self.findings.unsupported(f"the type '{kind}' and closes a loop", where, remedy)
            return
        orientation = (first @ second.inverse()).orientation
        self.loops.append(
            LoopJoint(joint.name, joint.parent, joint.child, first.position, second.position, type_, orientation)
        )

    def _moving(self, joint: Joint, element: Element, tag: str, scope: SdfScope, where: str) -> Joint:
        """Return the joint with the axis, limits and dynamics that ``<axis>`` or ``<axis2>`` gives."""
        axis = element.find(tag)
        if axis is None:
            raise self.findings.error(f"{where} lacks <{tag}>", "add it")
        number = self.fields.number
        direction = self._direction(axis, self.frames.pose(scope.named(element.get("name", ""))), scope, where)
        joint = self._damped(replace(joint, axis=direction), element, where, tag)
        limit = axis.find("limit")
        lower, upper = -math.inf, math.inf
        if limit is not None:
            lower, upper = (
                _bound(number(limit, key, where, sign * math.inf)) for key, sign in (("lower", -1), ("upper", 1))
            )
            effort, velocity = (_rated(number(limit, key, where, -1.0)) for key in ("effort", "velocity"))
            joint = replace(joint, effort_limit=effort, velocity_limit=velocity)
        if joint.type is JointType.REVOLUTE and (lower, upper) == (-math.inf, math.inf):
            joint = replace(joint, type=JointType.CONTINUOUS)
        elif joint.type is JointType.CONTINUOUS and element.get("type") in _COMPOUND and lower > -math.inf:
            joint = replace(joint, type=JointType.REVOLUTE)
        if joint.type is not JointType.CONTINUOUS:
            joint = replace(joint, lower_limit=lower, upper_limit=upper)
        return self._following(joint, axis, scope, where)

    def _following(self, joint: Joint, axis: Element, scope: SdfScope, where: str) -> Joint:
        mimic = axis.find("mimic")
        if mimic is None:
            return joint
        number = self.fields.number
        multiplier, offset = number(mimic, "multiplier", where, 1.0), number(mimic, "offset", where, 0.0)
        reference = number(mimic, "reference", where, 0.0)
        leader = scope.named(mimic.get("joint", ""))
        # SDFormat: position = multiplier * (leader - reference) + offset.
        return replace(joint, mimic=Mimic(leader, multiplier, offset - multiplier * reference))

    def _direction(self, axis: Element, at: Pose, scope: SdfScope, where: str) -> Vector3:
        """Return the axis in the joint's frame, which has the pose ``at`` in the model."""
        given = self.fields.vector(axis, "xyz", where, "0 0 1")
        xyz = axis.find("xyz")
        frame = xyz.get("expressed_in", "") if xyz is not None else ""
        if frame:
            source = self.frames.pose(scope.named(frame))
        elif scope.version < _BEFORE_JOINT_FRAMES or self.fields.flag(axis, "use_parent_model_frame", where):
            source = self.frames.pose(scope.model)
        else:
            return given
        x, y, z = (float(value) for value in at.rotation_matrix().T @ source.rotation_matrix() @ np.asarray(given))
        return (x, y, z)

    def _damped(self, joint: Joint, element: Element, where: str, tag: str = "axis") -> Joint:
        dynamics = element.find(f"{tag}/dynamics")
        if dynamics is None:
            return joint
        number = self.fields.number
        return replace(
            joint,
            damping=number(dynamics, "damping", where, 0.0),
            friction=number(dynamics, "friction", where, 0.0),
            stiffness=number(dynamics, "spring_stiffness", where, 0.0),
            rest_position=number(dynamics, "spring_reference", where, 0.0),
        )

    def _frame(self, name: str) -> Frame:
        """Return a ``<frame>`` on the link that it moves with."""
        host = self.frames.link_of(name)
        return Frame(name, host, self.frames.pose(host).inverse() @ self.frames.pose(name))

    def _note_unread(self, element: Element, where: str) -> None:
        for child in element:
            if child.tag not in _KNOWN[element.tag]:
                self.findings.leave_out(f"<{child.tag}>", where)


def _bound(value: float) -> float:
    return math.copysign(math.inf, value) if abs(value) >= _UNLIMITED else value


def _rated(value: float) -> float:
    """Return an effort or velocity limit; negative values of SDFormat mean that there is none."""
    return math.inf if value < 0 or value >= _UNLIMITED else value


@dataclass(frozen=True, eq=False)
class SdfModel:
    """A model of an SDFormat file, its pose in the file's world, and True if the file fixes it."""

    articulation: Articulation
    """Links and joints."""
    pose: Pose
    """Pose of the model's frame."""
    static: bool
    """True if the model does not move."""
    root_pose: Pose
    """Pose of the root link, as an entity of a scene needs it."""


@names_file
def read_sdf(path: Path | str, name: str | None = None, *, options: ReadOptions = ReadOptions()) -> Articulation:
    """Read the articulation of a model of an SDFormat file, in link order depth first, fixed joints kept.

    Of several models ``options.articulation`` names the one. Poses are taken in the frames that they name, as
    SDFormat 1.7 has it; axes before version 1.5 are in the model's frame. Ball and universal joints become chains of
    simple ones. A second joint to a link closes a loop: a ball joint or a weld exactly, a revolute one as a ball joint
    at its origin. A link without ``<inertial>`` has SDFormat's default, 1 kg and 1 kg m^2. Where the root link stands
    and whether the model is static is in the notes; :func:`read_sdf_models` gives it as data.

    Raises:
        AssetError: the file, or one that it names, is missing, malformed or describes what ORBIT has no word for.
    """
    models = _models(Path(path), options)
    known = [model.name for _, model in models]
    wanted = options.articulation or (known[0] if len(known) == 1 else None)
    if wanted is None:
        listed = ", ".join(f"'{each}'" for each in known[:8])
        raise AssetError(f"there are several models, {listed}: name one by ReadOptions(articulation=...)")
    if wanted not in known:
        raise UnknownNameError("model", wanted, known, f"'{path}'")
    model = _read(*models[known.index(wanted)], options)
    notes = list(model.articulation.notes)
    if model.static:
        notes.append("the model is static: give the entity fixed_base=True")
    if model.root_pose != Pose():
        at = ", ".join(f"{value:.6g}" for value in model.root_pose.position)
        turned = ", ".join(f"{value:.6g}" for value in model.root_pose.orientation)
        root = model.articulation.root.name
        notes.append(
            f"root link '{root}' stands at ({at}) with quaternion ({turned}) in its world: give the entity that pose"
        )
    return replace(model.articulation, name=name or wanted, notes=tuple(notes))


@names_file
def read_sdf_models(path: Path | str, *, options: ReadOptions = ReadOptions()) -> tuple[SdfModel, ...]:
    """Read all models of an SDFormat file and of those that it includes, as :func:`read_sdf` reads one.

    Raises:
        AssetError: as :func:`read_sdf`.
    """
    return tuple(_read(world, model, options) for world, model in _models(Path(path), options))


def _models(path: Path, options: ReadOptions) -> list[tuple[SdfWorld, SdfSource]]:
    """Return the models of a file, world by world, each with its world."""
    return [(world, model) for world in SdfFiles(options).worlds(path) for model in world.models]


def _read(world: SdfWorld, source: SdfSource, options: ReadOptions) -> SdfModel:
    findings = Findings(f"SDF file '{source.path}'", options)
    reader = SdfModelReader(source, findings, options)
    articulation = reader.read()
    pose = source.pose @ reader.placement().inverse() if source.placement else source.pose
    if source.relative_to not in ("", WORLD):
        pose = world_frames(world.models, world.frames, world.fields, options).pose(source.relative_to) @ pose
    notes = (*world.fields.findings.notes, *articulation.notes)
    return SdfModel(
        replace(articulation, notes=notes), pose, source.static, pose @ reader.pose_of(articulation.root.name)
    )
