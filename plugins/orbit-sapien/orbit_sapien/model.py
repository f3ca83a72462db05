"""Copies of a scene in PhysX worlds, in each side by side on a grid.

A link is an articulation link, a free body alone, or an immovable one. Environments do not see each other: PhysX kills
pairs of shapes whose filter data name different environments. Where a level ground is shared by all, shapes carry one
of 31 colours instead, dealt so that equal ones lie far apart.
"""

# pyright: reportAttributeAccessIssue=false

# SAPIEN's stubs ask for shapes of arrays that NumPy's types cannot express.
# pyright: reportArgumentType=false

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import MAX_SPEED, TERRAIN, Approximation, AssetError, EntityLayout, SceneLayout
from orbit_core.plugin_kit.bodies import stand_in_approximations, with_stand_in
from orbit_core.scene import Joint, JointType, Link, LoopJoint, PhysicsMaterial, Plane, Pose, Shape
from orbit_sapien.config import SapienConfig
from orbit_sapien.geometry import collision_shape
from orbit_sapien.isolation import COLORS, color, exclusion_groups, grid_offset
from orbit_sapien.materials import PairRule
from orbit_sapien.native import native_pose, physx, sapien
from orbit_sapien.tendons import add_mimic_tendon, mimic_approximations

# Speed limit of bodies that have none, beyond where a run counts as diverged; PhysX's own are a few metres per second.
_FAST = 10.0 * MAX_SPEED
# Less than half the distance between environments of one colour, in cells.
_FREE_CELLS = 2.5
# Environments on a shared ground stand so many times farther apart.
_SHARED_SPREAD = 4.0
_SLIPS = "PhysX's TGS solver slips before the whole normal force is there; temporal_gauss_seidel=False holds"
# Metres between two shapes at the beginning of a step beyond which PhysX gives their contact no friction.
_FRICTION_REACH = 0.004
_NO_REBOUND = "PhysX takes slower contacts for resting, by the setting 'bounce_threshold'"


@dataclass(frozen=True, eq=False)
class NativeEntity:
    """The bodies of one entity in one environment."""

    bodies: tuple[physx.PhysxRigidBaseComponent, ...]
    """One body for each link, in the layout's order."""
    articulation: physx.PhysxArticulation | None = None
    """PhysX's articulation; None for a single body."""
    joints: tuple[physx.PhysxArticulationJoint, ...] = ()
    """Movable joints, in the layout's order."""
    dof_order: tuple[int, ...] = ()
    """The layout's joint at each of the articulation's degrees of freedom."""

    @cached_property
    def free(self) -> bool:
        """True if it is a single body that moves."""
        return isinstance(self.bodies[0], physx.PhysxRigidDynamicComponent)


@dataclass(eq=False)
class NativeEnvironment:
    """The entities of one environment."""

    scene: sapien.Scene
    """SAPIEN's scene of the environment."""
    offset: npt.NDArray[np.float64]
    """(3,) m of the environment in its PhysX world."""
    entities: list[NativeEntity] = field(default_factory=list)
    """Bodies and joints of each entity, in the layout's order."""
    shapes: dict[int, list[tuple[int, physx.PhysxCollisionShape]]] = field(default_factory=dict)
    """Per link, or TERRAIN: each shape with its material group."""
    terrain: list[physx.PhysxRigidBaseComponent] = field(default_factory=list)
    """Bodies of the terrain."""


@dataclass(frozen=True, eq=False)
class BuiltWorld:
    """All environments, and the approximations in them."""

    environments: tuple[NativeEnvironment, ...]
    """Environments in order."""
    systems: tuple[physx.PhysxSystem, ...]
    """PhysX worlds, in the order of their environments."""
    per_system: int
    """Environments of each world; the last may have fewer."""
    rule: PairRule
    """Coefficients of pairs of groups."""
    report: tuple[Approximation, ...]
    """Differences from the scene."""
    shared_ground: bool
    """True if all environments of a world stand on one plane."""
    reach: float
    """Metres that bodies may go from their origin, over a shared ground, before they could meet other environments'."""


def build_world(
    layout: SceneLayout,
    num_envs: int,
    config: SapienConfig,
    make_system: Callable[[], physx.PhysxSystem],
    per_system: int,
) -> BuiltWorld:
    """Make every environment.

    Args:
        layout: the scene.
        num_envs: number of environments.
        config: settings of the backend.
        make_system: makes an empty PhysX world.
        per_system: environments of each world.

    Raises:
        AssetError: PhysX refuses a shape or link; names it.
    """
    return _Builder(layout, num_envs, config, make_system, per_system).world


def configure_physx(
    layout: SceneLayout, config: SapienConfig, *, threads: int, enable_enhanced_determinism: bool
) -> None:
    """Set PhysX's defaults, which apply to everything created from now on."""
    physx.set_scene_config(
        gravity=np.asarray(layout.scene.gravity, np.float32),
        bounce_threshold=config.bounce_threshold,
        enable_tgs=config.temporal_gauss_seidel,
        enable_enhanced_determinism=enable_enhanced_determinism,
        enable_friction_every_iteration=True,
        cpu_workers=threads,
    )
    physx.set_body_config(config.position_iterations, config.velocity_iterations, 0.0)
    physx.set_shape_config(config.contact_offset, 0.0)


class _Builder:
    def __init__(
        self,
        layout: SceneLayout,
        num_envs: int,
        config: SapienConfig,
        make_system: Callable[[], physx.PhysxSystem],
        per_system: int,
    ) -> None:
        self.layout, self.config = layout, config
        self.report: list[Approximation] = []
        self.rule = PairRule(layout)
        given = (self.rule.given(self.rule.asked(name)) for name in ("static", "dynamic", "restitution"))
        self.materials = [physx.PhysxMaterial(*map(float, values)) for values in zip(*given, strict=True)]
        self.patch_radii = self.rule.patch_radii(self.rule.asked("dynamic"))
        self.level = [shape for shape in layout.scene.terrain if _is_level(shape)]
        tilted = any(isinstance(s.geometry, Plane) and not _is_level(s) for s in layout.scene.terrain)
        crowded = min(num_envs, per_system) > config.shared_ground_above
        self.shared_ground = crowded and bool(self.level) and not tilted
        self.spacing = config.env_spacing * (_SHARED_SPREAD if self.shared_ground else 1.0)
        systems = tuple(make_system() for _ in range(-(-num_envs // per_system)))
        environments: list[NativeEnvironment] = []
        for index in range(num_envs):
            number, slot = divmod(index, per_system)
            place = grid_offset(slot, self.spacing)
            environments.append(NativeEnvironment(sapien.Scene([systems[number]]), place))
            self._fill(environments[-1], slot, self.report if index == 0 else None)
        self.report += self.rule.approximations(layout)
        if 2.0 * config.contact_offset > _FRICTION_REACH:
            asked, got = "friction of fast impacts", f"none of contacts found beyond {1000 * _FRICTION_REACH:g} mm"
            why = f"contacts are looked for at {2000 * config.contact_offset:g} mm, by the setting 'contact_offset'"
            self.report.append(Approximation("contacts", asked, got, why))
        self.world = BuiltWorld(
            tuple(environments),
            systems,
            per_system,
            self.rule,
            tuple(self.report),
            self.shared_ground,
            _FREE_CELLS * self.spacing,
        )

    def _fill(self, environment: NativeEnvironment, slot: int, report: list[Approximation] | None) -> None:
        """Make the environment at a place of its world."""
        isolation = self._isolation(environment, slot)
        self._add_terrain(environment, isolation, report, first=slot == 0)
        for entity in self.layout.entities:
            groups = exclusion_groups(entity, report)
            bodies = [
                self._make_body(environment, entity, offset, groups[offset], isolation, report)
                for offset in range(len(entity.spec.articulation.links))
            ] if not entity.spec.articulation.joints else self._make_links(
                environment, entity, groups, isolation, report
            )  # fmt: skip
            environment.entities.append(self._add(environment, entity, bodies))
            if report is not None:
                self._report_joints(entity)

    # Who may touch whom ----------------------------------------------------------------------------------------------

    def _isolation(self, environment: NativeEnvironment, slot: int) -> tuple[int, int]:
        """Colour mask and upper half of the fourth filter word."""
        if self.shared_ground:
            return 1 << color(environment.offset, self.spacing), 0
        return 1, (slot + 1) << 16

    # Terrain ---------------------------------------------------------------------------------------------------------

    def _add_terrain(
        self,
        environment: NativeEnvironment,
        isolation: tuple[int, int],
        report: list[Approximation] | None,
        *,
        first: bool,
    ) -> None:
        shapes = self.layout.scene.terrain
        if self.shared_ground and not first:
            shapes = tuple(shape for shape in shapes if shape not in self.level)
        for shape in shapes:
            body = physx.PhysxRigidStaticComponent()
            everyone = self.shared_ground and shape in self.level
            mask = (1 << COLORS) - 1 if everyone else isolation[0]
            made = self._attach(environment, body, TERRAIN, shape, f"terrain shape '{shape.name}'", report)
            made.set_collision_groups([mask, mask, 0, isolation[1]])
            environment.terrain.append(body)
            _place(environment.scene, body, native_pose(Pose()), environment.offset)

    def _attach(
        self,
        environment: NativeEnvironment,
        body: physx.PhysxRigidBaseComponent,
        link: int,
        shape: Shape,
        subject: str,
        report: list[Approximation] | None,
    ) -> physx.PhysxCollisionShape:
        group = self.rule.index(link, shape.material)
        made = collision_shape(shape, self.materials[group], subject, report)
        made.set_min_patch_radius(float(self.patch_radii[group]))
        body.attach(made)
        environment.shapes.setdefault(link, []).append((group, made))
        if report is not None:
            report += self._material_approximations(shape.material, subject)
        return made

    def _material_approximations(self, material: PhysicsMaterial, subject: str) -> list[Approximation]:
        found: list[Approximation] = []
        if material.restitution:
            got = f"none below {self.config.bounce_threshold:g} m/s"
            found.append(Approximation(subject, f"restitution {material.restitution:g}", got, _NO_REBOUND))
        if material.static_friction > material.dynamic_friction and self.config.temporal_gauss_seidel:
            asked = f"static friction {material.static_friction:g}, dynamic {material.dynamic_friction:g}"
            found.append(Approximation(subject, asked, "faces may slip below static friction", _SLIPS))
        if material.torsional_friction > PhysicsMaterial().torsional_friction and not self.config.temporal_gauss_seidel:
            asked = f"torsional friction {material.torsional_friction:g}"
            found.append(
                Approximation(subject, asked, "none", "PhysX's PGS solver has none: set temporal_gauss_seidel")
            )
        return found

    # Bodies ----------------------------------------------------------------------------------------------------------

    def _make_links(
        self,
        environment: NativeEnvironment,
        entity: EntityLayout,
        groups: list[int],
        isolation: tuple[int, int],
        report: list[Approximation] | None,
    ) -> list[physx.PhysxRigidBaseComponent]:
        articulation = entity.spec.articulation
        incoming = {joint.child: joint for joint in articulation.joints}
        made: dict[str, physx.PhysxArticulationLinkComponent] = {}
        movable = iter(range(entity.joints.start, entity.joints.stop))
        for offset, link in enumerate(articulation.links):
            joint = incoming.get(link.name)
            body = physx.PhysxArticulationLinkComponent(made[joint.parent] if joint else None)
            body.name = link.name
            made[link.name] = body
            self._fill_body(environment, body, entity, offset, groups[offset], isolation, report)
            if joint is None:
                body.joint.type = "fixed" if entity.spec.fixed_base else "undefined"
            else:
                self._set_joint(body.joint, joint, next(movable) if joint.movable else None)
        return list(made.values())

    def _make_body(
        self,
        environment: NativeEnvironment,
        entity: EntityLayout,
        offset: int,
        group: int,
        isolation: tuple[int, int],
        report: list[Approximation] | None,
    ) -> physx.PhysxRigidBaseComponent:
        static = entity.spec.fixed_base
        body = physx.PhysxRigidStaticComponent() if static else physx.PhysxRigidDynamicComponent()
        self._fill_body(environment, body, entity, offset, group, isolation, report)
        return body

    def _fill_body(
        self,
        environment: NativeEnvironment,
        body: physx.PhysxRigidBaseComponent,
        entity: EntityLayout,
        offset: int,
        group: int,
        isolation: tuple[int, int],
        report: list[Approximation] | None,
    ) -> None:
        link = entity.spec.articulation.links[offset]
        number, subject = entity.links.start + offset, f"link '{link.name}' of '{entity.name}'"
        for shape in link.collisions:
            made = self._attach(environment, body, number, shape, subject, report)
            made.set_collision_groups([isolation[0], isolation[0], group, isolation[1] | (entity.index + 1)])
        if isinstance(body, physx.PhysxRigidStaticComponent):
            return
        solid = with_stand_in(entity.spec.articulation, link)
        _set_mass(body, solid, subject, massless=entity.spec.fixed_base and offset == 0)
        body.disable_gravity = entity.spec.gravity_compensation
        body.linear_damping = body.angular_damping = 0.0
        body.max_linear_velocity = body.max_angular_velocity = _FAST
        body.max_depenetration_velocity = self.config.max_depenetration_velocity

    def _add(
        self, environment: NativeEnvironment, entity: EntityLayout, bodies: list[physx.PhysxRigidBaseComponent]
    ) -> NativeEntity:
        for body in bodies:
            _place(environment.scene, body, native_pose(entity.spec.pose), environment.offset)
        if not entity.spec.articulation.joints:
            return NativeEntity(tuple(bodies))
        articulation = bodies[0].articulation
        number = {f"{entity.joints.start + i}": i for i in range(len(entity.spec.articulation.movable_joints))}
        joints = {number[joint.name]: joint for joint in articulation.active_joints}
        order = tuple(number[joint.name] for joint in articulation.active_joints)
        made = NativeEntity(tuple(bodies), articulation, tuple(joints[i] for i in sorted(joints)), order)
        links = dict(zip(entity.spec.articulation.link_names, bodies, strict=True))
        for joint in entity.spec.articulation.movable_joints:
            if joint.mimic:
                stiffness = self.config.tendon_stiffness
                add_mimic_tendon(articulation, links, entity.spec.articulation, joint, stiffness)
        for loop in entity.spec.articulation.loops:
            _add_loop(links[loop.first], links[loop.second], loop)
        return made

    # Joints ----------------------------------------------------------------------------------------------------------

    def _set_joint(self, native: physx.PhysxArticulationJoint, joint: Joint, number: int | None) -> None:
        along_x = _x_to(joint.axis)
        native.pose_in_parent = native_pose(joint.parent_pose @ along_x)
        native.pose_in_child = native_pose(joint.child_pose @ along_x)
        if number is None:
            native.type = "fixed"
            return
        parameters = self.layout.joint_parameters
        native.name = str(number)
        native.type = "prismatic" if joint.type is JointType.PRISMATIC else "revolute_unwrapped"
        unlimited = joint.type is JointType.CONTINUOUS
        lower = -np.inf if unlimited else parameters.lower_limit[number]
        upper = np.inf if unlimited else parameters.upper_limit[number]
        native.set_limits(np.array([[lower, upper]], np.float32))
        native.set_armature(np.array([parameters.armature[number]], np.float32))
        native.set_friction(0.0)
        native.set_max_velocity(float(min(parameters.velocity_limit[number], _FAST)))

    def _report_joints(self, entity: EntityLayout) -> None:
        parameters, joints = self.layout.joint_parameters, self.layout.joints
        driven = parameters.drive_stiffness + parameters.drive_damping > 0
        self.report += stand_in_approximations(entity, "PhysX")
        for number in range(entity.joints.start, entity.joints.stop):
            subject = f"joint '{joints[number].name}' of '{entity.name}'"
            if joints[number].mimic:
                self.report += mimic_approximations(entity.spec.articulation, subject, joints[number])
            if driven[number] and joints[number].mimic:
                why = "it mimics another joint, whose drive moves both"
                self.report.append(Approximation(subject, "a drive of its own", "no drive", why))
            elif driven[number] and parameters.friction[number]:
                asked = f"Coulomb friction of {parameters.friction[number]:g}"
                why = "PhysX has one drive a joint, which the actuator takes"
                self.report.append(Approximation(subject, asked, "a damper that saturates at it", why))


def _set_mass(body: physx.PhysxRigidBaseComponent, link: Link, subject: str, massless: bool) -> None:
    """Principal moments in a centre-of-mass frame turned to the principal axes; a fixed root may have no mass."""
    if massless and link.mass <= 0:
        body.mass, body.inertia = 1.0, np.ones(3, np.float32)
        return
    moments, axes = np.linalg.eigh(np.asarray(link.inertia, np.float64))
    if link.mass <= 0 or moments.min() <= 0:
        if not massless:
            raise AssetError(f"{subject} needs a positive mass and inertia: PhysX moves nothing without")
        moments, axes = np.ones(3), np.eye(3)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    rotation = Pose.from_matrix(axes)
    body.mass = link.mass
    body.cmass_local_pose = native_pose(Pose(link.center_of_mass, rotation.orientation))
    body.inertia = moments.astype(np.float32)


def _place(
    scene: sapien.Scene, body: physx.PhysxRigidBaseComponent, pose: sapien.Pose, offset: npt.NDArray[np.float64]
) -> None:
    entity = sapien.Entity()
    entity.add_component(body)
    entity.set_pose(sapien.Pose(np.asarray(pose.p) + offset, pose.q))
    scene.add_entity(entity)


def _add_loop(
    first: physx.PhysxArticulationLinkComponent, second: physx.PhysxArticulationLinkComponent, loop: LoopJoint
) -> None:
    ball = physx.PhysxDriveComponent(second)
    ball.parent = first
    ball.pose_in_parent = native_pose(Pose(loop.first_point))
    ball.pose_in_child = native_pose(Pose(loop.second_point))
    for set_limit in (ball.set_limit_x, ball.set_limit_y, ball.set_limit_z):
        set_limit(0.0, 0.0)
    second.entity.add_component(ball)


def _is_level(shape: Shape) -> bool:
    return isinstance(shape.geometry, Plane) and bool(shape.pose.rotation_matrix()[2, 2] > 1 - 1e-9)


def _x_to(axis: tuple[float, float, float]) -> Pose:
    """The rotation that takes x to ``axis``."""
    turned = np.cross((1.0, 0.0, 0.0), axis)
    cosine = float(axis[0])
    if np.linalg.norm(turned) < 1e-9:
        return Pose() if cosine > 0 else Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    return Pose.from_axis_angle(tuple(turned), math.atan2(float(np.linalg.norm(turned)), cosine))
