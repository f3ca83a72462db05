"""One environment's scene as a MuJoCo model: bodies, joints, drives, collision shapes and sensors.

Every link is a body. A fixed base is a mocap body, so that each environment may place it; a free root has a free joint.
Every movable joint has an actuator with the same index: ``force = ctrl - stiffness q - damping qd``, limited to the
effort limit, with ``ctrl = stiffness target + damping velocity target + effort``.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import mujoco
import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import Approximation, AssetError, EntityLayout, SceneLayout
from orbit_core.plugin_kit.bodies import inertia_approximations, is_massless
from orbit_core.scene import Joint, JointType, Link, LoopJoint, LoopType, PhysicsMaterial, Pose, Shape
from orbit_core.scene.articulation import solid_moments
from orbit_mjmodel.addresses import Addresses, body_name, joint_name
from orbit_mjmodel.config import ModelConfig
from orbit_mjmodel.drives import (
    ASKED_DAMPING,
    DAMPING,
    STIFFNESS,
    hold_drives,
    hold_springs,
    report_swings,
    throwing_wheels,
)
from orbit_mjmodel.geometry import GeomBuilder, Part, geometry_approximations
from orbit_mjmodel.materials import ContactParameters, contact_parameters, material_approximations
from orbit_mjmodel.matter import (
    MatterAddresses,
    add_matter,
    finish_solids,
    firm_contacts,
    matter_addresses,
    set_matter_home,
    slow_spins,
    solid_grids,
    spare_holders,
)
from orbit_mjmodel.wrenches import add_wrench_sensors

# Stiffness of the spring that lifts what has sunk in, as a share of ``1 / dt^2``. An impact sinks in by up to one
# step's way, so that the spring adds up to this to the restitution; half of it is taken off in advance.
_LIFT = 0.005
# Share of the speed of slip that friction may remove in a step, up to Coulomb's limit. The larger it is, the more of an
# impact's slip is stopped, and the higher hops what slides on: MuJoCo's convex cone adds ``mu`` times the share that
# friction could not remove to the speed along the normal.
_GRIP = 0.9
# Integrators that turn the acceleration at the beginning of a step into the speed at its end.
_ONE_STEP = ("implicitfast", "implicit", "euler")
# Less, and a box on four contacts rebounds too fast; more, and single precision loses momentum.
_IMPEDANCE = (0.997, 0.997, 0.001, 0.5, 2.0)


@dataclass(frozen=True, eq=False)
class Collider:
    """A geom of a shape that is the same in all kinds of environments."""

    geom: mujoco.MjsGeom
    """Geom of the specification."""
    body: str
    """Name of its body."""
    movable: bool
    """True if the body can move."""
    material: PhysicsMaterial
    """Material of the shape."""


def rebounds_in_one_step(integrator: str, cone: str) -> bool:
    """Return True if a reference of ``-(1 + e) v / dt`` gives the rebound, and friction may have a separate one."""
    return integrator in _ONE_STEP and cone == "elliptic"


def add_rebound_pairs(
    spec: mujoco.MjSpec, colliders: Sequence[Collider], excluded: Collection[frozenset[str]], dt: float
) -> None:
    """Write out the pairs of ``colliders`` that may touch and of which one rebounds.

    Args:
        spec: to which the pairs are added.
        colliders: all geoms whose pairs may be written out; they are given names.
        excluded: pairs of names of bodies that pass through each other.
        dt: the physics step, in seconds.
    """
    for number, collider in enumerate(colliders):
        collider.geom.name = f"collider{number}"
    for one, other in combinations(colliders, 2):
        restitution = max(one.material.restitution, other.material.restitution)
        if restitution == 0.0 or one.material.compliance or other.material.compliance:
            continue
        apart = one.body == other.body or frozenset((one.body, other.body)) in excluded
        if apart or not (one.movable or other.movable):
            continue
        sliding, torsional, rolling = np.maximum(one.geom.friction, other.geom.friction)
        spec.add_pair(
            geomname1=one.geom.name,
            geomname2=other.geom.name,
            condim=max(one.geom.condim, other.geom.condim),
            friction=(sliding, sliding, torsional, rolling, rolling),
            solref=(-_LIFT / dt**2, -(1.0 + restitution - 0.5 * _LIFT) / dt),
            solreffriction=(0.0, -_GRIP / dt),
            solimp=_IMPEDANCE,
        )


GRAIN = 1e-5
"""Metres."""
ABSENT = "absent"
"""Begins the names of geoms that only other kinds of environments have."""


@dataclass(frozen=True)
class Slot:
    """The place of one geom in one kind of environment."""

    part: Part
    """Geometry and place of the geom."""
    contact: ContactParameters
    """Contact parameters of the geom."""
    absent: bool = False
    """True where this kind has no such shape."""


def slots(own: Sequence[Slot], kinds: Iterable[Sequence[Slot]]) -> Iterator[Slot]:
    """A body's geoms: its ``own``, and grains for what other ``kinds`` have, in an order that is all kinds'."""
    kinds = list(kinds)
    middle = own[0].part[3] if own else Pose()
    for kind in sorted({int(slot.part[0]) for slots_of in kinds for slot in slots_of}):
        each = [[slot for slot in slots_of if slot.part[0] == kind] for slots_of in kinds]
        most = max(each, key=len)
        mine = [slot for slot in own if slot.part[0] == kind]
        yield from mine
        for slot in most[len(mine) :]:
            _, _, asset, _ = slot.part
            size = (0.0, 0.0, 0.0) if asset else (GRAIN, GRAIN, GRAIN)
            yield Slot((mujoco.mjtGeom(kind), size, asset, middle), slot.contact, absent=True)


AddSensors = Callable[[mujoco.MjSpec, SceneLayout], None]
# The value in the place of infinity where only one side of a joint is limited.
_UNLIMITED = 1e10
# kg, and kg m^2, of a body without mass while its model is compiled.
_COMPILED_MASS = 1e-3
# Impedance of mimic joints, of loops and of joint limits. With MuJoCo's own, 0.95, a joint that 100 N m push against
# its limit is 19 mrad beyond it, and with this less than one.
_STIFF_COUPLING = (0.99, 0.999, 0.001, 0.5, 2.0)
# Among a weld's data, the weight of its angles relative to its distances.
_TORQUE_SCALE = 10
# Radians or metres on either side of a joint whose limits are one position, as MuJoCo takes no range without width.
_NO_WIDTH = 5e-7
# N or N m of a drive whose effort limit is zero, as MuJoCo takes no range without width here either.
_NO_FORCE = 1e-9
# Where a scene asks for firm friction: what it holds creeps sixteen times slower.
_FIRM_IMPRATIO = 10.0
# Impedance of joint friction. With MuJoCo's own, 0.9, a joint that friction holds creeps two hundred times faster.
_HARD_FRICTION = (0.999, 0.9999, 0.001, 0.5, 2.0)


@dataclass(frozen=True, eq=False)
class BuiltModel:
    """A compiled model, where the layout's things stand in it, and what it does not honour."""

    model: mujoco.MjModel
    """Compiled model of one environment."""
    addresses: Addresses
    """Numbers of links, joints and sensors in it."""
    report: tuple[Approximation, ...]
    """Differences from the scene."""
    absent: npt.NDArray[np.int64]
    """Geoms that only other kinds of environments have; here grains."""
    matter: tuple[MatterAddresses, ...]
    """Of the scene's cloths and ropes."""


def build_models(
    layout: SceneLayout,
    config: ModelConfig,
    *,
    solver: str,
    disabled: int = 0,
    least_friction: float = 0.0,
    add_sensors: AddSensors | None = None,
) -> tuple[BuiltModel, ...]:
    """Compile one environment of each of the layout's variants: models that are alike but for numbers.

    Args:
        layout: of the scene.
        config: settings.
        solver: of the constraints, by MuJoCo's name.
        disabled: bits of ``mjtDisableBit``: what of MuJoCo the engine is not to do.
        least_friction: the least coefficient of friction that the engine bears.
        add_sensors: adds the engine's sensors, before those of joint wrenches.

    Raises:
        AssetError: MuJoCo refuses the description; says why.
    """
    models: list[BuiltModel] = []
    for kind in layout.variants:
        builder = _Builder(kind, layout.variants, config, least_friction)
        builder.set_options(solver, disabled)
        if add_sensors:
            add_sensors(builder.spec, kind)
        add_wrench_sensors(builder.spec, kind)
        models.append(_compiled(builder))
    return tuple(models)


def _compiled(builder: _Builder) -> BuiltModel:
    try:
        with warnings.catch_warnings():
            # MuJoCo looks for passive forces of edges and forgets those of a grid.
            warnings.filterwarnings("ignore", message=".*has no equality constraints or passive forces")
            model = builder.spec.compile()
    except ValueError as error:
        raise AssetError(f"MuJoCo refuses the scene: {str(error).replace(chr(10), ' ').strip()}") from error
    if builder.massless:
        _take_mass_away(model, [model.body(name).id for name in builder.massless])
    addresses = Addresses.of(builder.layout, model)
    matter = matter_addresses(model, builder.layout, builder.grids)
    _set_home(builder.layout, model, addresses)
    set_matter_home(model, matter)
    finish_solids(model, matter)
    spare_holders(model, builder.layout, matter)
    slow_spins(model, matter)
    firm_contacts(model.body_invweight0, model.dof_invweight0, matter)
    report = (*builder.report, *hold_drives(model, addresses, builder.layout))
    report = (*report, *hold_springs(model, addresses, builder.layout))
    report = (*report, *report_swings(model, addresses, builder.layout))
    absent = [geom for geom in range(model.ngeom) if model.geom(geom).name.startswith(ABSENT)]
    model.geom_rgba[absent, 3] = 0.0  # which rays take for not there
    return BuiltModel(model, addresses, report, np.array(absent, dtype=np.int64), matter)


def _take_mass_away(model: mujoco.MjModel, bodies: list[int]) -> None:
    """Give bodies the mass and inertia of none, and compute again what follows from them.

    MuJoCo's compiler wants some of every body that moves. Its dynamics do not: a body without takes the part that one
    of several joints on the same body does.
    """
    model.body_mass[bodies], model.body_inertia[bodies] = 0.0, 0.0
    mujoco.mj_setConst(model, mujoco.MjData(model))


class _Builder:
    """Builds the model of ``layout``, one of the ``kinds`` of environments."""

    def __init__(
        self, layout: SceneLayout, kinds: Sequence[SceneLayout], config: ModelConfig, least_friction: float
    ) -> None:
        self.layout = layout
        self.kinds = kinds
        self.config = config
        self.spec = mujoco.MjSpec()
        self.report: list[Approximation] = []
        self.massless: list[str] = []
        """Names of bodies without mass that joints move."""
        self._least_friction = least_friction
        if config.cone == "pyramidal":
            why = "the setting 'cone' asks for a pyramid: friction is up to 30 % weaker between a contact's axes"
            self.report.append(Approximation("contacts", "the same friction in every direction", "a pyramid", why))
        self._integrator, why = self._chosen_integrator()
        if self._integrator != config.integrator:
            self.report.append(Approximation("the integrator", config.integrator, self._integrator, why))
        self._geoms = GeomBuilder(self.spec)
        self._colliders: list[Collider] = []
        self._one_step = rebounds_in_one_step(self._integrator, config.cone)
        for shape in layout.scene.terrain:
            self._add_shape(self.spec.worldbody, shape, 1.0, False, f"terrain shape '{shape.name}'")
        for entity in layout.entities:
            self._add_entity(entity)
        for index in range(len(layout.joints)):
            self._add_drive(index)
        if self._one_step and any(collider.material.restitution for collider in self._colliders):
            excluded = {frozenset((pair.bodyname1, pair.bodyname2)) for pair in self.spec.excludes}
            add_rebound_pairs(self.spec, self._colliders, excluded, layout.scene.physics_dt)
        self.grids = solid_grids(layout)
        self.report += add_matter(self.spec, layout, self.grids)
        self.spec.add_key(name="home")

    def set_options(self, solver: str, disabled: int) -> None:
        """Set MuJoCo's options for stepping the model."""
        spec, config = self.spec, self.config
        spec.compiler.degree = False
        spec.compiler.fusestatic = False
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        option = spec.option
        option.timestep = self.layout.scene.physics_dt
        option.gravity = self.layout.scene.gravity
        option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{self._integrator.upper()}")
        option.solver = getattr(mujoco.mjtSolver, f"mjSOL_{solver.upper()}")
        option.cone = getattr(mujoco.mjtCone, f"mjCONE_{config.cone.upper()}")
        option.iterations = config.iterations
        option.ls_iterations = config.ls_iterations
        own = _FIRM_IMPRATIO if self.layout.scene.firm_friction else 1.0
        option.impratio = own if config.impratio is None else config.impratio
        # Which links may touch is written out pair by pair.
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT) | disabled

    def _chosen_integrator(self) -> tuple[str, str]:
        """Return the integrator and, where it is not the requested one, why not.

        It is ``discrete`` where contacts must be solved together with cloth's elasticity or with a drive.
        """
        asked, together = self.config.integrator, "discrete"
        if asked != together and self.layout.scene.deformables:
            return together, (
                "MuJoCo integrates cloth in no other way, and rope that rests on something jitters and creeps in others"
            )
        if asked != together and (thrown := throwing_wheels(self.layout)):
            return together, (
                f"contacts are solved without the damping of the velocity drive of {thrown[0]}, which has no effort "
                "limit: it would strike the ground with all of it and throw its base; give the drive an effort limit "
                "to keep the integrator"
            )
        return asked, ""

    # Bodies ----------------------------------------------------------------------------------------------------------

    def _add_entity(self, entity: EntityLayout) -> None:
        articulation = entity.spec.articulation
        incoming = {joint.child: joint for joint in articulation.joints}
        bodies: dict[str, mujoco.MjsBody] = {}
        joints = iter(range(entity.joints.start, entity.joints.stop))
        for offset, link in enumerate(articulation.links):
            number = entity.links.start + offset
            joint = incoming.get(link.name)
            if joint is None:
                bodies[link.name] = self._add_root(entity, number)
            else:
                bodies[link.name] = self._add_child(bodies[joint.parent], joint, number)
                if joint.movable:
                    self._add_joint(bodies[link.name], entity, joint, next(joints))
            self._fill_body(bodies[link.name], entity, link, [kind.links[number] for kind in self.kinds])
        for loop in articulation.loops:
            self._add_loop(f"{entity.index}_{loop.name}", loop, bodies)
        self._exclude_pairs(entity)
        self._report_joints(entity)
        self.report += inertia_approximations(entity, "MuJoCo")

    def _add_root(self, entity: EntityLayout, number: int) -> mujoco.MjsBody:
        pose = entity.spec.pose
        body = self.spec.worldbody.add_body(name=body_name(number), pos=pose.position, quat=pose.orientation)
        if entity.spec.fixed_base:
            body.mocap = True
        else:
            body.add_freejoint()
        return body

    @staticmethod
    def _add_child(parent: mujoco.MjsBody, joint: Joint, number: int) -> mujoco.MjsBody:
        pose = joint.parent_pose @ joint.child_pose.inverse()
        return parent.add_body(name=body_name(number), pos=pose.position, quat=pose.orientation)

    def _fill_body(self, body: mujoco.MjsBody, entity: EntityLayout, link: Link, kinds: Sequence[Link]) -> None:
        subject = f"link '{link.name}' of '{entity.name}'"
        body.gravcomp = float(entity.spec.gravity_compensation)
        body.simple = False  # a body compiled as simple cannot have its centre of mass moved
        if link.mass > 0:
            # MuJoCo takes principal moments as they are, but finds those of a tensor only to 1e-12 kg m^2.
            moments, axes = solid_moments(link.inertia)
            body.explicitinertial = True
            body.mass, body.ipos = link.mass, link.center_of_mass
            body.inertia, body.iquat = moments, axes.orientation
        elif is_massless(entity.spec.articulation, link):
            body.explicitinertial = True
            body.mass, body.inertia = _COMPILED_MASS, [_COMPILED_MASS] * 3
            self.massless.append(body.name)
        rolls = len(entity.spec.articulation.links) == 1 and not entity.spec.fixed_base
        if all(kind is link for kind in kinds):
            for shape in link.collisions:
                self._add_shape(body, shape, link.mass or 1.0, rolls, subject)
        else:
            self._add_slots(body, link, kinds, rolls, subject)

    def _add_shape(self, body: mujoco.MjsBody, shape: Shape, mass: float, rolls: bool, subject: str) -> None:
        movable = not (body.mocap or body == self.spec.worldbody)
        for slot in self._slots(body, shape, mass, rolls, subject):
            geom = self._geoms.add(body, slot.part, slot.contact)
            self._colliders.append(Collider(geom, body.name, movable, shape.material))
        self.report += geometry_approximations(shape, subject)
        self.report += material_approximations(shape, subject, self._one_step)

    def _slots(self, body: mujoco.MjsBody, shape: Shape, mass: float, rolls: bool, subject: str) -> list[Slot]:
        dt = self.layout.scene.physics_dt
        contact = contact_parameters(shape, mass, rolls, dt, self.config, self._least_friction)
        return [Slot(part, contact) for part in self._geoms.parts(body, shape, subject)]

    def _add_slots(self, body: mujoco.MjsBody, link: Link, kinds: Sequence[Link], rolls: bool, subject: str) -> None:
        """Add a link that is another one in other kinds of environments."""
        # Those of every kind are made in every model, so that all have the same meshes under the same names.
        of_kind = [
            [slot for shape in kind.collisions for slot in self._slots(body, shape, kind.mass or 1.0, rolls, subject)]
            for kind in kinds
        ]
        for slot in slots(of_kind[kinds.index(link)], of_kind):
            name = f"{ABSENT}{len(self.spec.geoms)}" if slot.absent else ""
            self._geoms.add(body, slot.part, slot.contact, name)
        for shape in link.collisions:
            self.report += geometry_approximations(shape, subject) + material_approximations(shape, subject, False)

    def _exclude_pairs(self, entity: EntityLayout) -> None:
        articulation = entity.spec.articulation
        colliding = [link.name for link in articulation.links if link.collisions]
        if articulation.self_collisions:
            connected = {frozenset(pair) for pair in articulation.joined_links}
            apart = connected | {frozenset(pair) for pair in articulation.collision_exclusions}
            pairs = [pair for pair in combinations(colliding, 2) if frozenset(pair) in apart]
        else:
            pairs = list(combinations(colliding, 2))
        number = {name: entity.links.start + index for index, name in enumerate(articulation.link_names)}
        for first, second in pairs:
            self.spec.add_exclude(bodyname1=body_name(number[first]), bodyname2=body_name(number[second]))

    # Joints ----------------------------------------------------------------------------------------------------------

    def _add_joint(self, body: mujoco.MjsBody, entity: EntityLayout, joint: Joint, number: int) -> None:
        parameters = self.layout.joint_parameters
        lower, upper = float(parameters.lower_limit[number]), float(parameters.upper_limit[number])
        prismatic = joint.type is JointType.PRISMATIC
        if lower == upper:
            subject = f"joint '{joint.name}' of '{entity.name}'"
            why = "MuJoCo takes no range without width: make the joint a fixed one"
            asked, got = f"both limits at {lower:g}", f"limits {_NO_WIDTH:g} on either side"
            self.report.append(Approximation(subject, asked, got, why))
            lower, upper = lower - _NO_WIDTH, upper + _NO_WIDTH
        limited = joint.type is not JointType.CONTINUOUS and bool(np.isfinite(lower) or np.isfinite(upper))
        body.add_joint(
            name=joint_name(number),
            type=mujoco.mjtJoint.mjJNT_SLIDE if prismatic else mujoco.mjtJoint.mjJNT_HINGE,
            pos=joint.child_pose.position,
            axis=joint.child_pose.rotation_matrix() @ joint.axis,
            limited=limited,
            range=(max(lower, -_UNLIMITED), min(upper, _UNLIMITED)) if limited else (0.0, 0.0),
            solref_limit=self.config.limit_solref,
            solimp_limit=_STIFF_COUPLING,
            damping=[float(parameters.damping[number]), 0.0, 0.0],
            frictionloss=float(parameters.friction[number]),
            solref_friction=self._stiffest,
            solimp_friction=_HARD_FRICTION,
            armature=float(parameters.armature[number]),
            stiffness=[float(parameters.spring_stiffness[number]), 0.0, 0.0],
            springref=float(parameters.spring_rest[number]),
        )
        if joint.mimic:
            names = entity.spec.articulation.joint_names
            self._add_mimic(number, entity.joints.start + names.index(joint.mimic.joint), joint)

    def _report_joints(self, entity: EntityLayout) -> None:
        parameters, joints = self.layout.joint_parameters, self.layout.joints
        numbers = range(entity.joints.start, entity.joints.stop)
        fast = [joints[number].name for number in numbers if np.isfinite(parameters.velocity_limit[number])]
        if fast:
            why = "MuJoCo does not limit the velocity of a joint"
            asked = f"velocity limits of joints {', '.join(fast)}"
            self.report.append(Approximation(f"'{entity.name}'", asked, "no limits", why))
        stiff = parameters.drive_stiffness + parameters.drive_damping > 0
        for number in numbers:
            if stiff[number] and joints[number].mimic:
                subject = f"joint '{joints[number].name}' of '{entity.name}'"
                why = "it mimics another joint, whose drive moves both"
                self.report.append(Approximation(subject, "a drive of its own", "no drive", why))

    def _add_mimic(self, number: int, driver: int, joint: Joint) -> None:
        assert joint.mimic is not None
        data = np.zeros(mujoco.mjNEQDATA)
        data[: len(joint.mimic.coefficients)] = joint.mimic.coefficients
        self.spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            name1=joint_name(number),
            name2=joint_name(driver),
            data=data,
            solref=self._stiffest,
            solimp=_STIFF_COUPLING,
        )

    def _add_loop(self, name: str, loop: LoopJoint, bodies: dict[str, mujoco.MjsBody]) -> None:
        weld = loop.type is LoopType.WELD
        sites = [f"{name}_first", f"{name}_second"]
        bodies[loop.first].add_site(name=sites[0], pos=loop.first_point, quat=loop.orientation)
        bodies[loop.second].add_site(name=sites[1], pos=loop.second_point)
        data = np.zeros(mujoco.mjNEQDATA)
        data[_TORQUE_SCALE] = 1.0
        self.spec.add_equality(
            type=mujoco.mjtEq.mjEQ_WELD if weld else mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=sites[0],
            name2=sites[1],
            data=data,
            solref=self._stiffest,
            solimp=_STIFF_COUPLING,
        )

    @property
    def _stiffest(self) -> tuple[float, float]:
        """Time constant and damping ratio of the stiffest constraint that MuJoCo integrates safely."""
        return 2 * self.layout.scene.physics_dt, 1.0

    def _add_drive(self, number: int) -> None:
        parameters = self.layout.joint_parameters
        actuator = self.spec.add_actuator(
            name=joint_name(number),
            target=joint_name(number),
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        )
        if self.layout.joints[number].mimic is None:
            stiffness, damping = parameters.drive_stiffness[number], parameters.drive_damping[number]
            actuator.gainprm[0] = 1.0
            actuator.biasprm[[STIFFNESS, DAMPING, ASKED_DAMPING]] = -stiffness, -damping, -damping
        else:  # it follows another joint, which carries the drive
            actuator.gainprm[0] = 0.0
        limit = float(parameters.effort_limit[number])
        actuator.forcelimited = bool(np.isfinite(limit))
        if np.isfinite(limit):
            limit = max(limit, _NO_FORCE)
            actuator.forcerange = (-limit, limit)


def _set_home(layout: SceneLayout, model: mujoco.MjModel, addresses: Addresses) -> None:
    """Make the model's one keyframe the scene's initial state."""
    model.key_qpos[0] = model.qpos0
    model.key_qpos[0][addresses.joint_positions] = layout.joint_parameters.home
    model.key_mpos[0] = model.body_pos[model.body_mocapid >= 0].ravel()
    model.key_mquat[0] = model.body_quat[model.body_mocapid >= 0].ravel()
