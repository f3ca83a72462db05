"""Writer of MJCF files: nested bodies, geoms with meshes in OBJ files next to the document, and a list of losses.

Several joints act on one body where the links between them have no mass.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

import numpy as np

from orbit_assets.losses import (
    JointTraits,
    LinkTraits,
    collides_otherwise_than_by_hulls,
    has_geometry,
    listed,
    missing_traits,
    raised_inertias,
)
from orbit_assets.mjcf.couplings import OWN_SITES
from orbit_assets.mjcf.model import vector_of
from orbit_assets.mjcf.trees import WORLD
from orbit_assets.urdf.writer import UNLIMITED, numbers, write_mesh
from orbit_core.files import storage_faults, written_whole
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Cylinder,
    DriveGains,
    HeightField,
    Joint,
    JointType,
    Link,
    LoopType,
    Mesh,
    PhysicsMaterial,
    Plane,
    Pose,
    Shape,
    Sphere,
)
from orbit_core.scene.articulation import solid_moments

_OF_JOINTS: JointTraits = (("velocity limits", lambda joint: joint.movable and math.isfinite(joint.velocity_limit)),)
_OF_LINKS: LinkTraits = (
    ("height fields without a file", lambda link: has_geometry(link, HeightField)),
    ("collision with a mesh's own triangles or convex pieces", collides_otherwise_than_by_hulls),
    ("restitution and compliance", lambda link: any(_bounces(shape) for shape in link.collisions)),
    ("friction that differs at rest and sliding", lambda link: any(_two_frictions(shape) for shape in link.collisions)),
    ("semantic labels", lambda link: link.semantic_label),
)


def losses(articulation: Articulation) -> tuple[str, ...]:
    """List what an MJCF file of the articulation does not hold, a sentence each."""
    traits = missing_traits("MJCF", articulation, _OF_JOINTS, _OF_LINKS)
    return (*traits, *raised_inertias(articulation), *_of_the_whole(articulation))


def _of_the_whole(articulation: Articulation) -> Iterable[str]:
    if any(has_geometry(link, Plane) for link in articulation.links[1:]):
        yield "MJCF does not hold planes that move"
    endless = [
        joint.name
        for joint in articulation.joints
        if joint.type is JointType.REVOLUTE and (joint.lower_limit, joint.upper_limit) == (-math.inf, math.inf)
    ]
    if endless:
        yield f"joints without limits become continuous: {listed(endless)}"


def _bounces(shape: Shape) -> bool:
    return bool(shape.material.restitution or shape.material.compliance)


def _two_frictions(shape: Shape) -> bool:
    return shape.material.static_friction != shape.material.dynamic_friction


# Groups of geoms that MuJoCo's viewer draws and hides by default.
_DRAWN, _HIDDEN = "0", "3"


class GeomWriter:
    """Writer of ``<geom>`` elements of bodies, and of each mesh once.

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
        """``conaffinity`` of colliding geoms: 1 if links collide with each other."""
        self._meshes: dict[int, tuple[Mesh, str]] = {}
        self._names: set[str] = set()

    def write(self, body: Element, link: Link, *, is_root: bool) -> None:
        """Add a link's shapes: one that collides and is drawn alike is one geom."""
        drawn = list(link.visuals)
        for shape in link.collisions:
            # Equal shapes are one geom: a copy would be compiled and drawn twice.
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
        """Return the name of a mesh; its file is written with the first geom that uses it."""
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
        """Return a unique name: MJCF has one namespace of geoms per model, the description one per link."""
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
    """Write friction, in as many directions of a contact as have some."""
    sliding, torsional, rolling = material.dynamic_friction, material.torsional_friction, material.rolling_friction
    dimensions = 6 if rolling > 0 else 4 if torsional > 0 else 3 if sliding > 0 else 1
    element.set("condim", str(dimensions))
    element.set("friction", numbers((sliding, torsional, rolling)))


# Width (rad, m, N or N m) of equal limits in the file: MuJoCo requires the lower to be below the upper.
_WIDTH = 1e-9


@dataclass(eq=False)
class BodyWriter:
    """Writer of one articulation's bodies below ``<worldbody>``."""

    articulation: Articulation
    """Links and joints that are written."""
    geoms: GeomWriter
    """Writer of their shapes."""
    fixed_base: bool
    """False for a free joint at the root."""

    def __post_init__(self) -> None:
        self.notes: list[str] = []
        self._joint_of = {joint.child: joint for joint in self.articulation.joints}
        self._children: dict[str, list[Joint]] = {}
        for joint in self.articulation.joints:
            self._children.setdefault(joint.parent, []).append(joint)
        ends = {name for loop in self.articulation.loops for name in (loop.first, loop.second)}
        self._named = {frame.link for frame in self.articulation.frames} | ends
        self._frames: dict[str, list[tuple[str, Pose]]] = {}
        for frame in self.articulation.frames:
            self._frames.setdefault(frame.link, []).append((frame.name, frame.pose))

    def write(self, worldbody: Element) -> dict[str, Element]:
        """Write all links but the massless ones between joints; the root ``world`` is the world itself."""
        elements: dict[str, Element] = {}
        for link in self.articulation.links:
            if self._between(link):
                continue
            if link is self.articulation.root:
                elements[link.name] = body = self._root(worldbody, link)
            else:
                chain = self._chain(link)
                body = SubElement(elements[chain[0].parent], "body", name=link.name)
                elements[link.name] = body
                self._joints(body, chain)
            self._contents(body, link)
        return elements

    def _root(self, worldbody: Element, link: Link) -> Element:
        if link.name == WORLD:
            return worldbody
        body = SubElement(worldbody, "body", name=link.name)
        if not self.fixed_base:
            SubElement(body, "freejoint", name=f"{link.name}_free")
        return body

    def _contents(self, body: Element, link: Link) -> None:
        if link.mass > 0:
            self._inertial(body, link)
        elif (body.find("joint") is not None or body.find("freejoint") is not None) and not self._carried(link):
            raise AssetError(
                f"'{self.articulation.name}': link '{link.name}' moves without mass, and carries shapes, frames or "
                "several links, which MJCF refuses: give it mass"
            )
        self.geoms.write(body, link, is_root=link is self.articulation.root)
        for name, pose in self._frames.get(link.name, ()):
            place(SubElement(body, "site", name=name), pose)

    def _carried(self, link: Link) -> bool:
        """Return True if a link without mass is rigid with one that has some."""
        waiting = [link.name]
        masses = {each.name: each.mass for each in self.articulation.links}
        while waiting:
            for joint in self._children.get(waiting.pop(), ()):
                if not joint.movable and masses[joint.child] > 0:
                    return True
                waiting += [] if joint.movable else [joint.child]
        return False

    def _between(self, link: Link) -> bool:
        """Return True if a link only separates two joints of one body."""
        joint, children = self._joint_of.get(link.name), self._children.get(link.name, [])
        empty = link.mass == 0 and not (link.collisions or link.visuals) and link.name not in self._named
        return bool(joint and joint.movable and empty and len(children) == 1 and children[0].movable)

    def _chain(self, link: Link) -> list[Joint]:
        """Return the joints between a link and the next body above, the outermost first."""
        links = {each.name: each for each in self.articulation.links}
        chain = [self._joint_of[link.name]]
        while self._between(links[chain[0].parent]):
            parent = chain[0].parent
            chain.insert(0, self._joint_of[parent])
            # Names that the reader gives to such links come back; others are lost.
            if parent != f"{chain[0].name}_link":
                self.notes.append(f"MJCF does not hold the name of link '{parent}', which has no mass")
        return chain

    def _joints(self, body: Element, chain: list[Joint]) -> None:
        """Place a body where all joints are at zero, and each joint as the body sees it there."""
        at_zero = Pose()
        for joint in chain:
            at_zero = at_zero @ joint.parent_pose @ joint.child_pose.inverse()
        place(body, at_zero)
        below = Pose()
        seen: list[Pose] = []
        for joint in reversed(chain):
            below = joint.child_pose.inverse() @ below
            seen.insert(0, below.inverse())
            below = joint.parent_pose @ below
        for joint, frame in zip(chain, seen, strict=True):
            if joint.movable:
                _joint(body, joint, frame)

    def _inertial(self, body: Element, link: Link) -> None:
        moments, axes = solid_moments(link.inertia)
        SubElement(
            body,
            "inertial",
            pos=numbers(link.center_of_mass),
            quat=numbers(axes.orientation),
            mass=repr(float(link.mass)),
            # MuJoCo checks the triangle inequality of inertias without any tolerance.
            diaginertia=numbers(moments),
        )


def renamed_world(articulation: Articulation, *, fixed_base: bool) -> tuple[Articulation, tuple[str, ...]]:
    """Rename links and frames called ``world``, which MJCF reserves for the world itself; return notes too.

    A root ``world`` that is fixed and has no mass keeps it, for it is the world.
    """
    root = articulation.root
    taken = {*articulation.link_names, *(frame.name for frame in articulation.frames)}
    if WORLD not in taken or (fixed_base and root.name == WORLD and root.mass == 0):
        return articulation, ()
    new = next(name for name in (f"{WORLD}_{number}" for number in range(1, len(taken) + 2)) if name not in taken)

    def name(old: str) -> str:
        return new if old == WORLD else old

    renamed = replace(
        articulation,
        links=tuple(replace(link, name=name(link.name)) for link in articulation.links),
        joints=tuple(replace(j, parent=name(j.parent), child=name(j.child)) for j in articulation.joints),
        frames=tuple(replace(frame, name=name(frame.name), link=name(frame.link)) for frame in articulation.frames),
        collision_exclusions=tuple((name(one), name(other)) for one, other in articulation.collision_exclusions),
        loops=tuple(replace(loop, first=name(loop.first), second=name(loop.second)) for loop in articulation.loops),
    )
    return renamed, (f"MJCF keeps the name '{WORLD}' for the world: what has it becomes '{new}'",)


def _joint(body: Element, joint: Joint, frame: Pose) -> None:
    """Write one joint, whose frame has this pose in the body."""
    angular = joint.type is not JointType.PRISMATIC
    axis = vector_of(frame.rotation_matrix() @ np.asarray(joint.axis))
    element = SubElement(
        body,
        "joint",
        name=joint.name,
        type="hinge" if angular else "slide",
        pos=numbers(frame.position),
        axis=numbers(axis),
    )
    limits = joint.lower_limit, joint.upper_limit
    limited = limits != (-math.inf, math.inf)
    element.set("limited", str(limited).lower())
    # MuJoCo rejects infinite ranges: one-sided limits end at a number that no joint reaches.
    if limited:
        lower, upper = max(limits[0], -UNLIMITED), min(limits[1], UNLIMITED)
        element.set("range", numbers((lower, max(upper, lower + _WIDTH))))
    if math.isfinite(joint.effort_limit):
        effort = max(joint.effort_limit, _WIDTH)
        element.set("actuatorfrclimited", "true")
        element.set("actuatorfrcrange", numbers((-effort, effort)))
    for name, value in (
        ("damping", joint.damping),
        ("frictionloss", joint.friction),
        ("armature", joint.armature),
        ("stiffness", joint.stiffness),
        ("springref", joint.rest_position),
    ):
        if value:
            element.set(name, repr(float(value)))


def write_mjcf(
    articulation: Articulation, path: Path | str, meshes: Path | str | None = None, *, fixed_base: bool = True
) -> tuple[str, ...]:
    """Write one articulation to an ``.xml`` or ``.mjcf`` file; return what the format cannot hold, a sentence each.

    Links without mass between joints become several joints on one body, and come back by the names that
    :func:`orbit_assets.joint_models.chain` gives. Links come back depth first, joints and links without mass
    with axes along the child's, and the home pose with a position of every joint, zero where the description names
    none. A link ``world`` with mass comes back as ``world_1``, for MJCF keeps that name for the world itself.

    Args:
        articulation: what to write, in topological order.
        path: the file, which is overwritten.
        meshes: the folder for mesh files, made where it is missing; next to the file and named after it by default.
        fixed_base: whether the root stands fixed in the world, which a description leaves to its scene.

    Raises:
        AssetError: the suffix is another, or a moving link without mass is more than the place between two joints.
        StorageError: a file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in (".xml", ".mjcf"):
        raise AssetError(f"'{path}' is to be an MJCF file: name it *.xml or *.mjcf")
    folder = Path(meshes) if meshes is not None else path.with_name(f"{path.stem}_meshes")
    articulation, renamed = renamed_world(articulation, fixed_base=fixed_base)
    root = Element("mujoco", model=articulation.name)
    SubElement(root, "compiler", angle="radian", inertiafromgeom="false")
    asset, worldbody = SubElement(root, "asset"), SubElement(root, "worldbody")
    geoms = GeomWriter(asset, folder, path.parent, self_collisions=articulation.self_collisions)
    writer = BodyWriter(articulation, geoms, fixed_base)
    # Mesh files are written first: a document that exists names only files that exist.
    with storage_faults(folder):
        bodies = writer.write(worldbody)
    _exclusions(root, articulation, bodies)
    _constraints(root, articulation, bodies)
    _actuators(root, articulation.drives)
    if articulation.home:
        _keyframe(root, worldbody, dict(articulation.home))
    indent(root)
    with written_whole(path) as written:
        ElementTree(root).write(written, encoding="utf-8", xml_declaration=True)
    return (*losses(articulation), *renamed, *writer.notes)


def _exclusions(root: Element, articulation: Articulation, bodies: dict[str, Element]) -> None:
    """Write pairs that never collide: the excluded ones, and joined ones that MuJoCo would let collide."""
    if not articulation.self_collisions:
        return
    contact = SubElement(root, "contact")
    # MuJoCo lets what hangs on a body fixed in the world collide with that; other parents and children it keeps apart.
    direct = {(joint.parent, joint.child) for joint in articulation.joints if joint.parent != articulation.root.name}
    joined = (pair for pair in articulation.joined_links if pair not in direct)
    for first, second in dict.fromkeys((*articulation.collision_exclusions, *joined)):
        if first in bodies and second in bodies:
            SubElement(contact, "exclude", body1=first, body2=second)


def _constraints(root: Element, articulation: Articulation, bodies: dict[str, Element]) -> None:
    equality = SubElement(root, "equality")
    for joint in articulation.joints:
        if joint.mimic is not None:
            # ``polycoef`` has exactly five coefficients.
            law = numbers((*joint.mimic.coefficients, 0.0, 0.0, 0.0)[:5])
            SubElement(equality, "joint", joint1=joint.name, joint2=joint.mimic.joint, polycoef=law)
    for loop in articulation.loops:
        first, second = (f"{loop.name}{end}" for end in OWN_SITES)
        place(SubElement(bodies[loop.first], "site", name=first), Pose(loop.first_point, loop.orientation))
        place(SubElement(bodies[loop.second], "site", name=second), Pose(loop.second_point))
        kind = "weld" if loop.type is LoopType.WELD else "connect"
        SubElement(equality, kind, name=loop.name, site1=first, site2=second)


def _actuators(root: Element, drives: tuple[DriveGains, ...]) -> None:
    actuator = SubElement(root, "actuator")
    for drive in drives:
        named = {"name": drive.joint, "joint": drive.joint}
        if drive.stiffness:
            element = SubElement(actuator, "position", named, kp=repr(drive.stiffness), kv=repr(drive.damping))
        elif drive.damping:
            element = SubElement(actuator, "velocity", named, kv=repr(drive.damping))
        else:
            element = SubElement(actuator, "motor", named)
        if math.isfinite(drive.effort_limit) and drive.effort_limit > 0:
            element.set("forcelimited", "true")
            element.set("forcerange", numbers((-drive.effort_limit, drive.effort_limit)))


def _keyframe(root: Element, worldbody: Element, home: dict[str, float]) -> None:
    """Write positions in the order of the file's joints; a floating root is at the origin."""
    free = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0) if next(worldbody.iter("freejoint"), None) is not None else ()
    positions = (home.get(joint.get("name", ""), 0.0) for joint in worldbody.iter("joint"))
    SubElement(SubElement(root, "keyframe"), "key", name="home", qpos=numbers((*free, *positions)))
