"""What an engine makes of commands, limits and gains; how right its joints are is a matter of the scenarios."""

from __future__ import annotations

import pytest
import torch

from orbit_core.conformance.bodies import WEIGHTLESS, geared, index, pendulum, rotor, scene, slider
from orbit_core.interfaces import Capability
from orbit_core.scene import IdealPd, ImplicitPd, JointType

from .conftest import MakeEngine, Needs

INERTIA = 0.5


def implicit(stiffness: float, damping: float) -> tuple[ImplicitPd]:
    return (ImplicitPd(joints=(".*",), stiffness=stiffness, damping=damping),)


def explicit() -> tuple[IdealPd]:
    return (IdealPd(joints=(".*",)),)


def test_effort_alone_accelerates(make_engine: MakeEngine) -> None:
    """``omega = tau t / I``; per environment; 1e-4."""
    engine = make_engine(scene(rotor(actuators=explicit())), num_envs=3)
    engine.efforts[:] = torch.tensor([[0.0], [1.0], [-2.0]])
    engine.step(100)
    expected = torch.tensor([[0.0], [1.0], [-2.0]]) * 0.5 / INERTIA
    torch.testing.assert_close(engine.joint_velocities, expected, rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(engine.joint_efforts, engine.efforts)


def test_explicit_joint_ignores_targets(make_engine: MakeEngine) -> None:
    engine = make_engine(scene(rotor(actuators=(IdealPd(joints=(".*",), stiffness=100.0, damping=10.0),))))
    engine.position_targets.fill_(1.0)
    engine.velocity_targets.fill_(1.0)
    engine.step(10)
    assert engine.joint_positions.abs().max() == 0


def test_limits_hold(make_engine: MakeEngine) -> None:
    """A joint pressed against its limit stays within 0.01 of it."""
    robot = slider(actuators=explicit(), lower_limit=-0.1, upper_limit=0.2)
    engine = make_engine(scene(robot), num_envs=2)
    engine.efforts[:] = torch.tensor([[10.0], [-10.0]])
    engine.step(400)
    torch.testing.assert_close(engine.joint_positions, torch.tensor([[0.2], [-0.1]]), rtol=0, atol=0.01)


def test_mimic_joint_follows_a_written_leader_after_a_step(make_engine: MakeEngine, needs: Needs) -> None:
    """Within 2 % of the jump after 0.1 s, and the leader keeps its place: the drive holds it."""
    needs(Capability.MIMIC_JOINTS, Capability.IMPLICIT_DRIVES)
    engine = make_engine(scene(geared(1.0, 0.0, implicit(1000.0, 100.0))))
    engine.write_joint_state(index(0, 1), torch.tensor([[0.5, 0.5]]), None)
    engine.position_targets[:, 0] = 0.5
    engine.step(20)
    torch.testing.assert_close(engine.joint_positions, torch.tensor([[0.5, 0.5]]), rtol=0, atol=0.01)


def test_gravity_compensation_holds_a_free_chain(make_engine: MakeEngine, needs: Needs) -> None:
    """Without drives, at an angle, for 1 s: it stays within 1e-3 rad; without compensation it falls."""
    needs(Capability.GRAVITY_COMPENSATION)
    held = make_engine(scene(pendulum(gravity_compensation=True, home=0.5)))
    falling = make_engine(scene(pendulum(home=0.5)))
    for engine in (held, falling):
        engine.step(200)
    torch.testing.assert_close(held.joint_positions, torch.tensor([[0.5, 0.0]]), rtol=0, atol=1e-3)
    assert (falling.joint_positions[0, 0] - 0.5).abs() > 0.5


def test_drive_gains_per_environment(make_engine: MakeEngine, needs: Needs) -> None:
    """A constant effort deflects each drive by ``effort / stiffness``; 1 %. The gains survive a reset."""
    needs(Capability.RANDOMIZE_GAINS, Capability.IMPLICIT_DRIVES)
    engine = make_engine(scene(rotor(actuators=implicit(50.0, 20.0))), num_envs=3)
    gains = torch.tensor([[100.0], [25.0]])
    engine.set_drive_gains(index(0), gains, torch.full((2, 1), 20.0), index(2, 1))
    engine.reset()
    engine.efforts.fill_(5.0)
    engine.step(1500)
    torch.testing.assert_close(engine.joint_positions, torch.tensor([[0.1], [0.2], [0.05]]), rtol=0.01, atol=0)
    engine.position_targets.fill_(1.0)
    engine.efforts.fill_(0.0)
    engine.step(1500)
    torch.testing.assert_close(engine.joint_positions, torch.ones(3, 1), rtol=0.01, atol=0)


def test_joint_types_move_as_they_should(make_engine: MakeEngine) -> None:
    engine = make_engine(scene(slider(), gravity=WEIGHTLESS))
    assert engine.layout.joints[0].type is JointType.PRISMATIC
    engine.write_joint_state(index(0), torch.tensor([[0.3]]), torch.tensor([[0.1]]))
    assert engine.link_poses[0, 1, :3].tolist() == pytest.approx([0.3, 0.0, 0.0], abs=1e-6)
    assert engine.link_velocities[0, 1].tolist() == pytest.approx([0.1, 0, 0, 0, 0, 0], abs=1e-6)
