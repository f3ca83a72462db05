"""The references hold what their equations conserve, and agree with one another."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
import torch

from orbit_conformance.reference import (
    PlanarChain,
    RotaryPendulum,
    euler_equations,
    linear_response,
    pendulum_period,
    trajectory,
)
from orbit_conformance.scenarios.rolling import RADIUS, THICKNESS, steady_roll


def test_runge_kutta_is_of_fourth_order() -> None:
    """Half the step, a sixteenth of the error, on ``x' = x``."""
    errors = [abs(trajectory(lambda x: x, np.ones(1), [1.0], step)[0, 0] - math.e) for step in (0.1, 0.05)]
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.1)


@pytest.mark.parametrize("damping", [2.0, 10.0, 30.0])
def test_linear_response(damping: float) -> None:
    """Against the matrix exponential: under-, critically and overdamped."""
    system = torch.tensor([[0.0, 1.0], [-100.0, -2 * damping]], dtype=torch.float64)
    expected = [1 - float(torch.linalg.matrix_exp(system * time)[0, 0]) for time in (0.05, 0.3, 2.0)]
    assert linear_response(50.0, damping, 0.5, [0.05, 0.3, 2.0]) == pytest.approx(expected, rel=1e-9)


def test_a_pendulum_takes_the_elliptic_period() -> None:
    """One link of the chain, released, is back after the period of the integral."""
    chain = PlanarChain(1, 0.5)
    small = 2 * math.pi * math.sqrt((0.01 + 0.25**2) / (9.81 * 0.25))
    start = np.array([math.pi / 2 - 2.8, 0.0])
    assert trajectory(chain.derivative, start, [pendulum_period(2.8, small)])[0] == pytest.approx(start, abs=1e-6)


def test_a_chain_keeps_its_energy() -> None:
    chain = PlanarChain(3, 0.4, armature=0.05)
    start = np.array([0.3, -0.5, 1.0, 0.1, 2.0, -1.0])
    (end,) = trajectory(chain.derivative, start, [1.0])
    assert np.abs(end - start).max() > 0.5
    assert chain.energy(end) == pytest.approx(chain.energy(start), abs=1e-8)


def test_a_free_body_keeps_energy_and_the_size_of_its_angular_momentum() -> None:
    moments = np.array([0.01, 0.02, 0.03])
    states = trajectory(euler_equations(moments), np.array([1.0, 0.0, 0.0, 0.0, 0.1, 5.0, 0.2]), [0.0, 1.0, 2.0])
    spins = states[:, 4:]
    assert np.linalg.norm(states[:, :4], axis=1) == pytest.approx(np.ones(3))
    assert (moments * spins**2).sum(1) == pytest.approx(np.full(3, (moments * spins[0] ** 2).sum()))
    lengths = np.linalg.norm(moments * spins, axis=1)
    assert lengths == pytest.approx(np.full(3, lengths[0]))


def test_a_rotary_pendulum_keeps_its_energy_and_its_angular_momentum() -> None:
    """No torque acts about the vertical: dT/da' is constant."""
    pendulum = RotaryPendulum(0.3, 0.25, 0.1)
    start = np.array([0.0, 2.5, 0.4, -1.0])
    (end,) = trajectory(pendulum.derivative, start, [1.0])
    assert np.abs(end - start).max() > 0.5
    assert pendulum.energy(end) == pytest.approx(pendulum.energy(start), abs=1e-8)
    assert _about_the_vertical(pendulum, end) == pytest.approx(_about_the_vertical(pendulum, start), abs=1e-8)


def _about_the_vertical(pendulum: RotaryPendulum, state: npt.NDArray[np.float64]) -> float:
    """dT/da' by differences, in kg m^2/s."""
    nudge = np.array([0.0, 0.0, 1e-4, 0.0])
    return (pendulum.energy(state + nudge) - pendulum.energy(state - nudge)) / 2e-4


def test_a_coin_in_steady_rolling_does_not_slip_and_balances_its_moments() -> None:
    """Vector form: the contact point rests, and ``W z x L = r x m (W z x v + g z)``."""
    lean, turning = 0.2, 1.0
    speed, spin = steady_roll(lean, turning)
    radius, half = RADIUS, THICKNESS / 2
    along, plane = np.array([1.0, 0.0, 0.0]), np.array([0.0, math.sin(lean), math.cos(lean)])
    up, axis = np.array([0.0, 0.0, 1.0]), np.cross(along, plane)
    rate = spin * axis + turning * (up - (up @ axis) * axis)
    contact = -radius * plane - half * axis
    assert speed * along + np.cross(rate, contact) == pytest.approx(np.zeros(3), abs=1e-12)
    axial, across = radius**2 / 2, (3 * radius**2 + THICKNESS**2) / 12
    momentum = across * rate + (axial - across) * (rate @ axis) * axis
    force = turning * np.cross(up, speed * along) + 9.81 * up
    assert turning * np.cross(up, momentum) == pytest.approx(np.cross(contact, force), abs=1e-12)
