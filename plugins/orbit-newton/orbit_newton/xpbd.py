"""Newton's XPBD solver: bodies move freely, and constraints correct their positions."""

# pyright: reportMissingImports=false
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
# pyright: reportGeneralTypeIssues=false
# Warp's types are made at run time.

from __future__ import annotations

import warp as wp
from newton import ModelFlags
from newton.solvers import SolverXPBD

from orbit_core.scene import JointType
from orbit_newton.config import XpbdConfig
from orbit_newton.joints import drive_arrays, joint_table
from orbit_newton.plant import Dynamics, Plant
from orbit_newton.xpbd_kernels import Coefficients, Drives, give_own_surfaces, take_forces, write_drives


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
    relaxations = {JointType.PRISMATIC: config.joint_linear_relaxation}
    return [
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
        longer = wp.zeros(own.shape[0] + room, dtype=own.dtype)
        wp.copy(longer, own, count=own.shape[0])
        setattr(model, attribute, longer)
        setattr(coefficients, name, longer)
    return coefficients
