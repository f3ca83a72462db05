"""Tendons load the leader of a mimic joint, and the joints between not at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_conformance.bodies import WEIGHTLESS, body, scene
from orbit_core.scene import Articulation, IdealPd, Joint, JointType, Mimic, RobotSpec
from orbit_core.world import simulate

_INERTIAS = (0.1, 0.05, 0.2)


def _chain(multiplier: float, second_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> RobotSpec:
    """Three balanced rotors, each on the one before; the last mimics the first."""
    links = [body("base"), *(body(f"rotor{i}", inertia=inertia) for i, inertia in enumerate(_INERTIAS))]
    joints = [Joint(f"j{i}", JointType.CONTINUOUS, links[i].name, links[i + 1].name) for i in range(3)]
    joints[1] = replace(joints[1], axis=second_axis)
    joints[2] = replace(joints[2], mimic=Mimic("j0", multiplier))
    articulation = Articulation("chain", tuple(links), tuple(joints))
    return RobotSpec(name="chain", articulation=articulation, fixed_base=True, actuators=(IdealPd(joints=(".*",)),))


@pytest.mark.parametrize("multiplier", [-2.0, 0.5])
def test_a_joint_between_feels_only_inertia(multiplier: float) -> None:
    """``P^T M P a = P^T tau`` with the coupling ``q = P (q0, q1)``; 2 %, for the coupling is a spring."""
    world = simulate(scene(_chain(multiplier), gravity=WEIGHTLESS, terrain=()), 1, "sapien")
    robot = world.robots["chain"]
    robot.set_effort_targets(torch.tensor([[1.0, 0.0, 0.0]]))
    world.step(40)
    measured = robot.joint_velocities[0].numpy() / 0.2
    world.close()
    spins = np.tri(3)
    coupling = np.array([[1.0, 0.0], [0.0, 1.0], [multiplier, 0.0]])
    inertia = coupling.T @ spins.T @ np.diag(_INERTIAS) @ spins @ coupling
    expected = coupling @ np.linalg.solve(inertia, coupling.T @ np.array([1.0, 0.0, 0.0]))
    assert measured == pytest.approx(expected, abs=0.02 * np.abs(expected).max())


def test_a_chain_that_no_tendon_follows_is_reported() -> None:
    for axis, lines in (((0.0, 0.0, 1.0), 0), ((1.0, 0.0, 0.0), 1)):
        world = simulate(scene(_chain(1.0, axis), terrain=()), 1, "sapien")
        assert len([line for line in world.build_report if "leader alone" in line.asked]) == lines
        world.close()
