"""Newton's Featherstone solver: reduced coordinates, symplectic Euler."""

# pyright: reportMissingImports=false
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
# pyright: reportGeneralTypeIssues=false
# Warp's types are made at run time.

from __future__ import annotations

import math

import numpy as np
import warp as wp
from newton import ModelFlags
from newton.solvers import SolverFeatherstone

from orbit_newton.config import FeatherstoneConfig
from orbit_newton.featherstone_kernels import (
    Bodies,
    ContactSettings,
    Found,
    JointSettings,
    Surfaces,
    add_contact_forces,
    count_contacts,
    write_joint_forces,
)
from orbit_newton.joints import drive_arrays, joint_table
from orbit_newton.mobility import Mobilities
from orbit_newton.plant import Dynamics, Plant
from orbit_newton.wrenches import WrenchReader


class FeatherstoneDynamics(Dynamics):
    """Forces of joints and contacts are computed here, linearly implicit and sized to the step; Newton integrates."""

    def __init__(self, plant: Plant) -> None:
        config: FeatherstoneConfig = plant.config
        self._plant = plant
        self.solver_steps = config.substeps
        self._h = plant.layout.scene.physics_dt / config.substeps
        model = plant.model
        for array in (model.joint_target_ke, model.joint_target_kd, model.joint_limit_ke, model.joint_limit_kd):
            array.zero_()
        self._solver = SolverFeatherstone(model)
        self._observables = self._solver.observables({"body_parent_f"}) if plant.layout.wrench_links else None
        self._wrenches = WrenchReader(plant) if plant.layout.wrench_links else None
        with wp.ScopedDevice(model.device):
            self._joints = joint_table(plant)
            self._surfaces = _surfaces(plant)
            self._contacts_of_body = wp.zeros(model.body_count, dtype=int)
        self._joint_settings = JointSettings()
        self._joint_settings.friction_speed = config.joint_friction_speed
        self._joint_settings.limit_stiffness = config.limit_stiffness
        self._joint_settings.limit_damping = config.limit_damping
        self._contact_settings = ContactSettings()
        self._contact_settings.stiffness = config.contact_stiffness
        self._contact_settings.damping_ratio = config.contact_damping
        self._contact_settings.friction_slope = config.friction_slope
        self._mobilities = Mobilities(plant)
        self._bodies, self._found = _bodies(plant, self._mobilities), _found(plant)
        self._commands = drive_arrays(plant)
        self._joint_efforts = wp.from_torch(plant.joint_efforts)

    def take(self) -> None:
        plant = self._plant
        plant.finder.find(plant.state)
        if plant.finder.any:
            self._mobilities.find()
        for _ in range(self.solver_steps):
            plant.write_body_forces()
            self._write_joint_forces()
            self._add_contact_forces()
            plant.meter.add()
            self._solver.step(plant.state, plant.state, plant.control, None, self._h, observables=self._observables)
        if self._wrenches is not None:
            self._wrenches.read(self._observables.body_parent_f)

    def masses_changed(self) -> None:
        self._solver.notify_model_changed(ModelFlags.BODY_INERTIAL_PROPERTIES)

    def _write_joint_forces(self) -> None:
        plant = self._plant
        if not plant.layout.joints:
            return
        wp.launch(
            write_joint_forces,
            dim=plant.joint_efforts.shape,
            inputs=[
                self._h, self._joint_settings, self._joints, *self._commands,
                plant.rows(plant.state.joint_q), plant.rows(plant.state.joint_qd),
            ],
            outputs=[
                plant.rows(plant.control.joint_f), self._joint_efforts,
                plant.rows(self._solver.joint_armature_effective),
            ],
        )  # fmt: skip

    def _add_contact_forces(self) -> None:
        plant = self._plant
        if not plant.finder.any:
            return
        self._contacts_of_body.zero_()
        state = [self._bodies, self._surfaces, self._found]
        wp.launch(count_contacts, dim=plant.finder.capacity, inputs=state, outputs=[self._contacts_of_body])
        wp.launch(
            add_contact_forces,
            dim=plant.finder.capacity,
            inputs=[self._h, self._contact_settings, *state, self._contacts_of_body],
            outputs=[plant.state.body_f, plant.finder.forces],
        )


def damping_ratio(restitution: float) -> float:
    """Damping ratio of a linear spring-damper that pushes only and rebounds so (Schwager and Poeschel, 2007)."""
    angles = np.linspace(0.0, 0.995 * math.pi / 2, 1000)
    rebounds = np.exp(-np.tan(angles) * (math.pi - 2 * angles))
    return float(np.interp(-restitution, -rebounds, np.sin(angles)))


def _surfaces(plant: Plant) -> Surfaces:
    model, materials = plant.model, plant.built.materials
    rebounds = [damping_ratio(material.restitution) if material.restitution else -1.0 for material in materials]
    springs = [material.compliance for material in materials]
    surfaces = Surfaces()
    surfaces.body = model.shape_body
    surfaces.friction = model.shape_material_mu
    surfaces.torsional = model.shape_material_mu_torsional
    surfaces.rolling = model.shape_material_mu_rolling
    surfaces.damping_ratio = wp.array(np.tile(rebounds, plant.num_envs), dtype=float)
    surfaces.stiffness = wp.array(np.tile([s.stiffness if s else 0.0 for s in springs], plant.num_envs), dtype=float)
    surfaces.damping = wp.array(np.tile([s.damping if s else 0.0 for s in springs], plant.num_envs), dtype=float)
    return surfaces


def _bodies(plant: Plant, mobilities: Mobilities) -> Bodies:
    model, bodies = plant.model, Bodies()
    bodies.q, bodies.qd, bodies.com = plant.state.body_q, plant.state.body_qd, model.body_com
    bodies.mobility, bodies.flags = mobilities.matrices, model.body_flags
    return bodies


def _found(plant: Plant) -> Found:
    contacts, found = plant.finder.contacts, Found()
    found.count = contacts.rigid_contact_count
    found.shape0, found.shape1 = contacts.rigid_contact_shape0, contacts.rigid_contact_shape1
    found.point0, found.point1 = contacts.rigid_contact_point0, contacts.rigid_contact_point1
    found.margin0, found.margin1 = contacts.rigid_contact_margin0, contacts.rigid_contact_margin1
    found.normal = contacts.rigid_contact_normal
    return found
