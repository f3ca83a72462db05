"""Joints and what drives them, against closed forms. Integration error is first order in the step: 1 to 2 %."""

from __future__ import annotations

import math

import pytest
import torch

from orbit_core.conformance.bodies import WEIGHTLESS, G, geared, index, pendulum, rotor, scene, seconds, slider
from orbit_core.interfaces import Capability
from orbit_core.scene import IdealPd, ImplicitPd, JointType

from .conftest import MakeEngine, Needs

INERTIA = 0.5


def implicit(stiffness: float, damping: float, **limits: float) -> tuple[ImplicitPd]:
    return (ImplicitPd(joints=(".*",), stiffness=stiffness, damping=damping, **limits),)


def explicit(**limits: float) -> tuple[IdealPd]:
    return (IdealPd(joints=(".*",), **limits),)


@pytest.mark.parametrize(("stiffness", "damping"), [(50.0, 2.0), (50.0, 10.0), (50.0, 30.0)])
def test_drive_follows_the_linear_solution(
    make_engine: MakeEngine, needs: Needs, stiffness: float, damping: float
) -> None:
    """``I a = k (1 - q) - d v`` from rest: under-, critically and overdamped; 1 % of the step at 0.1, 0.3 and 1 s."""
    needs(Capability.IMPLICIT_DRIVES)
    engine = make_engine(scene(rotor(actuators=implicit(stiffness, damping)), dt=0.0005))
    engine.position_targets.fill_(1.0)
    system = torch.tensor([[0.0, 1.0], [-stiffness / INERTIA, -damping / INERTIA]], dtype=torch.float64)
    passed = 0.0
    for time in (0.1, 0.3, 1.0):
        engine.step(seconds(engine, time - passed))
        passed = time
        expected = 1 - float(torch.linalg.matrix_exp(system * time)[0, 0])
        assert engine.joint_positions[0, 0] == pytest.approx(expected, abs=0.01)


def test_stiff_drive_is_stable_and_holds(make_engine: MakeEngine, needs: Needs) -> None:
    """Gains of a robot arm on a light link at 5 ms: no ringing, and the target reached to 1e-3."""
    needs(Capability.IMPLICIT_DRIVES)
    engine = make_engine(scene(rotor(inertia=0.01, actuators=implicit(400.0, 40.0))))
    engine.position_targets.fill_(0.5)
    engine.step(200)
    assert engine.joint_positions[0, 0] == pytest.approx(0.5, abs=1e-3)
    assert engine.joint_velocities.abs().max() < 0.05


def test_velocity_target(make_engine: MakeEngine, needs: Needs) -> None:
    needs(Capability.IMPLICIT_DRIVES)
    engine = make_engine(scene(rotor(actuators=implicit(0.0, 20.0))))
    engine.velocity_targets.fill_(1.5)
    engine.step(200)
    assert engine.joint_velocities[0, 0] == pytest.approx(1.5, rel=1e-3)


def test_effort_limit_bounds_the_drive_and_the_effort_together(make_engine: MakeEngine, needs: Needs) -> None:
    """Saturated, the link accelerates with ``limit / inertia``, whatever the gains; 1 %."""
    needs(Capability.IMPLICIT_DRIVES, Capability.EFFORT_LIMITS)
    engine = make_engine(scene(rotor(actuators=implicit(1000.0, 100.0, effort_limit=2.0)), dt=0.001))
    engine.position_targets.fill_(50.0)
    engine.efforts.fill_(10.0)
    engine.step(100)
    assert engine.joint_efforts[0, 0] == pytest.approx(2.0, rel=1e-5)
    assert engine.joint_velocities[0, 0] == pytest.approx(2.0 * 0.1 / INERTIA, rel=0.01)


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


def test_force_on_a_prismatic_joint(make_engine: MakeEngine) -> None:
    """``v = F t / m`` with 2 kg; 1e-4."""
    engine = make_engine(scene(slider(actuators=explicit())))
    engine.efforts.fill_(3.0)
    engine.step(100)
    assert engine.joint_velocities[0, 0] == pytest.approx(3.0 * 0.5 / 2.0, rel=1e-4)
    assert engine.link_velocities[0, 1, 0] == pytest.approx(0.75, rel=1e-4)


def test_joint_damping(make_engine: MakeEngine, needs: Needs) -> None:
    """``v = v0 exp(-d t / I)``; 1 %."""
    needs(Capability.JOINT_DAMPING)
    engine = make_engine(scene(rotor(damping=1.0), dt=0.001))
    engine.write_joint_state(index(0), None, torch.tensor([[3.0]]))
    engine.step(500)
    assert engine.joint_velocities[0, 0] == pytest.approx(3.0 * math.exp(-1.0), rel=0.01)


def test_joint_friction_slows_and_holds(make_engine: MakeEngine, needs: Needs) -> None:
    """Sliding, ``a = -friction / I`` (2 %); below friction an effort moves the joint by less than 0.01 rad in 1 s."""
    needs(Capability.JOINT_FRICTION)
    engine = make_engine(scene(rotor(friction=0.5, actuators=explicit()), dt=0.001), num_envs=2)
    engine.write_joint_state(index(0), None, torch.tensor([[3.0], [0.0]]))
    engine.efforts[1] = 0.4
    engine.step(1000)
    assert engine.joint_velocities[0, 0] == pytest.approx(3.0 - 0.5 / INERTIA, rel=0.02)
    assert engine.joint_positions[1, 0].abs() < 0.01


def test_armature_adds_inertia(make_engine: MakeEngine, needs: Needs) -> None:
    """``omega = tau t / (I + armature)``; 1e-4."""
    needs(Capability.ARMATURE)
    engine = make_engine(scene(rotor(armature=0.25, actuators=explicit())))
    engine.efforts.fill_(1.0)
    engine.step(100)
    assert engine.joint_velocities[0, 0] == pytest.approx(0.5 / 0.75, rel=1e-4)


def test_limits_hold(make_engine: MakeEngine) -> None:
    """A joint pressed against its limit stays within 0.01 of it."""
    robot = slider(actuators=explicit(), lower_limit=-0.1, upper_limit=0.2)
    engine = make_engine(scene(robot), num_envs=2)
    engine.efforts[:] = torch.tensor([[10.0], [-10.0]])
    engine.step(400)
    torch.testing.assert_close(engine.joint_positions, torch.tensor([[0.2], [-0.1]]), rtol=0, atol=0.01)


def test_mimic_joint_follows(make_engine: MakeEngine, needs: Needs) -> None:
    """``follower = -2 leader + 0.1`` within 2 % of the motion, under a driven leader."""
    needs(Capability.MIMIC_JOINTS, Capability.IMPLICIT_DRIVES)
    engine = make_engine(scene(geared(-2.0, 0.1, implicit(100.0, 20.0))))
    assert engine.joint_positions[0].tolist() == pytest.approx([0.0, 0.1], abs=1e-6)
    engine.position_targets[:, 0] = 0.8
    for _ in range(20):
        engine.step(10)
        leader, follower = engine.joint_positions[0].tolist()
        assert follower == pytest.approx(-2 * leader + 0.1, abs=0.03)
    assert leader == pytest.approx(0.8, abs=0.01)


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


def test_small_oscillation_of_a_pendulum(make_engine: MakeEngine) -> None:
    """Period ``2 pi sqrt(J / (m g r))`` with J about the pivot; half a period mirrors the angle to 2 %."""
    engine = make_engine(scene(pendulum(links=1, home=math.pi / 2 - 0.05), dt=0.001))
    half = math.pi * math.sqrt((0.01 + 0.25**2) / (G * 0.25))
    engine.step(seconds(engine, half))
    assert engine.joint_positions[0, 0] - math.pi / 2 == pytest.approx(0.05, rel=0.02)


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
