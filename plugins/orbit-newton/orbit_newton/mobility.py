"""Mobility of each body in its articulation: the inverse of its apparent inertia.

A wrench ``w`` on a body at its centre of mass changes its velocity at the rate ``J H^-1 J^T w``, where J is its
Jacobian and H the mass matrix of the articulation (Khatib, A Unified Approach for Motion and Force Control, 1987).
"""

# pyright: reportMissingImports=false
# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import newton
import numpy as np
import warp as wp

from orbit_newton.plant import Plant


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
