"""Reads an articulation from USD: UsdPhysics, and what it lacks from Newton's schemas.

Beyond those schemas, a boolean attribute ``orbit:frame = true`` on a transform below a rigid body makes it a named
frame. Display names, where given, name links, joints and frames, for USD's own names allow few characters. A collider
is drawn too unless its purpose is "guide" or it is invisible. Drive gains belong to no articulation and are not read.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from orbit_core.assets.inertia import MassProperties, combine, mass_properties
from orbit_core.assets.naming import names_file
from orbit_core.assets.options import ReadOptions
from orbit_core.assets.usd_geometry import Placement, Units, attribute, label, pxr, read_shape
from orbit_core.assets.usd_layers import open_stage
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Articulation, Frame, Joint, JointType, Link, Mimic, Pose, Shape
from orbit_core.scene.pose import FloatArray, Vector3

FRAME = "orbit:frame"
"""The attribute that marks a named frame."""
WORLD = "world"
"""The root link of an articulation whose first movable joint hangs from the world."""
_DENSITY = 1000.0
"""kg/m^3, where the stage gives none: UsdPhysics says so."""
_TYPES = {
    "PhysicsFixedJoint": JointType.FIXED,
    "PhysicsRevoluteJoint": JointType.REVOLUTE,
    "PhysicsPrismaticJoint": JointType.PRISMATIC,
}
_AXES: dict[str, Vector3] = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}


@names_file
def read_usd(path: Path | str, *, options: ReadOptions = ReadOptions()) -> Articulation:
    """The one articulation in a USD file.

    Where the root stands in the stage is left out, as is a fixed joint that holds it there: the entity says both. A
    stage with colliders and no rigid body is one static link.

    Raises:
        AssetError: the file cannot be opened, holds several articulations, a loop, or a joint or shape of a kind that
            ORBIT lacks, or USD is not installed.
    """
    return _Reader(open_stage(path, options), Path(path)).read()


@dataclass(frozen=True, eq=False)
class _Edge:
    """A joint prim between two bodies, given by path, with the joint's frame in either."""

    prim: Any
    bodies: tuple[str, str]
    frames: tuple[Pose, Pose]


@dataclass(eq=False)
class _Reader:
    stage: Any
    path: Path
    bodies: dict[str, Any] = field(default_factory=dict)
    """Prims of rigid bodies by path; ``"/"`` is the world."""
    parts: dict[str, list[Any]] = field(default_factory=dict)
    """Geometry and frames by the path of the body that carries them."""
    joints: list[Any] = field(default_factory=list)
    owners: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def read(self) -> Articulation:
        from orbit_core.assets.validation import sort_links

        self.units = Units.of(self.stage)
        self._collect()
        edges = self._edges()
        order, parent_edge = self._tree(edges)
        # Links keep the stage's order; only one in which a child precedes its parent is sorted.
        links = [self._link(path) for path in self.bodies if path in order]
        joints = [self._joint(*parent_edge[path]) for path in self.bodies if path in parent_edge]
        top = self.stage.GetDefaultPrim()
        articulation = Articulation(
            label(top) if top else self.path.stem,
            tuple(links),
            tuple(joints),
            tuple(self._frames()),
            self._self_collisions(),
            tuple(self._exclusions()),
            tuple(self.notes),
        )
        return articulation if _in_order(articulation) else sort_links(articulation)

    def _collect(self) -> None:
        stray = []
        for prim in pxr().Usd.PrimRange(self.stage.GetPseudoRoot(), pxr().Usd.TraverseInstanceProxies()):
            path = str(prim.GetPath())
            owner = self.owners.get(str(prim.GetPath().GetParentPath()), "/")
            if prim.HasAPI(pxr().UsdPhysics.RigidBodyAPI) and attribute(prim, "physics:rigidBodyEnabled", True):
                self.bodies[path] = prim
                owner = path
            self.owners[path] = owner
            if prim.IsA(pxr().UsdPhysics.Joint):
                self.joints.append(prim)
            elif prim.IsA(pxr().UsdGeom.Gprim) or attribute(prim, FRAME, False):
                self.parts.setdefault(owner, []).append(prim)
                stray += [path] if owner == "/" and prim.HasAPI(pxr().UsdPhysics.CollisionAPI) else []
        if stray and self.bodies:
            self.notes.append(f"colliders outside every rigid body are left out: {', '.join(stray)}")
        if not self.bodies:
            if not stray:
                raise AssetError(
                    f"{self.path} holds no rigid body and no collider: apply PhysicsRigidBodyAPI to a prim"
                )
            self.notes.append("the stage has no rigid body: its colliders are one link without mass, for a fixed base")
            self.bodies["/"] = self.stage.GetPseudoRoot()

    def _edges(self) -> list[_Edge]:
        edges = [self._edge(prim) for prim in self.joints if self._enabled(prim)]
        if any("/" in edge.bodies and edge.prim.GetTypeName() != "PhysicsFixedJoint" for edge in edges):
            self.bodies = {"/": self.stage.GetPseudoRoot(), **self.bodies}
            self.parts.pop("/", None)
            self.notes.append(f"link '{WORLD}', without mass, stands for what joints hang from: fix the base")
            return edges
        self.fixed_to_world = [body for edge in edges if "/" in edge.bodies for body in edge.bodies if body != "/"]
        if self.fixed_to_world:
            self.notes.append("the fixed joint to the world is left out: the entity says whether its base is fixed")
        return [edge for edge in edges if "/" not in edge.bodies]

    def _enabled(self, prim: Any) -> bool:
        if prim.GetTypeName() not in _TYPES:
            raise AssetError(f"{prim.GetPath()} is a {prim.GetTypeName()}: only fixed, revolute and prismatic are read")
        if attribute(prim, "physics:excludeFromArticulation", False):
            raise AssetError(
                f"{prim.GetPath()} is excluded from its articulation: joints that close loops are not read"
            )
        if attribute(prim, "physics:collisionEnabled", False):
            self.notes.append(f"the links that '{label(prim)}' connects do not collide, though it lets them")
        enabled = attribute(prim, "physics:jointEnabled", True)
        if not enabled:
            self.notes.append(f"joint '{label(prim)}' is disabled and left out")
        return enabled

    def _edge(self, prim: Any) -> _Edge:
        bodies, frames = [], []
        for side in "01":
            targets = prim.GetRelationship(f"physics:body{side}").GetTargets()
            target = self.stage.GetPrimAtPath(targets[0]) if targets else self.stage.GetPseudoRoot()
            if not target:
                raise AssetError(f"{prim.GetPath()} connects {targets[0]}, which the stage lacks")
            body = self.owners.get(str(target.GetPath()), "/")
            placement = Placement.of(target, self.stage.GetPrimAtPath(body), self.units)
            rotation = attribute(prim, f"physics:localRot{side}")
            frames.append(placement.frame(attribute(prim, f"physics:localPos{side}"), rotation))
            bodies.append(body)
        if bodies[0] == bodies[1]:
            raise AssetError(f"{prim.GetPath()} connects {bodies[0]} with itself: name two rigid bodies")
        return _Edge(prim, (bodies[0], bodies[1]), (frames[0], frames[1]))

    def _tree(self, edges: list[_Edge]) -> tuple[set[str], dict[str, tuple[_Edge, bool]]]:
        """The bodies reached from the root, and for each but the root its joint and whether that runs backwards."""
        reached = {self._root(edges)}
        parent_edge: dict[str, tuple[_Edge, bool]] = {}
        rest = list(edges)
        while ready := [edge for edge in rest if reached.intersection(edge.bodies)]:
            for edge in ready:
                parent, child = edge.bodies
                if parent in reached and child in reached:
                    raise AssetError(f"{edge.prim.GetPath()} closes a loop of joints: only trees are read")
                backwards = child in reached
                new = parent if backwards else child
                reached.add(new)
                parent_edge[new] = (edge, backwards)
            rest = [edge for edge in rest if edge not in ready]
        if loose := [path for path in self.bodies if path not in reached]:
            raise AssetError(f"no joint leads from the root to {loose[0]}: a file holds one articulation")
        return reached, parent_edge

    def _root(self, edges: list[_Edge]) -> str:
        if "/" in self.bodies:
            return "/"
        children = {edge.bodies[1] for edge in edges}
        marked = [path for path, prim in self.bodies.items() if prim.HasAPI(pxr().UsdPhysics.ArticulationRootAPI)]
        parentless = [path for path in self.bodies if path not in children]
        return [*marked, *self.fixed_to_world, *parentless, *self.bodies][0]

    def _name(self, path: str) -> str:
        return label(self.bodies[path]) if path != "/" else WORLD

    def _link(self, path: str) -> Link:
        body = self.bodies[path]
        collisions: list[Shape] = []
        visuals: list[Shape] = []
        solids: list[MassProperties] = []
        for prim in self.parts.get(path, []):
            if not prim.IsA(pxr().UsdGeom.Gprim):
                continue
            collides = prim.HasAPI(pxr().UsdPhysics.CollisionAPI) and attribute(prim, "physics:collisionEnabled", True)
            imageable = pxr().UsdGeom.Imageable(prim)
            drawn = imageable.ComputePurpose() != "guide" and imageable.ComputeVisibility() != "invisible"
            shape = read_shape(prim, body, self.units, self.notes) if collides or drawn else None
            if shape is None:
                if collides:
                    raise AssetError(f"{prim.GetPath()} is a collider of type {prim.GetTypeName()}: make it a mesh")
                continue
            visuals += [shape] if drawn else []
            if collides:
                collisions.append(shape)
                if path != "/" and not self._mass_is_given(body):
                    solids.append(self._solid(prim, body, shape))
        properties = self._mass(body, solids) if path != "/" else MassProperties(0.0, (0.0, 0.0, 0.0), np.zeros((3, 3)))
        return Link(
            self._name(path),
            properties.mass,
            properties.center_of_mass,
            properties.inertia,
            tuple(collisions),
            tuple(visuals),
            _semantic_label(body),
        )

    def _mass_is_given(self, body: Any) -> bool:
        given = attribute(body, "newton:inertia", ()) or any(attribute(body, "physics:diagonalInertia", (0.0,)))
        return attribute(body, "physics:mass", 0.0) > 0 and bool(given)

    def _solid(self, prim: Any, body: Any, shape: Shape) -> MassProperties:
        """What a collider weighs: by its own mass, or the density of itself, its body, or its material."""
        if (mass := attribute(prim, "physics:mass", 0.0)) > 0:
            return mass_properties(shape.geometry, mass=mass * self.units.mass).placed(shape.pose)
        material = pxr().UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
        sources = (prim, body, *([material.GetPrim()] if material else []))
        densities = [attribute(source, "physics:density", 0.0) for source in sources]
        authored = next((value for value in densities if value > 0), None)
        density = _DENSITY if authored is None else authored * self.units.mass / self.units.length**3
        return mass_properties(shape.geometry, density=density).placed(shape.pose)

    def _mass(self, body: Any, solids: list[MassProperties]) -> MassProperties:
        """A body's own mass, centre and inertia as far as it gives them, and those of its colliders for the rest."""
        of_shapes = combine(solids) if solids else MassProperties(0.0, (0.0, 0.0, 0.0), np.zeros((3, 3)))
        placement = Placement.of(body, body, self.units)
        mass = attribute(body, "physics:mass", 0.0) * self.units.mass or of_shapes.mass
        center = attribute(body, "physics:centerOfMass", (-math.inf,))
        x, y, z = placement.point(center) if math.isfinite(center[0]) else of_shapes.center_of_mass
        inertia = self._inertia(body, placement)
        if inertia is None:
            inertia = of_shapes.inertia * (mass / of_shapes.mass if of_shapes.mass else 1.0)
        return MassProperties(mass, (float(x), float(y), float(z)), inertia)

    def _inertia(self, body: Any, placement: Placement) -> FloatArray | None:
        unit = self.units.inertia(angular=True)
        full = attribute(body, "newton:inertia", ())
        if len(full) == 6:
            xx, yy, zz, xy, xz, yz = full
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            axes = placement.pose.rotation_matrix()
        else:
            diagonal = attribute(body, "physics:diagonalInertia", (0.0, 0.0, 0.0))
            if not any(diagonal):
                return None
            tensor = np.diag(np.asarray(diagonal, dtype=float))
            axes = placement.frame((0.0, 0.0, 0.0), attribute(body, "physics:principalAxes")).rotation_matrix()
        return unit * axes @ tensor @ axes.T

    def _joint(self, edge: _Edge, backwards: bool) -> Joint:
        prim = edge.prim
        kind = _TYPES[prim.GetTypeName()]
        (parent, child), (parent_pose, child_pose) = edge.bodies, edge.frames
        x, y, z = _AXES[attribute(prim, "physics:axis", "Z")]
        if backwards:
            parent, child, parent_pose, child_pose, x, y, z = child, parent, child_pose, parent_pose, -x, -y, -z
        joint = Joint(label(prim), kind, self._name(parent), self._name(child), parent_pose, child_pose, (x, y, z))
        return joint if kind is JointType.FIXED else self._with_dynamics(joint, prim)

    def _with_dynamics(self, joint: Joint, prim: Any) -> Joint:
        angular = joint.type is JointType.REVOLUTE
        position, effort = self.units.position(angular), self.units.effort(angular)
        lower = attribute(prim, "physics:lowerLimit", -math.inf) * position
        upper = attribute(prim, "physics:upperLimit", math.inf) * position
        if lower > upper:
            self.notes.append(f"joint '{joint.name}' is locked by limits of which the lower is above the upper: fixed")
            return replace(joint, type=JointType.FIXED)
        drive = f"drive:{'angular' if angular else 'linear'}:physics"
        return replace(
            joint,
            type=JointType.CONTINUOUS if angular and lower == -math.inf and upper == math.inf else joint.type,
            lower_limit=lower,
            upper_limit=upper,
            effort_limit=attribute(prim, f"{drive}:maxForce", math.inf) * effort,
            velocity_limit=attribute(prim, "newton:velocityLimit", math.inf) * position,
            damping=attribute(prim, "newton:damping", 0.0) * effort / position,
            friction=attribute(prim, "newton:friction", 0.0) * effort,
            armature=attribute(prim, "newton:armature", 0.0) * self.units.inertia(angular),
            mimic=self._mimic(prim, position),
        )

    def _mimic(self, prim: Any, position: float) -> Mimic | None:
        targets = prim.GetRelationship("newton:mimicJoint").GetTargets()
        if not targets or not attribute(prim, "newton:mimicEnabled", True):
            return None
        leader = self.stage.GetPrimAtPath(targets[0])
        if not leader:
            raise AssetError(f"{prim.GetPath()} mimics {targets[0]}, which the stage lacks")
        scale = position / self.units.position(leader.GetTypeName() == "PhysicsRevoluteJoint")
        return Mimic(
            label(leader),
            attribute(prim, "newton:mimicCoef1", 1.0) * scale,
            attribute(prim, "newton:mimicCoef0", 0.0) * position,
        )

    def _frames(self) -> Iterator[Frame]:
        for path, body in self.bodies.items():
            for prim in self.parts.get(path, []):
                if attribute(prim, FRAME, False):
                    yield Frame(label(prim), self._name(path), Placement.of(prim, body, self.units).pose)

    def _self_collisions(self) -> bool:
        """As the articulation's root says; UsdPhysics itself lets all bodies collide that no joint connects."""
        if len(self.bodies) == 1:
            return False
        roots = [prim for prim in self.stage.Traverse() if prim.HasAPI(pxr().UsdPhysics.ArticulationRootAPI)]
        names = ("newton:selfCollisionEnabled", "physxArticulation:enabledSelfCollisions")
        values = [attribute(root, name) for root in roots for name in names]
        return next((bool(value) for value in values if value is not None), True)

    def _exclusions(self) -> Iterator[tuple[str, str]]:
        for path, body in self.bodies.items():
            for target in body.GetRelationship("physics:filteredPairs").GetTargets():
                if str(target) in self.bodies:
                    yield (self._name(path), self._name(str(target)))
                else:
                    self.notes.append(
                        f"the collision filter of {path} against {target} is left out: it is no body here"
                    )


def _semantic_label(prim: Any) -> str:
    for taxonomy in pxr().UsdSemantics.LabelsAPI.GetDirectTaxonomies(prim):
        if labels := pxr().UsdSemantics.LabelsAPI(prim, taxonomy).GetLabelsAttr().Get():
            return str(labels[0])
    return ""


def _in_order(articulation: Articulation) -> bool:
    """Whether every parent comes before its children, the root first."""
    place = {name: index for index, name in enumerate(articulation.link_names)}
    children = {joint.child for joint in articulation.joints}
    return articulation.root.name not in children and all(
        place[joint.parent] < place[joint.child] for joint in articulation.joints
    )
