"""Newton's Featherstone solver: reduced coordinates, symplectic Euler."""

# pyright: reportMissingImports=false
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
# pyright: reportGeneralTypeIssues=false
# Warp's types are made at run time.
# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.
# pyright: reportGeneralTypeIssues=false, reportAssignmentType=false, reportAttributeAccessIssue=false

from __future__ import annotations

import math

import newton
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
from orbit_newton.plant import Dynamics, Plant


@wp.kernel(enable_backward=False)
def _factorize(dofs: wp.array[int], matrix: wp.array3d[float]):
    """Cholesky's lower factor, in place of the matrix."""
    a = wp.tid()
    for i in range(dofs[a]):
        for j in range(i + 1):
            value = matrix[a, i, j]
            for k in range(j):
                value -= matrix[a, i, k] * matrix[a, j, k]
            if i == j:
                matrix[a, i, i] = wp.sqrt(value)
            else:
                matrix[a, i, j] = value / matrix[a, j, j]


@wp.kernel(enable_backward=False)
def _find_mobilities(
    articulation_of_body: wp.array[int],
    first_body: wp.array[int],
    dofs: wp.array[int],
    factor: wp.array3d[float],
    jacobian: wp.array3d[float],
    solved: wp.array3d[float],
    mobility: wp.array[wp.spatial_matrix],
):
    """``Y^T Y`` with ``L Y = J^T``."""
    body = wp.tid()
    a = articulation_of_body[body]
    row = 6 * (body - first_body[a])
    for k in range(6):
        for i in range(dofs[a]):
            value = jacobian[a, row + k, i]
            for j in range(i):
                value -= factor[a, i, j] * solved[body, k, j]
            solved[body, k, i] = value / factor[a, i, i]
    matrix = wp.spatial_matrix()
    for k in range(6):
        for m in range(6):
            value = wp.float32(0.0)
            for i in range(dofs[a]):
                value += solved[body, k, i] * solved[body, m, i]
            matrix[k, m] = value
    mobility[body] = matrix


class Mobilities:
    """Mobilities of all bodies in world axes at their centres of mass, without drives: no body is held too heavy."""

    def __init__(self, plant: Plant) -> None:
        model, self._plant = plant.model, plant
        starts, velocities = model.articulation_start.numpy(), model.joint_qd_start.numpy()
        count, most = model.articulation_count, model.max_dofs_per_articulation
        with wp.ScopedDevice(model.device):
            # Joint and body of a link have the same number.
            self._articulation_of_body = wp.array(np.repeat(np.arange(count), np.diff(starts)), dtype=int)
            self._first_body = wp.array(starts[:-1], dtype=int)
            self._dofs = wp.array(np.diff(velocities[starts]), dtype=int)
            self._jacobian = wp.zeros((count, 6 * model.max_joints_per_articulation, most), dtype=float)
            self._matrix = wp.zeros((count, most, most), dtype=float)
            self._solved = wp.zeros((model.body_count, 6, most), dtype=float)
            self._inertias = wp.zeros(model.body_count, dtype=wp.spatial_matrix)
            self._subspaces = wp.zeros(model.joint_dof_count, dtype=wp.spatial_vector)
            self.matrices = wp.zeros(model.body_count, dtype=wp.spatial_matrix)
            """(bodies,) inverse spatial inertias."""

    def find(self) -> None:
        """Launch what finds them in the plant's state."""
        model, state = self._plant.model, self._plant.state
        newton.eval_jacobian(model, state, self._jacobian, self._subspaces)
        newton.eval_mass_matrix(model, state, self._matrix, self._jacobian, self._inertias, self._subspaces)
        wp.launch(_factorize, dim=len(self._dofs), inputs=[self._dofs], outputs=[self._matrix])
        wp.launch(
            _find_mobilities,
            dim=model.body_count,
            inputs=[self._articulation_of_body, self._first_body, self._dofs, self._matrix, self._jacobian],
            outputs=[self._solved, self.matrices],
        )


@wp.kernel(enable_backward=False)
def _read_wrenches(
    links: wp.array[int],
    links_per_env: int,
    body_q: wp.array[wp.transform],
    body_com: wp.array[wp.vec3],
    at_center: wp.array[wp.spatial_vector],
    wrenches: wp.array2d[wp.spatial_vector],
):
    """Convert wrenches from world axes about the centre of mass to the link's axes about its origin."""
    env, number = wp.tid()
    body = env * links_per_env + links[number]
    q = wp.transform_get_rotation(body_q[body])
    force = wp.quat_rotate_inv(q, wp.spatial_top(at_center[body]))
    torque = wp.quat_rotate_inv(q, wp.spatial_bottom(at_center[body])) + wp.cross(body_com[body], force)
    wrenches[env, number] = wp.spatial_vector(force, torque)


class WrenchReader:
    """Reads the layout's wrench links from a solver's ``body_parent_f``."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._links = wp.array(plant.layout.wrench_links, dtype=int, device=plant.model.device)

    def read(self, body_parent_f: wp.array) -> None:
        plant = self._plant
        wp.launch(
            _read_wrenches,
            dim=plant.wrenches.shape,
            inputs=[
                self._links, len(plant.layout.links), plant.state.body_q, plant.model.body_com, body_parent_f
            ],
            outputs=[plant.wrenches],
        )  # fmt: skip


class FeatherstoneDynamics(Dynamics):
    """Forces of joints and contacts are computed here, linearly implicit and sized to the step; Newton integrates."""

    def __init__(self, plant: Plant) -> None:
        config: FeatherstoneConfig = plant.config
        self._plant = plant
        self.solver_steps = config.substeps
        self._h = plant.layout.scene.physics_dt / config.substeps
        model = plant.model
        # Newton's own drives and limits are explicit, which stiff ones do not survive: they are off, and computed here.
        for array in (model.joint_target_ke, model.joint_target_kd, model.joint_limit_ke, model.joint_limit_kd):
            array.zero_()
        self._solver = SolverFeatherstone(model)
        self._observables = self._solver.observables({"body_parent_f"}) if plant.layout.wrench_links else None
        self._wrenches = WrenchReader(plant) if plant.layout.wrench_links else None
        with wp.ScopedDevice(model.device):
            self._joints = joint_table(plant)
            self._surfaces = _surfaces(plant)
            # Contacts of one body share its mass, so that each must be sized to its part.
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
            # Without contacts: their forces are among the bodies' already.
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
    # Short of a right angle, where the tangent is infinite. The closed form gives the rebound of a ratio; what is
    # needed is its inverse, which has none.
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
