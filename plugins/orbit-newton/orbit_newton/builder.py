"""All environments of a scene as one Newton model: a body a link, an articulation an entity, a world an environment.

Bodies stand in the layout's order, environment by environment, so body ``e L + l`` is link l of environment e. A fixed
base is a kinematic body on a fixed joint, whose place in the world each environment may choose.
"""

# pyright: reportMissingImports=false
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
# Warp's types are made at run time.

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import combinations

import newton
import numpy as np
import numpy.typing as npt
import warp as wp

from orbit_core.interfaces import TERRAIN, EntityLayout, SceneLayout
from orbit_core.scene import Joint, JointType, Link, PhysicsMaterial, Pose
from orbit_core.scene.pose import Vector3
from orbit_newton.shapes import ShapeBuilder, transform

Indices = npt.NDArray[np.int64]
UNLIMITED = 1e10
"""The value in the place of infinity in limits."""


@dataclass(frozen=True, eq=False)
class BuiltModel:
    """A model of all environments, and where the layout's things stand in it."""

    model: newton.Model
    """Newton's model."""
    joints: Indices
    """(J,) joint number of each of the layout's joints, in one environment."""
    positions: Indices
    """(J,) into one environment's joint coordinates."""
    velocities: Indices
    """(J,) into one environment's joint velocities."""
    targets: Indices
    """(J,) into one environment's position targets."""
    zeros: npt.NDArray[np.float64]
    """(J,) the contract's joint position where Newton's is zero."""
    root_joints: Indices
    """(entities,) joint that carries each root."""
    root_positions: Indices
    """(entities,) into one environment's joint coordinates; -1 for a fixed base."""
    root_velocities: Indices
    """(entities,) into one environment's joint velocities; -1 for a fixed base."""
    link_of_shape: Indices
    """(shapes,) of one environment; TERRAIN for the terrain's."""
    materials: tuple[PhysicsMaterial, ...]
    """(shapes,) of one environment."""


def build_model(layout: SceneLayout, num_envs: int, device: wp.Device, gap: float, maximal: bool) -> BuiltModel:
    """Build ``num_envs`` worlds of the scene on ``device``.

    ``gap`` in metres is how far around shapes contacts are found; ``maximal`` is for solvers whose bodies move freely
    between corrections. The armature of a turning joint is then inertia of its child link, for they know none; about
    every axis, for about one alone they would diverge. And joint positions count from the middle of their limits, for
    such a solver knows an angle only within half a turn of zero.
    """
    built = _Builder(layout, gap, maximal)
    scene = newton.ModelBuilder()
    # One world is built in Python and copied by Newton, since building each would take as long as the first.
    scene.replicate(built.world, num_envs)
    # Newton's validation would change inertias; the core has checked them.
    model = scene.finalize(device=device, skip_validation_inertia=True)
    joints = np.array(built.joints, dtype=np.int64)
    roots = np.array(built.roots, dtype=np.int64)
    # A fixed root has no coordinates, and where it would have some the next joint's begin.
    free = np.array([not entity.spec.fixed_base for entity in layout.entities], dtype=bool)
    position_starts = np.array(built.world.joint_q_start, dtype=np.int64)
    velocity_starts = np.array(built.world.joint_qd_start, dtype=np.int64)
    target_starts = model.joint_target_q_start.numpy()[: len(position_starts)].astype(np.int64)
    return BuiltModel(
        model=model,
        joints=joints,
        positions=position_starts[joints],
        velocities=velocity_starts[joints],
        targets=target_starts[joints],
        zeros=built.zeros,
        root_joints=roots,
        root_positions=np.where(free, position_starts[roots], -1),
        root_velocities=np.where(free, velocity_starts[roots], -1),
        link_of_shape=np.array(built.shapes.links, dtype=np.int64),
        materials=tuple(built.shapes.materials),
    )


@dataclass
class _Builder:
    """Builds one environment."""

    layout: SceneLayout
    gap: float
    maximal: bool
    zeros: npt.NDArray[np.float64] = field(init=False)
    world: newton.ModelBuilder = field(init=False)
    shapes: ShapeBuilder = field(init=False)
    joints: list[int] = field(default_factory=list)
    roots: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.world = newton.ModelBuilder(gravity=tuple(self.layout.scene.gravity))
        self.shapes = ShapeBuilder(self.world, self.gap)
        self.zeros = _middles(self.layout) if self.maximal else np.zeros(len(self.layout.joints))
        rotors = self._rotor_inertias()
        for number in range(len(self.layout.links)):
            self._add_body(number, rotors[number])
        for shape in self.layout.scene.terrain:
            self.shapes.add(-1, TERRAIN, shape, f"terrain shape '{shape.name}'")
        for entity in self.layout.entities:
            self._add_entity(entity)
        self._keep_apart()

    def _rotor_inertias(self) -> npt.NDArray[np.float64]:
        """(L,) of motors, where links are to carry them."""
        # Only for solvers that move bodies: one of joints takes the armature as it is.
        inertias = np.zeros(len(self.layout.links))
        if self.maximal:
            for entity in self.layout.entities:
                articulation = entity.spec.articulation
                movable = zip(articulation.movable_joints, range(entity.joints.start, entity.joints.stop), strict=True)
                for joint, number in movable:
                    if joint.type is not JointType.PRISMATIC:
                        link = entity.links.start + articulation.link_names.index(joint.child)
                        inertias[link] = self.layout.joint_parameters.armature[number]
        return inertias

    def _add_body(self, number: int, rotor: float) -> None:
        link = self.layout.links[number]
        entity = self.layout.entities[self.layout.entity_of_link[number]]
        pose = entity.spec.pose if number == entity.root_link else Pose()
        self.world.add_link(
            xform=transform(pose),
            com=wp.vec3(*map(float, link.center_of_mass)),
            mass=float(link.mass),
            inertia=wp.mat33(*(np.asarray(link.inertia, dtype=float) + rotor * np.eye(3)).ravel().tolist()),
            lock_inertia=True,
            is_kinematic=number == entity.root_link and entity.spec.fixed_base,
            label=f"link{number}",
        )

    def _add_entity(self, entity: EntityLayout) -> None:
        articulation = entity.spec.articulation
        incoming = {joint.child: joint for joint in articulation.joints}
        numbers = {name: entity.links.start + index for index, name in enumerate(articulation.link_names)}
        own: list[int] = []
        for link in articulation.links:
            joint, number = incoming.get(link.name), numbers[link.name]
            own.append(
                self._add_root(entity) if joint is None else self._add_joint(joint, numbers[joint.parent], number)
            )
            self._add_shapes(entity, link, number)
        self.roots.append(own[0])
        self.world.add_articulation(own, label=entity.name)
        self._add_mimics(entity)

    def _add_root(self, entity: EntityLayout) -> int:
        if not entity.spec.fixed_base:
            return self.world.add_joint_free(entity.root_link)
        pose = transform(entity.spec.pose)
        return self.world.add_joint_fixed(-1, entity.root_link, parent_xform=pose, collision_filter_parent=False)

    def _add_joint(self, joint: Joint, parent: int, child: int) -> int:
        # Both frames are turned so that every joint moves about or along x, of which XPBD knows angles best.
        turned = Pose.from_axis_angle(*_from_x(joint.axis))
        frames = {
            "parent_xform": transform(joint.parent_pose @ turned),
            "child_xform": transform(joint.child_pose @ turned),
        }
        if not joint.movable:
            return self.world.add_joint_fixed(parent, child, collision_filter_parent=False, **frames)
        number = len(self.joints)
        zero = self.zeros[number]
        frames["parent_xform"] = transform(joint.parent_pose @ turned @ Pose.from_axis_angle((1.0, 0.0, 0.0), zero))
        parameters = self.layout.joint_parameters
        lower, upper = joint_limits(self.layout)
        add = self.world.add_joint_prismatic if joint.type is JointType.PRISMATIC else self.world.add_joint_revolute
        index = add(
            parent,
            child,
            axis=newton.Axis.X,
            target_ke=float(parameters.drive_stiffness[number]),
            target_kd=float(parameters.drive_damping[number]),
            limit_lower=float(lower[number] - zero),
            limit_upper=float(upper[number] - zero),
            armature=float(parameters.armature[number]),
            effort_limit=float(min(parameters.effort_limit[number], UNLIMITED)),
            collision_filter_parent=False,
            label=f"joint{number}",
            **frames,
        )
        self.joints.append(index)
        return index

    def _add_mimics(self, entity: EntityLayout) -> None:
        names = entity.spec.articulation.joint_names
        for offset, joint in enumerate(entity.spec.articulation.movable_joints):
            if joint.mimic:
                follower = entity.joints.start + offset
                leader = entity.joints.start + names.index(joint.mimic.joint)
                factor = joint.mimic.multiplier
                # The description relates positions of the contract, and Newton its coordinates, whose zeros are
                # shifted.
                constant = joint.mimic.offset + factor * self.zeros[leader] - self.zeros[follower]
                coefficients = (float(constant), float(factor))
                self.world.set_joint_mimic(self.joints[follower], self.joints[leader], coeffs=coefficients)

    # Shapes ----------------------------------------------------------------------------------------------------------

    def _add_shapes(self, entity: EntityLayout, link: Link, number: int) -> None:
        for shape in link.collisions:
            self.shapes.add(number, number, shape, f"link '{link.name}' of '{entity.name}'")

    def _keep_apart(self) -> None:
        """Exclude pairs of shapes that may not touch: of immovable links, and within an articulation."""
        apart = {frozenset(pair) for entity in self.layout.entities for pair in _pairs_apart(entity)}
        immovable = {entity.root_link for entity in self.layout.entities if entity.spec.fixed_base} | {TERRAIN}
        for (one, first), (other, second) in combinations(enumerate(self.shapes.links), 2):
            # Contacts of what cannot move would only fill the buffer.
            still = first in immovable and second in immovable
            if first == second or still or frozenset((first, second)) in apart:
                self.world.add_shape_collision_filter_pair(one, other)


def _pairs_apart(entity: EntityLayout) -> list[tuple[int, int]]:
    """Pairs of the layout's links that never touch."""
    articulation = entity.spec.articulation
    start = entity.links.start
    if not articulation.self_collisions:
        return list(combinations(range(start, entity.links.stop), 2))
    number = {name: start + index for index, name in enumerate(articulation.link_names)}
    joined = [(number[joint.parent], number[joint.child]) for joint in articulation.joints]
    return joined + [(number[one], number[other]) for one, other in articulation.collision_exclusions]


def _from_x(axis: Vector3) -> tuple[Vector3, float]:
    """The rotation, as axis and angle, that takes x to ``axis``; XPBD knows angles about x best."""
    x, y, z = map(float, np.asarray(axis) / np.linalg.norm(axis))
    # Along x the axis of the turn is undefined: none for +x, and half a turn about z for -x.
    if abs(y) + abs(z) < 1e-9:
        return (0.0, 0.0, 1.0), 0.0 if x > 0 else math.pi
    return (0.0, -z / math.hypot(y, z), y / math.hypot(y, z)), math.atan2(math.hypot(y, z), x)


def joint_limits(layout: SceneLayout) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Lower and upper limit of each of the layout's joints (J,), finite."""
    parameters = layout.joint_parameters
    endless = np.array([joint.type is JointType.CONTINUOUS for joint in layout.joints], dtype=bool)
    lower = np.where(endless, -UNLIMITED, np.maximum(parameters.lower_limit, -UNLIMITED))
    upper = np.where(endless, UNLIMITED, np.minimum(parameters.upper_limit, UNLIMITED))
    return lower, upper


def _middles(layout: SceneLayout) -> npt.NDArray[np.float64]:
    """(J,) of the limits of joints that turn between limits; zero for others."""
    lower, upper = joint_limits(layout)
    turns = np.array([joint.type is not JointType.PRISMATIC for joint in layout.joints], dtype=bool)
    bounded = turns & (lower > -UNLIMITED) & (upper < UNLIMITED)
    return np.where(bounded, (lower + upper) / 2, 0.0)
