"""Articulations of a USD stage: mass and shapes of its bodies, put together by its joints."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orbit_assets.compose import sort_links
from orbit_assets.mass_properties import MassProperties, combine, mass_properties
from orbit_assets.meshes import without_coordinates
from orbit_assets.placed import PlacedArticulation
from orbit_assets.usd.contents import ARTICULATION, MASSLESS, STAGE, Contents, collect, is_frame
from orbit_assets.usd.geometry import Placement, Placements, Shapes
from orbit_assets.usd.joints import Actuators, Joints
from orbit_assets.usd.library import pxr, unique_names
from orbit_assets.usd.stage import (
    Reading,
    Units,
    applies,
    array,
    attribute,
    authored,
    is_authored,
    label,
    number,
    numbers,
    rotation,
    targets,
)
from orbit_assets.usd.tree import Edge, Tree, grow, stacked
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Articulation, Frame, Joint, Link, Pose, Shape
from orbit_core.scene.pose import FloatArray

# Density (kg/m^3) where the stage gives none, as UsdPhysics specifies.
_DENSITY = 1000.0
NOTHING = MassProperties(0.0, (0.0, 0.0, 0.0), np.zeros((3, 3)))
"""Mass properties of a link without mass."""


def is_given(body: Any) -> bool:
    """Return True if a body gives its mass and inertia, so that those of its colliders are not needed."""
    inertia = len(array(body, "newton:inertia", 1, float)) or any(numbers(body, "physics:diagonalInertia", _ZERO))
    return number(body, "physics:mass") > 0 and bool(inertia)


def solid(prim: Any, body: Any, material: Any, shape: Shape, units: Units) -> MassProperties:
    """Compute a collider's mass properties from its own mass, or the density of itself, its body, or its material.

    UsdPhysics takes a mass of zero for one that is not given; MuJoCo, for a collider without mass.
    """
    if (mass := number(prim, "physics:mass")) > 0:
        return mass_properties(shape.geometry, mass=mass * units.mass).placed(shape.pose)
    if authored(prim, "physics:mass") == 0 and applies(prim, "MjcCollisionAPI"):
        return NOTHING
    sources = (prim, body, *([material] if material else []))
    densities = [number(source, "physics:density") for source in sources]
    given = next((value for value in densities if value > 0), None)
    density = _DENSITY if given is None else given * units.mass / units.length**3
    return mass_properties(shape.geometry, density=density).placed(shape.pose)


def body_mass(body: Any, solids: list[MassProperties], placements: Placements, units: Units) -> MassProperties:
    """Return a body's own mass, centre and inertia as far as it gives them, and those of its colliders for the rest."""
    of_shapes = combine(solids) if any(each.mass > 0 for each in solids) else NOTHING
    placement = placements.of(body, body)
    mass = number(body, "physics:mass") * units.mass or of_shapes.mass
    center = numbers(body, "physics:centerOfMass", (-math.inf,) * 3)
    x, y, z = placement.point(center) if math.isfinite(center[0]) else of_shapes.center_of_mass
    inertia = _inertia(body, placement, units)
    if inertia is None:
        inertia = of_shapes.inertia * (mass / of_shapes.mass if of_shapes.mass else 1.0)
    return MassProperties(mass, (float(x), float(y), float(z)), inertia)


def _inertia(body: Any, placement: Placement, units: Units) -> FloatArray | None:
    # Newton's full tensor wins: UsdPhysics has only a diagonal and the orientation of its axes.
    full = array(body, "newton:inertia", 1, float)
    if len(full) == 6:
        xx, yy, zz, xy, xz, yz = full
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        axes = placement.pose.rotation_matrix()
    else:
        diagonal = numbers(body, "physics:diagonalInertia", _ZERO)
        if not any(diagonal):
            return None
        tensor = np.diag(np.asarray(diagonal))
        axes = placement.frame((0.0, 0.0, 0.0), rotation(body, "physics:principalAxes")).rotation_matrix()
    return units.inertia(angular=True) * axes @ tensor @ axes.T


_ZERO = (0.0, 0.0, 0.0)


@dataclass(eq=False)
class Links:
    """Reader of the links of one stage."""

    reading: Reading
    """File, units and options."""
    contents: Contents
    """Prims of the stage."""
    placements: Placements
    """Poses of prims in the world."""

    def __post_init__(self) -> None:
        self.shapes = Shapes(self.reading, self.placements, self.contents.geometry)

    def body(self, path: str, name: str) -> Link:
        """Return the link of a rigid body."""
        body = self.contents.bodies[path]
        parts = self.contents.parts.get(path, [])
        massless = bool(attribute(body, MASSLESS, False))
        # Volumes of meshes are expensive: they are computed only if the body needs them.
        collisions, visuals, solids = self._shapes(parts, body, weighed=not (massless or is_given(body)))
        properties = NOTHING if massless else body_mass(body, solids, self.placements, self.reading.units)
        return Link(
            name,
            properties.mass,
            properties.center_of_mass,
            properties.inertia,
            collisions,
            visuals,
            semantic_label(body),
        )

    def static(self, prim: Any, parts: list[Any], name: str) -> Link:
        """Return a massless link, in the frame of ``prim``, of geometry that does not move."""
        collisions, visuals, _ = self._shapes(parts, prim, weighed=False)
        kind = "" if str(prim.GetPath()) == STAGE else semantic_label(prim)
        return Link(name, NOTHING.mass, NOTHING.center_of_mass, NOTHING.inertia, collisions, visuals, kind)

    def _shapes(
        self, parts: list[Any], body: Any, *, weighed: bool
    ) -> tuple[tuple[Shape, ...], tuple[Shape, ...], list[MassProperties]]:
        """Return shapes that collide, shapes that are drawn, and mass properties of each collider."""
        collisions: list[Shape] = []
        visuals: list[Shape] = []
        solids: list[MassProperties] = []
        for prim in parts:
            if not prim.IsA(pxr().UsdGeom.Gprim):
                continue
            collides = prim.HasAPI(pxr().UsdPhysics.CollisionAPI) and attribute(prim, "physics:collisionEnabled", True)
            imageable = pxr().UsdGeom.Imageable(prim)
            # By convention, colliders that should not be drawn have the purpose "guide".
            drawn = imageable.ComputePurpose() != "guide" and imageable.ComputeVisibility() != "invisible"
            shape = self.shapes.read(prim, body, collides=collides) if collides or drawn else None
            if shape is None:
                self._lack_shape(prim, collides, drawn)
                continue
            visuals += [shape] if drawn else []
            if collides:
                collisions.append(without_coordinates(shape))
                if weighed:
                    material = self.shapes.surfaces.physics_prim(prim)
                    solids.append(solid(prim, body, material, shape, self.reading.units))
        return tuple(collisions), tuple(visuals), solids

    def _lack_shape(self, prim: Any, collides: bool, drawn: bool) -> None:
        if collides:
            raise AssetError(f"{prim.GetPath()} is a collider of type {prim.GetTypeName()}: make it a mesh")
        if drawn:
            self.reading.note(f"{prim.GetPath()} is drawn as a {prim.GetTypeName()} and left out: make it a mesh")


def semantic_label(prim: Any) -> str:
    """Return the first label of the prim in any taxonomy; empty if it has none."""
    for taxonomy in pxr().UsdSemantics.LabelsAPI.GetDirectTaxonomies(prim):
        if labels := pxr().UsdSemantics.LabelsAPI(prim, taxonomy).GetLabelsAttr().Get():
            return str(labels[0])
    return ""


WORLD = "world"
"""Root link of an articulation whose first movable joint is attached to the world."""
_ADDS = "newton:jointsAddMobility"
# Types of joints of which several may act one after another between the same bodies.
_MOVING = ("PhysicsRevoluteJoint", "PhysicsPrismaticJoint", "PhysicsSphericalJoint")


class StageReader:
    """Reader of the articulations of one stage.

    Raises:
        AssetError: the stage holds something that the description lacks.
    """

    def __init__(self, reading: Reading) -> None:
        self.reading = reading
        """File, units and options."""
        self.contents = collect(reading)
        """Prims of the stage."""
        self.placements = Placements(reading.units)
        """Poses of prims in the world."""
        self.links = Links(reading, self.contents, self.placements)
        """Reader of bodies."""
        self.actuators = Actuators(self.contents.actuators, self.contents.joints, reading)
        """Actuators of MuJoCo's schema."""

    def articulations(self) -> list[PlacedArticulation]:
        """Return all articulations of the stage in its order; of a stage without bodies, one static link.

        Raises:
            AssetError: the stage holds nothing that could collide, or something that the description lacks.
        """
        bodies = self.contents.bodies
        if not bodies:
            return [self._static()]
        marked = [path for path, body in bodies.items() if body.HasAPI(pxr().UsdPhysics.ArticulationRootAPI)]
        trees = grow(list(bodies), stacked(self._edges(), self._adds_mobility), marked)
        names = self._names(trees)
        return [self._placed(tree, *name) for tree, name in zip(trees, names, strict=True)]

    def _static(self) -> PlacedArticulation:
        if not self.contents.static_colliders:
            raise AssetError(
                f"{self.reading.path} holds no rigid body and no collider: apply PhysicsRigidBodyAPI to a prim"
            )
        self.reading.note("the stage has no rigid body: its colliders are one link without mass, for a fixed base")
        link = self.links.static(self.reading.stage.GetPseudoRoot(), self.contents.parts[STAGE], WORLD)
        frames = tuple(self._frames({STAGE: WORLD}))
        return PlacedArticulation(Articulation(self._only_name(), (link,), frames=frames), fixed_base=True, path=STAGE)

    def _only_name(self) -> str:
        top = self.reading.stage.GetDefaultPrim()
        return label(top) if top else self.reading.path.stem

    def _names(self, trees: list[Tree]) -> list[tuple[str, str]]:
        """Return path and name of each articulation: the default prim's name for the only one."""
        paths = [self._around(tree) for tree in trees]
        if len(trees) == 1 and not attribute(self.reading.stage.GetPrimAtPath(paths[0]), ARTICULATION, False):
            return [(paths[0], self._only_name())]
        names = unique_names({path: label(self.reading.stage.GetPrimAtPath(path)) for path in paths})
        return [(path, names[path]) for path in paths]

    def _around(self, tree: Tree) -> str:
        """Return the path of the innermost prim that holds all bodies of an articulation, or of its first body.

        The stage's default prim holds everything and names no articulation.
        """
        bodies = [path for path in tree.bodies if path != STAGE]
        first = tree.root if tree.root != STAGE else bodies[0]
        common = pxr().Sdf.Path(first)
        for path in bodies:
            common = common.GetCommonPrefix(pxr().Sdf.Path(path))
        for above in common.GetPrefixes():
            if attribute(self.reading.stage.GetPrimAtPath(above), ARTICULATION, False):
                return str(above)
        top = self.reading.stage.GetDefaultPrim()
        alone = str(common) != STAGE and not (top and common == top.GetPath())
        return str(common) if alone else first

    def _edges(self) -> Iterator[Edge]:
        for prim in self.contents.joints:
            if self._acts(prim) and (edge := self._edge(prim)) is not None:
                yield edge

    # Disabled joints are reported: the file lets a program enable them.
    def _acts(self, prim: Any) -> bool:
        if attribute(prim, "physics:collisionEnabled", False):
            self.reading.note(f"the links that '{label(prim)}' connects do not collide, though it lets them")
        enabled = attribute(prim, "physics:jointEnabled", True)
        if not enabled:
            self.reading.note(f"joint '{label(prim)}' is disabled and left out")
        elif prim.GetTypeName() == "PhysicsDistanceJoint":
            self.reading.lack(f"{prim.GetPath()} is a distance joint")
            return False
        return enabled

    def _adds_mobility(self, edge: Edge) -> bool:
        """Return the setting of the articulation's root; else True for joints of MuJoCo, known by their schema."""
        if edge.prim.GetTypeName() not in _MOVING:
            return False
        for body in (path for path in edge.bodies if path != STAGE):
            prim = self.reading.stage.GetPrimAtPath(body)
            while prim and not prim.IsPseudoRoot():
                if is_authored(prim, _ADDS):
                    return bool(attribute(prim, _ADDS))
                prim = prim.GetParent()
        return applies(edge.prim, "MjcJointAPI")

    def _edge(self, prim: Any) -> Edge:
        bodies, frames = [], []
        stage = self.reading.stage
        for side in "01":
            named = targets(prim, f"physics:body{side}")
            target = stage.GetPrimAtPath(named[0]) if named else stage.GetPseudoRoot()
            if not target:
                raise AssetError(f"{prim.GetPath()} connects {named[0]}, which the stage lacks: correct the path")
            body = self.contents.owners.get(str(target.GetPath()), STAGE)
            placement = self.placements.of(target, stage.GetPrimAtPath(body))
            position = numbers(prim, f"physics:localPos{side}", (0.0, 0.0, 0.0))
            frames.append(placement.frame(position, rotation(prim, f"physics:localRot{side}")))
            bodies.append(body)
        if bodies[0] == bodies[1]:
            raise AssetError(f"{prim.GetPath()} connects {bodies[0]} with itself: name two rigid bodies")
        closing = bool(attribute(prim, "physics:excludeFromArticulation", False))
        return Edge(prim, (bodies[0], bodies[1]), (frames[0], frames[1]), closing)

    def _placed(self, tree: Tree, path: str, name: str) -> PlacedArticulation:
        # Each articulation collects its own notes.
        own = replace(self.reading, notes=[])
        names = self._link_names(tree)
        inner = (part for edge, _ in tree.parent_edges.values() for part in edge.parts)
        edges = [*inner, *(part for edge in tree.loops for part in edge.parts)]
        joint_names = unique_names({str(edge.prim.GetPath()): label(edge.prim) for edge in edges})
        joints = Joints(own, names, joint_names, self._pose, self.actuators)
        joints.gather(tree)
        links = [self._link(body, names[body]) for body in tree.bodies]
        if tree.root == STAGE:
            own.note(f"link '{WORLD}', without mass, replaces the world that joints are attached to: fix the base")
        articulation = Articulation(
            name,
            (*links, *joints.links),
            tuple(joints.joints),
            tuple(self._frames(names)),
            self._self_collisions(tree),
            tuple(self._exclusions(names, own)),
            tuple(own.notes),
            tuple(joints.loops),
            tuple(joints.drives),
            tuple(joints.home),
        )
        ordered = articulation if _in_order(articulation) else sort_links(articulation)
        kinematic = tree.root != STAGE and attribute(self.contents.bodies[tree.root], "physics:kinematicEnabled", False)
        return PlacedArticulation(ordered, self._pose(tree.root), tree.fixed_base or bool(kinematic), path)

    def _link_names(self, tree: Tree) -> dict[str, str]:
        """Return names of the links by their bodies' paths."""
        bodies = {path: label(self.contents.bodies[path]) for path in tree.bodies if path != STAGE}
        world = {STAGE: WORLD} if tree.root == STAGE else {}
        return world | unique_names(bodies, frozenset(world.values()))

    def _link(self, path: str, name: str) -> Link:
        return self.links.body(path, name) if path != STAGE else Link(name)

    def _pose(self, path: str) -> Pose:
        """Return the pose of the link of a body in the world."""
        return self.placements.root(self.contents.bodies[path]) if path != STAGE else Pose()

    def _frames(self, names: dict[str, str]) -> Iterator[Frame]:
        marked = {
            str(prim.GetPath()): (path, prim)
            for path in names
            for prim in self.contents.parts.get(path, [])
            if is_frame(prim)
        }
        labels = {path: label(prim) for path, (_, prim) in marked.items()}
        unique = unique_names(labels, frozenset(names.values()))
        for path, (body, prim) in marked.items():
            host = self.reading.stage.GetPrimAtPath(body)
            yield Frame(unique[path], names[body], self.placements.of(prim, host).pose)

    def _self_collisions(self, tree: Tree) -> bool:
        """Return the setting of the root; the default of UsdPhysics is True for bodies without a joint between them."""
        if len(tree.bodies) == 1:
            return False
        names = ("newton:selfCollisionEnabled", "physxArticulation:enabledSelfCollisions")
        around = [prim for path in tree.bodies if path != STAGE for prim in self._upwards(self.contents.bodies[path])]
        around += [prim for edge, _ in tree.parent_edges.values() for prim in (edge.prim,)]
        # Files put the flag on the root body, a prim above it, or the joint to the world.
        values = (attribute(prim, name) for prim in dict.fromkeys(around) for name in names)
        return next((bool(value) for value in values if value is not None), True)

    def _upwards(self, prim: Any) -> Iterator[Any]:
        while prim and not prim.IsPseudoRoot():
            if prim.HasAPI(pxr().UsdPhysics.ArticulationRootAPI):
                yield prim
            prim = prim.GetParent()

    def _exclusions(self, names: dict[str, str], own: Reading) -> Iterator[tuple[str, str]]:
        for path, name in names.items():
            if path == STAGE:
                continue
            for target in targets(self.contents.bodies[path], "physics:filteredPairs"):
                if target in names:
                    yield (name, names[target])
                else:
                    own.note(f"the collision filter of {path} against {target} is left out: it is no body here")


def _in_order(articulation: Articulation) -> bool:
    """Return True if every parent comes before its children, the root first."""
    place = {name: index for index, name in enumerate(articulation.link_names)}
    children = {joint.child for joint in articulation.joints}
    return (
        articulation.root.name not in children
        and all(place[joint.parent] < place[joint.child] for joint in articulation.joints)
        and _joints_follow_links(articulation.joints, place)
    )


def _joints_follow_links(joints: tuple[Joint, ...], place: dict[str, int]) -> bool:
    places = [place[joint.child] for joint in joints]
    return places == sorted(places)
