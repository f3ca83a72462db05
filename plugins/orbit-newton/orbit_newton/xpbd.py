"""Newton's XPBD solver: bodies move freely, and constraints correct their positions."""

# pyright: reportMissingImports=false
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
# pyright: reportGeneralTypeIssues=false
# Warp's types are made at run time.
# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp
from newton import ModelFlags
from newton.solvers import SolverXPBD

from orbit_core.scene import JointType
from orbit_newton.config import XpbdConfig
from orbit_newton.joints import JointTable, drive_arrays, joint_table
from orbit_newton.plant import Dynamics, Plant


@wp.struct
class Drives:
    """Newton's arrays of drives, with a row per environment."""

    target_q: wp.array2d[float]
    """rad or m."""
    target_qd: wp.array2d[float]
    """rad/s or m/s."""
    stiffness: wp.array2d[float]
    """N m/rad or N/m."""
    damping: wp.array2d[float]
    """N m s/rad or N s/m."""
    force: wp.array2d[float]
    """Commanded efforts, N m or N."""


@wp.kernel(enable_backward=False)
def write_drives(
    friction_speed: float,
    scales: wp.array[float],
    table: JointTable,
    stiffness: wp.array2d[float],
    damping: wp.array2d[float],
    position_targets: wp.array2d[float],
    velocity_targets: wp.array2d[float],
    efforts: wp.array2d[float],
    joint_q: wp.array2d[float],
    joint_qd: wp.array2d[float],
    drives: Drives,
    joint_efforts: wp.array2d[float],
):
    """A drive that asks for more than its limit is replaced by the limit; friction acts as a damper with its force.

    ``scales`` compensate for sweeps, each of which applies the drive again.
    """
    env, joint = wp.tid()
    dof = table.velocities[joint]
    q, v = joint_q[env, table.positions[joint]], joint_qd[env, dof]
    target = position_targets[env, joint] - table.zeros[joint]
    asked = stiffness[env, joint] * (target - q)
    asked += damping[env, joint] * (velocity_targets[env, joint] - v) + efforts[env, joint]
    limit = table.effort_limit[joint]
    force = wp.clamp(asked, -limit, limit)
    joint_efforts[env, joint] = force
    beyond = wp.abs(asked) > limit  # false of what is not finite, so that this is found
    within = wp.where(beyond, 0.0, 1.0)
    ke, kd = within * stiffness[env, joint], within * damping[env, joint]
    drag = table.damping[joint] + table.friction[joint] / wp.max(wp.abs(v), friction_speed)
    drives.target_q[env, table.targets[joint]] = target
    # Where there is damping, an effort is a velocity to be damped towards: so it acts in the sweeps, not before them.
    effort = wp.where(beyond, force, efforts[env, joint])
    damped = wp.where(kd + drag > 0.0, 1.0, 0.0)
    speed = velocity_targets[env, joint] * kd + damped * effort
    drives.target_qd[env, dof] = speed / wp.max(kd + drag, 1.0e-12)
    drives.stiffness[env, dof] = ke * scales[joint]
    drives.damping[env, dof] = (kd + drag) * scales[joint]
    drives.force[env, dof] = (1.0 - damped) * effort


@wp.struct
class Coefficients:
    """Newton's arrays of surfaces, with room for one of each contact behind those of the shapes."""

    body: wp.array[int]
    """Body that carries the surface; -1 for the world."""
    friction: wp.array[float]
    """Coefficient of sliding friction."""
    torsional: wp.array[float]
    """m, coefficient of torsional friction."""
    rolling: wp.array[float]
    """m, coefficient of rolling friction."""
    restitution: wp.array[float]
    """Coefficient of restitution."""


@wp.func
def _to_larger(one: float, other: float) -> float:
    """The value that averages with ``other`` to the larger of the two."""
    return 2.0 * wp.max(one, other) - other


@wp.kernel(enable_backward=False)
def give_own_surfaces(
    count: wp.array[int],
    shapes: int,
    coefficients: Coefficients,
    shape0: wp.array[int],
    shape1: wp.array[int],
):
    """Newton averages the coefficients of a pair; the contract takes the larger."""
    i = wp.tid()
    if i >= count[0]:
        return
    a, b, own = shape0[i], shape1[i], shapes + i
    coefficients.body[own] = coefficients.body[a]
    coefficients.friction[own] = _to_larger(coefficients.friction[a], coefficients.friction[b])
    coefficients.torsional[own] = _to_larger(coefficients.torsional[a], coefficients.torsional[b])
    coefficients.rolling[own] = _to_larger(coefficients.rolling[a], coefficients.rolling[b])
    coefficients.restitution[own] = _to_larger(coefficients.restitution[a], coefficients.restitution[b])
    shape0[i] = own


@wp.kernel(enable_backward=False)
def take_forces(count: wp.array[int], contact_f: wp.array[wp.spatial_vector], forces: wp.array[wp.vec3]):
    """Force of each contact on its first shape."""
    i = wp.tid()
    if i < count[0]:
        forces[i] = wp.spatial_top(contact_f[i])


class XpbdDynamics(Dynamics):
    """Drives and contacts are Newton's own."""

    maximal = True

    def __init__(self, plant: Plant) -> None:
        config: XpbdConfig = plant.config
        self._plant = plant
        self.solver_steps = config.substeps
        self._h = plant.layout.scene.physics_dt / config.substeps
        self._shapes = plant.model.shape_count
        with wp.ScopedDevice(plant.model.device):
            self._coefficients = _coefficients(plant)
            self._joints = joint_table(plant)
            self._scales = wp.array(_scales(plant, config), dtype=float)
        self._solver = SolverXPBD(
            plant.model,
            iterations=config.iterations,
            joint_linear_relaxation=config.joint_linear_relaxation,
            joint_angular_relaxation=config.joint_angular_relaxation,
            rigid_contact_relaxation=config.contact_relaxation,
            rigid_contact_con_weighting=config.contact_weighting,
            # Newton's restitution costs a pass over all contacts, so that it is on only where a material rebounds.
            enable_restitution=any(material.restitution for material in plant.built.materials),
        )
        self._drives = _drives(plant)
        self._commands = drive_arrays(plant)
        self._joint_efforts = wp.from_torch(plant.joint_efforts)
        measured = self._solver.observables({"contact_f"}, contacts=plant.finder.contacts)
        self._observables = measured if plant.meter.needed else None

    def take(self) -> None:
        plant = self._plant
        plant.finder.find(plant.state)
        contacts = plant.finder.contacts
        if plant.finder.any:
            wp.launch(
                give_own_surfaces,
                dim=plant.finder.capacity,
                inputs=[contacts.rigid_contact_count, self._shapes, self._coefficients],
                outputs=[contacts.rigid_contact_shape0, contacts.rigid_contact_shape1],
            )
        self._write_drives()
        for _ in range(self.solver_steps):
            plant.write_body_forces()
            self._solver.step(plant.state, plant.state, plant.control, contacts, self._h, observables=self._observables)
            self._measure()

    def masses_changed(self) -> None:
        self._solver.notify_model_changed(ModelFlags.BODY_INERTIAL_PROPERTIES)

    def _write_drives(self) -> None:
        plant = self._plant
        if plant.layout.joints:
            wp.launch(
                write_drives,
                dim=plant.joint_efforts.shape,
                inputs=[
                    plant.config.joint_friction_speed, self._scales, self._joints, *self._commands,
                    plant.rows(plant.state.joint_q), plant.rows(plant.state.joint_qd),
                ],
                outputs=[self._drives, self._joint_efforts],
            )  # fmt: skip

    def _measure(self) -> None:
        plant = self._plant
        if plant.meter.needed:
            wp.launch(
                take_forces,
                dim=plant.finder.capacity,
                inputs=[plant.finder.contacts.rigid_contact_count, self._observables.contact_f],
                outputs=[plant.finder.forces],
            )
            plant.meter.add()


def _scales(plant: Plant, config: XpbdConfig) -> list[float]:
    # Newton corrects distances and angles with different relaxations.
    relaxations = {JointType.PRISMATIC: config.joint_linear_relaxation}
    return [
        # A drive is applied once in each sweep, by the relaxation's share: together the sweeps apply it once.
        1.0 / (config.iterations * relaxations.get(joint.type, config.joint_angular_relaxation))
        for joint in plant.layout.joints
    ]


def _drives(plant: Plant) -> Drives:
    model, control, drives = plant.model, plant.control, Drives()
    drives.target_q, drives.target_qd = plant.rows(control.joint_target_q), plant.rows(control.joint_target_qd)
    drives.stiffness, drives.damping = plant.rows(model.joint_target_ke), plant.rows(model.joint_target_kd)
    drives.force = plant.rows(control.joint_f)
    return drives


def _coefficients(plant: Plant) -> Coefficients:
    """Make room for a surface of each contact's own in the model's arrays."""
    model, room = plant.model, plant.finder.capacity
    names = {
        "body": "shape_body",
        "friction": "shape_material_mu",
        "torsional": "shape_material_mu_torsional",
        "rolling": "shape_material_mu_rolling",
        "restitution": "shape_material_restitution",
    }
    coefficients = Coefficients()
    for name, attribute in names.items():
        own = getattr(model, attribute)
        # A kernel points each contact's first shape at its row behind the shapes, which costs Newton's solver nothing.
        longer = wp.zeros(own.shape[0] + room, dtype=own.dtype)
        wp.copy(longer, own, count=own.shape[0])
        setattr(model, attribute, longer)
        setattr(coefficients, name, longer)
    return coefficients
