"""Actuators against closed forms, on an engine of pendulums."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch

from orbit_core.actuators import Actuators
from orbit_core.dynamics.random import RandomStreams
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import DcMotor, IdealPd, ImplicitPd

Pendulums = Callable[..., Any]


def _actuators(engine: Any, seed: int = 0) -> Actuators:
    random = RandomStreams(engine.num_envs, seed, engine.device)
    random.reset()
    return Actuators(engine, engine.layout, random)


def test_implicit_groups_write_straight_to_the_engine(pendulums: Pendulums) -> None:
    engine = pendulums((ImplicitPd(joints=("joint_.*",), stiffness=10.0),))
    actuators = _actuators(engine)
    assert not actuators.explicit
    assert actuators.position_targets is engine.position_targets
    assert actuators.velocity_targets is engine.velocity_targets
    assert actuators.effort_targets is engine.efforts


def test_ideal_pd_is_its_law(pendulums: Pendulums) -> None:
    engine = pendulums((IdealPd(joints=("joint_[ac]",), stiffness=3.0, damping=0.5),))
    actuators = _actuators(engine)
    assert actuators.explicit
    engine.q[:] = torch.tensor([[0.1, 0.2, -0.3], [0.0, 0.0, 1.0]])
    engine.v[:] = 0.4
    actuators.position_targets[:] = 0.5
    actuators.velocity_targets[:] = 0.1
    actuators.effort_targets[:] = torch.tensor([0.2, 0.7, 0.0])
    actuators.apply()
    expected = 3.0 * (0.5 - engine.q) + 0.5 * (0.1 - engine.v) + actuators.effort_targets
    expected[:, 1] = 0.7  # no group: only the effort target
    torch.testing.assert_close(engine.efforts, expected)


def test_efforts_are_limited(pendulums: Pendulums) -> None:
    group = IdealPd(joints=("joint_a",), stiffness=100.0, effort_limit=2.0)
    engine = pendulums((group, IdealPd(joints=("joint_b",), stiffness=100.0)))
    actuators = _actuators(engine)
    actuators.position_targets[:] = torch.tensor([[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]])
    actuators.apply()
    assert engine.efforts.tolist() == [[2.0, 8.0, 0.0], [-2.0, -8.0, 0.0]]


@pytest.mark.parametrize(
    ("velocity", "wanted", "given"),
    [
        (4.0, 100.0, 3.0),  # 12 W / 4 rad/s, where the line leaves 8
        (-4.0, -100.0, -3.0),
        (4.0, -100.0, -8.0),  # braking: the effort limit alone
        (4.0, 2.0, 2.0),  # 8 W
        (0.0, 100.0, 8.0),
        (1.0, 100.0, 8.0),  # 8 W at the effort limit
        (18.0, 100.0, 12.0 / 18.0),  # the line would leave 1
    ],
)
def test_a_motor_gives_no_more_than_its_power(
    pendulums: Pendulums, velocity: float, wanted: float, given: float
) -> None:
    engine = pendulums((DcMotor(joints=("joint_.*",), saturation_effort=10.0, power_limit=12.0),))
    actuators = _actuators(engine)
    engine.v[:] = velocity
    actuators.effort_targets[:] = wanted
    actuators.apply()
    torch.testing.assert_close(engine.efforts, torch.full((2, 3), given))
    with pytest.raises(ConfigurationError, match="power_limit 0 W: give a number above zero"):
        _actuators(pendulums((DcMotor(joints=("joint_.*",), saturation_effort=10.0, power_limit=0.0),)))


@pytest.mark.parametrize(
    ("velocity", "wanted", "available"),
    [
        (0.0, 100.0, 8.0),  # the effort limit cuts the line at standstill
        (0.0, -100.0, -8.0),
        (15.0, 100.0, 2.5),  # 10 (1 - 15/20)
        (15.0, -100.0, -8.0),  # braking
        (-15.0, -100.0, -2.5),
        (25.0, 100.0, 0.0),  # beyond the no-load speed
        (15.0, 1.0, 1.0),  # what is asked is there
    ],
)
def test_dc_motor_follows_its_torque_speed_line(
    pendulums: Pendulums, velocity: float, wanted: float, available: float
) -> None:
    engine = pendulums((DcMotor(joints=("joint_.*",), saturation_effort=10.0),))
    actuators = _actuators(engine)
    engine.v[:] = velocity
    actuators.effort_targets[:] = wanted
    actuators.apply()
    torch.testing.assert_close(engine.efforts, torch.full((2, 3), available))


def test_dc_motor_needs_a_no_load_speed(pendulums: Pendulums) -> None:
    engine = pendulums((DcMotor(joints=("joint_a",), saturation_effort=10.0, velocity_limit=float("inf")),))
    with pytest.raises(ConfigurationError, match="velocity_limit"):
        _actuators(engine)


def test_implicit_and_ideal_pd_agree_where_gains_are_soft(pendulums: Pendulums) -> None:
    paths = []
    for kind in (ImplicitPd, IdealPd):
        engine = pendulums((kind(joints=("joint_.*",), stiffness=5.0, damping=1.0),), dt=0.0005)
        actuators = _actuators(engine)
        actuators.position_targets[:] = 0.6
        path = []
        for _ in range(2000):
            if actuators.explicit:
                actuators.apply()
            engine.step(1)
            path.append(engine.q.clone())
        paths.append(torch.stack(path))
    assert paths[0].abs().max() > 0.3
    torch.testing.assert_close(paths[0], paths[1], atol=2e-3, rtol=0)


def test_delays_hold_commands_back(pendulums: Pendulums) -> None:
    engine = pendulums((IdealPd(joints=("joint_.*",), min_delay=2, max_delay=2),))
    actuators = _actuators(engine)
    seen = []
    for step in range(6):
        actuators.effort_targets[:] = float(step)
        actuators.apply()
        seen.append(engine.efforts[0, 0].item())
    assert seen == [0.0, 0.0, 0.0, 1.0, 2.0, 3.0]


def test_first_command_after_a_reset_acts_at_once(pendulums: Pendulums) -> None:
    engine = pendulums((IdealPd(joints=("joint_.*",), min_delay=2, max_delay=2),))
    actuators = _actuators(engine)
    for _ in range(4):
        actuators.effort_targets[:] = 1.0
        actuators.apply()
    actuators.reset(torch.tensor([1]))
    actuators.effort_targets[:] = 3.0
    actuators.apply()
    assert engine.efforts[:, 0].tolist() == [1.0, 3.0]


def _delays(pendulums: Pendulums, num_envs: int, seed: int) -> list[int]:
    groups = (IdealPd(joints=("joint_[ab]",), min_delay=1, max_delay=6), IdealPd(joints=("joint_c",)))
    engine = pendulums(groups, num_envs)
    actuators = _actuators(engine, seed)
    for step in range(8):
        actuators.effort_targets[:] = float(step)
        actuators.apply()
    assert torch.equal(engine.efforts[:, 0], engine.efforts[:, 1])
    assert (engine.efforts[:, 2] == 7.0).all()
    return (7 - engine.efforts[:, 0]).int().tolist()


def test_delays_are_drawn_per_environment(pendulums: Pendulums) -> None:
    delays = _delays(pendulums, 64, seed=5)
    assert set(delays) == {1, 2, 3, 4, 5, 6}
    assert _delays(pendulums, 4, seed=5) == delays[:4]
    assert _delays(pendulums, 64, seed=6) != delays


def test_an_impossible_delay_is_refused(pendulums: Pendulums) -> None:
    with pytest.raises(ConfigurationError, match="min_delay"):
        _actuators(pendulums((IdealPd(joints=("joint_a",), min_delay=3, max_delay=1),)))


def test_gains_are_set_alike_for_implicit_and_explicit_groups(pendulums: Pendulums) -> None:
    engine = pendulums((ImplicitPd(joints=("joint_a",)), IdealPd(joints=("joint_c",), stiffness=1.0)))
    actuators = _actuators(engine)
    stiffness, damping = torch.tensor([[4.0, 6.0]]), torch.tensor([[0.4, 0.6]])
    actuators.set_gains([0, 2], stiffness, damping, torch.tensor([1]))
    assert engine.stiffness[:, 0].tolist() == [0.0, 4.0]
    assert engine.damping[:, 0].tolist() == pytest.approx([0.0, 0.4])
    actuators.position_targets[:] = 1.0
    actuators.apply()
    assert engine.efforts[:, 2].tolist() == [1.0, 6.0]
    with pytest.raises(ConfigurationError, match="joint_b"):
        actuators.set_gains([1], stiffness[:, :1], damping[:, :1], torch.tensor([1]))


def test_snapshots_repeat_the_continuation(pendulums: Pendulums) -> None:
    groups = (IdealPd(joints=("joint_[ab]",), stiffness=5.0, min_delay=0, max_delay=4),)
    engine = pendulums((*groups, DcMotor(joints=("joint_c",), stiffness=2.0, saturation_effort=9.0)), 8)
    actuators = _actuators(engine)

    def run() -> torch.Tensor:
        path = []
        for step in range(10):
            actuators.position_targets[:] = 0.1 * step
            actuators.apply()
            engine.step(1)
            path.append(engine.q.clone())
        return torch.stack(path)

    run()
    state = engine.save_state(), actuators.save_state()
    first = run()
    actuators.set_gains([0], torch.zeros(8, 1), torch.zeros(8, 1))
    actuators.reset()
    engine.load_state(state[0])
    actuators.load_state(state[1])
    assert torch.equal(run(), first)
