"""How PD drives follow a small sine of their targets: the frequency response of the linearised mechanism.

About a configuration at rest and without gravity, joints behind drives of stiffness k and damping d obey
``M q'' + (d + d_j) q' + (k + k_j) q = k q*``, with the mass matrix M, and damping d_j and springs k_j of the mechanism
itself. A sine of the target's position alone, at the angular frequency w, moves them by
``H = (k + k_j - w^2 M + i w (d + d_j))^-1 k`` (Ogata, Modern Control Engineering, section 7.1). Far below the natural
frequency the lag is ``d / k`` seconds, whatever the inertia.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from orbit_core.dynamics.kinematics import mimic_matrix
from orbit_core.dynamics.rigid_body import RigidBodyModel
from orbit_core.scene import Articulation

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearJoints:
    """Coefficients (J,) of all movable joints, in N m/rad, N m s/rad and kg m^2, or N/m, N s/m and kg."""

    stiffness: FloatArray
    """Of the drives; zero where there is none."""
    damping: FloatArray
    """Of the drives."""
    spring_stiffness: FloatArray
    joint_damping: FloatArray
    armature: FloatArray


def drive_response(
    articulation: Articulation, joints: LinearJoints, positions: FloatArray, frequency: float
) -> ComplexArray:
    """Motion of all joints for a unit sine of one joint's target.

    Args:
        articulation: with a fixed root. Followers move as their leaders make them, by their slope where these are at
            zero, and have no drive of their own.
        joints: drives, springs, damping and armatures.
        positions: (n, J) configurations.
        frequency: of the sine in Hz.

    Returns:
        (n, J, J) complex; the column is the joint whose target moves. Zero in columns of followers and of joints
        without stiffness.
    """
    fold = mimic_matrix(articulation)
    leaders = np.array([joint.mimic is None for joint in articulation.movable_joints])
    drives = np.where(leaders, joints.stiffness, 0.0)
    stiffness = fold.T @ np.diag(drives + joints.spring_stiffness) @ fold
    damping = fold.T @ np.diag(np.where(leaders, joints.damping, 0.0) + joints.joint_damping) @ fold
    mass = fold.T @ _mass_matrices(articulation, joints.armature, positions) @ fold
    rate = 2.0 * math.pi * frequency
    dynamic = stiffness - rate**2 * mass + 1j * rate * damping
    free = np.ix_(leaders, leaders)
    response = np.zeros(dynamic.shape, dtype=np.complex128)
    for number, matrix in enumerate(dynamic):
        response[number][free] = np.linalg.solve(matrix[free], np.diag(drives)[free].astype(np.complex128))
    return fold @ response


def _mass_matrices(articulation: Articulation, armature: FloatArray, positions: FloatArray) -> FloatArray:
    """(n, J, J) in double precision: the fingers' moments are small differences of large ones."""
    model = RigidBodyModel(articulation, True, armature=armature.tolist(), dtype=torch.float64)
    root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], dtype=torch.float64).repeat(len(positions), 1)
    poses = model.kinematics.forward(root, torch.as_tensor(positions))
    return model.mass_matrix(poses).numpy()
