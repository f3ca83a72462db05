"""Pinocchio computes the same dynamics and kinematics from the same description."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from orbit_assets.catalogue import robot
from orbit_core.dynamics.rigid_body import RigidBodyModel
from orbit_core.scene import Articulation
from orbit_motion.mpc.predictive import pinocchio_model

pinocchio = pytest.importorskip("pinocchio", reason="the reference for rigid bodies is not installed (pip: pin)")
ROOT = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)


def reference(articulation: Articulation) -> tuple[Any, list[int]]:
    """The model, and where its velocities hold the articulation's movable joints; followers count as free."""
    model, ids = pinocchio_model(articulation)
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    return model, [model.joints[ids[name]].idx_v for name in articulation.joint_names]


@pytest.mark.parametrize("name", ["franka_panda", "ur10_robotiq_2f85"])
def test_mass_matrix_bias_jacobian_and_drift_are_pinocchios(name: str) -> None:
    articulation = robot(name).articulation
    model, columns = reference(articulation)
    data, count = model.createData(), len(columns)
    own = RigidBodyModel(articulation, True, armature=[0.0] * count, dtype=torch.float64)
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, v = rng.uniform(-1.0, 1.0, count), rng.uniform(-2.0, 2.0, count)
        positions, velocities = np.zeros(model.nq), np.zeros(model.nv)
        positions[columns], velocities[columns] = q, v
        links = own.kinematics.forward(ROOT, torch.as_tensor(q)[None])
        rates = torch.as_tensor(v)[None]
        mass, bias = own.equation_of_motion(links, torch.zeros(1, 6, dtype=torch.float64), rates)
        full = pinocchio.crba(model, data, positions)
        full = np.triu(full) + np.triu(full, 1).T
        np.testing.assert_allclose(mass[0], full[np.ix_(columns, columns)], atol=1e-9)
        efforts = pinocchio.nonLinearEffects(model, data, positions, velocities)
        np.testing.assert_allclose(bias[0], efforts[columns], atol=1e-8)
        link = articulation.link_names[-1]
        frame = model.getFrameId(link, pinocchio.FrameType.OP_FRAME)
        axes = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pinocchio.computeFrameJacobian(model, data, positions, frame, axes)
        np.testing.assert_allclose(own.kinematics.jacobian(links, link)[0], jacobian[:, columns], atol=1e-9)
        pinocchio.forwardKinematics(model, data, positions, velocities, np.zeros(model.nv))
        drift = pinocchio.getFrameClassicalAcceleration(model, data, frame, axes)
        found = own.kinematics.frame_drift(links, rates, link)[0]
        np.testing.assert_allclose(found, np.concatenate((drift.linear, drift.angular)), atol=1e-9)
