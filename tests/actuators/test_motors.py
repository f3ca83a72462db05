"""Transmissions and windings against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch

from orbit_core.actuators import Actuators
from orbit_core.dynamics.random import RandomStreams
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import DcMotor, Transmission, Windings, four_bar, linear_drive

Pendulums = Callable[..., Any]
HEAT = Windings(motor_constant=0.5, thermal_resistance=2.0, time_constant=40.0, resistance_rise=0.0)


def _actuators(engine: Any) -> Actuators:
    random = RandomStreams(engine.num_envs, 0, engine.device)
    random.reset()
    return Actuators(engine, engine.layout, random)


def _motor(**fields: Any) -> tuple[DcMotor]:
    return (DcMotor(joints=("joint_.*",), saturation_effort=4.0, no_load_speed=30.0, **fields),)


@pytest.mark.parametrize(
    ("position", "velocity", "given"),
    [
        (-1.0, 0.0, 4.0),  # before the table: ratio 1
        (0.5, 0.0, 6.0),  # ratio 1.5
        (1.0, 0.0, 8.0),  # ratio 2: 4 N m of the motor
        (1.0, 7.5, 4.0),  # the motor at 15 of 30 rad/s gives half
        (0.5, 10.0, 3.0),  # also at 15 rad/s
        (1.0, 16.0, 0.0),  # beyond the motor's speed, not the joint's
        (2.0, 0.0, 4.0),  # a falling line, ratio 1
        (3.0, 0.0, 0.0),  # a dead centre
        (4.0, 0.0, 2.0),  # of ratio -0.5
    ],
)
def test_a_motor_works_through_its_transmission(
    pendulums: Pendulums, position: float, velocity: float, given: float
) -> None:
    table = Transmission(positions=(0.0, 1.0, 3.0, 4.0), ratios=(1.0, 2.0, 0.0, -0.5))
    engine = pendulums(_motor(transmission=table))
    actuators = _actuators(engine)
    engine.q[:], engine.v[:] = position, velocity
    for sign in (1.0, -1.0):
        engine.v[:] = sign * velocity
        actuators.effort_targets[:] = sign * 100.0
        actuators.apply()
        torch.testing.assert_close(engine.efforts, torch.full((2, 3), sign * given))


def test_reflected_inertia_is_that_at_home(pendulums: Pendulums) -> None:
    table = Transmission(positions=(-1.0, 1.0), ratios=(1.0, 3.0), rotor_inertia=0.01)
    armature = pendulums(_motor(transmission=table, armature=0.1)).layout.joint_parameters.armature
    assert armature.tolist() == pytest.approx([0.1 + 0.01 * 2.0**2] * 3)


def test_linkages_ratios_are_the_derivatives_of_their_motions() -> None:
    parallelogram = four_bar(crank=0.1, coupler=0.3, rocker=0.1, ground=0.3, within=(0.3, 2.8))
    assert [parallelogram.ratio(q) for q in (0.3, 1.0, 2.8)] == pytest.approx([1.0, 1.0, 1.0])
    lengths = {"crank": 0.06, "coupler": 0.25, "rocker": 0.1, "ground": 0.24}
    bar = four_bar(**lengths, within=(1.2, 2.2))

    def crank(q: float) -> float:
        x, y = 0.24 + 0.1 * math.cos(q), 0.1 * math.sin(q)
        cosine = (0.06**2 + x * x + y * y - 0.25**2) / (2.0 * 0.06 * math.hypot(x, y))
        return math.atan2(y, x) + math.acos(cosine)

    def length(q: float) -> float:
        return math.sqrt(0.4**2 + 0.05**2 - 2.0 * 0.4 * 0.05 * math.cos(q + 0.2))

    drive = linear_drive(base=0.4, lever=0.05, offset=0.2, within=(0.5, 2.0))
    for q in (1.21, 1.5, 1.77, 2.19):
        assert bar.ratio(q) == pytest.approx((crank(q + 1e-5) - crank(q - 1e-5)) / 2e-5, rel=2e-3)
    for q in (0.51, 1.0, 1.7):
        assert drive.ratio(q) == pytest.approx((length(q + 1e-5) - length(q - 1e-5)) / 2e-5, rel=1e-3)
    with pytest.raises(ValueError, match="cannot bring its rocker to 0 rad"):
        four_bar(**lengths, within=(0.0, 2.2))


def test_windings_warm_as_an_exponential_and_cool_again(pendulums: Pendulums) -> None:
    engine = pendulums(_motor(windings=HEAT, transmission=Transmission(ratios=(2.0,))), dt=0.25)
    actuators = _actuators(engine)
    actuators.effort_targets[:] = torch.tensor([[4.0, 2.0, 0.0]])  # of the motor 2, 1, 0 N m: 16, 4, 0 W
    state = actuators.save_state()
    for _ in range(240):
        actuators.apply()
    part = 1.0 - math.exp(-60.0 / 40.0)
    expected = torch.tensor([[25.0 + 32.0 * part, 25.0 + 8.0 * part, 25.0]]).repeat(2, 1)
    torch.testing.assert_close(actuators.temperatures(), expected, atol=1e-3, rtol=0.0)
    actuators.reset(torch.tensor([1]))
    assert actuators.temperatures()[1].tolist() == [25.0, 25.0, 25.0]
    actuators.copy(actuators, 0, torch.tensor([1]))
    actuators.effort_targets[:] = 0.0
    for _ in range(160):
        actuators.apply()
    torch.testing.assert_close(actuators.temperatures(), 25.0 + (expected - 25.0) * math.exp(-1.0), atol=1e-3, rtol=0.0)
    actuators.load_state(state)
    assert (actuators.temperatures() == 25.0).all()


def test_copper_gains_resistance_and_hot_motors_give_less(pendulums: Pendulums) -> None:
    copper = Windings(motor_constant=0.5, thermal_resistance=4.0, time_constant=1.0)
    engine = pendulums(_motor(windings=copper), dt=0.1)
    actuators = _actuators(engine)
    actuators.effort_targets[:] = 1.5
    for _ in range(400):
        actuators.apply()
    rise = 4.0 * (1.5 / 0.5) ** 2  # 36 K of the resistance at 25 degrees; more as it grows
    torch.testing.assert_close(actuators.temperatures(), torch.full((2, 3), 25.0 + rise / (1.0 - 0.0039 * rise)))
    actuators.effort_targets[:] = 4.0  # would be 25 + 256 / (1 - 0.0039 256) degrees
    for _ in range(400):
        actuators.apply()
    hot = actuators.temperatures()[0, 0].item()
    given = engine.efforts[0, 0].item()
    assert 100.0 < hot < 125.0
    assert given == pytest.approx(4.0 * (125.0 - hot) / 25.0, rel=1e-3)
    assert hot - 25.0 == pytest.approx(4.0 * (given / 0.5) ** 2 * (1.0 + 0.0039 * (hot - 25.0)), rel=1e-3)


def test_what_cannot_be_is_refused(pendulums: Pendulums) -> None:
    motor = DcMotor(joints=("joint_.*",), saturation_effort=4.0, transmission=Transmission(ratios=(2.0,)))
    engine = pendulums((motor,))
    with pytest.raises(ConfigurationError, match="set its no_load_speed, the motor's own"):
        _actuators(engine)
    with pytest.raises(ValueError, match="2 positions and 1 ratios"):
        Transmission(positions=(0.0, 1.0), ratios=(1.0,))
    with pytest.raises(ValueError, match="must rise"):
        Transmission(positions=(1.0, 1.0), ratios=(1.0, 2.0))
    with pytest.raises(ValueError, match="must be finite"):
        Transmission(ratios=(math.nan,))
    with pytest.raises(ValueError, match="time_constant of windings is 0"):
        Windings(motor_constant=1.0, thermal_resistance=1.0, time_constant=0.0)
    with pytest.raises(ValueError, match="derated from 130 to 125 degrees"):
        Windings(motor_constant=1.0, thermal_resistance=1.0, time_constant=1.0, derating_from=130.0)
