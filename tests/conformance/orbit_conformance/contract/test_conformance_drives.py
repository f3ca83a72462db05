"""Commands, limits and gains of drives; scenarios measure how accurate joints are."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_conformance.bodies import WEIGHTLESS, geared, index, pendulum, rotor, scene, slider
from orbit_conformance.contract.fixtures import MakeEngine, Needs, assert_near
from orbit_core.actuators.stability import ExplicitGains, unstable_drive
from orbit_core.interfaces import Backend, Capability, DriveIntegration
from orbit_core.scene import Articulation, IdealPd, ImplicitPd, Joint, JointType, Link, Pose, RobotSpec

INERTIA, MASS = 0.5, 2.0


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
    assert_near(engine.joint_velocities, expected, rtol=1e-4, atol=1e-6)
    assert_near(engine.joint_efforts, engine.efforts)


def test_the_effort_is_that_of_the_last_physics_step_and_stays_until_the_next(
    make_engine: MakeEngine, needs: Needs
) -> None:
    """Independent of the number of steps of a call, and of writes after it; 1e-5 of the largest."""
    needs(Capability.IMPLICIT_DRIVES, Capability.RANDOMIZE_GAINS)
    asked = scene(rotor(inertia=0.1, actuators=implicit(400.0, 80.0)), gravity=WEIGHTLESS)
    at_once, one_by_one = make_engine(asked), make_engine(asked)
    for engine in (at_once, one_by_one):
        engine.position_targets.fill_(0.5)
    at_once.step(3)
    for _ in range(3):
        one_by_one.step(1)
    # Writes must not change the reading: it is of the last step.
    before = one_by_one.joint_efforts.clone()
    at_once.write_joint_state(index(0), torch.ones(1, 1), torch.ones(1, 1))
    at_once.set_drive_gains(index(0), torch.full((1, 1), 7.0), torch.full((1, 1), 1.0))
    assert_near(at_once.joint_efforts, before, rtol=0, atol=40.0 * 1e-5)


def test_explicit_joint_ignores_targets(make_engine: MakeEngine) -> None:
    engine = make_engine(scene(rotor(actuators=(IdealPd(joints=(".*",), stiffness=100.0, damping=10.0),))))
    engine.position_targets.fill_(1.0)
    engine.velocity_targets.fill_(1.0)
    engine.step(10)
    assert engine.joint_positions.abs().max() == 0


def limited_rotor(**limits: float) -> RobotSpec:
    """A rotor whose joint has limits, which a continuous one has not."""
    robot = rotor(actuators=explicit(), **limits)
    joints = tuple(replace(joint, type=JointType.REVOLUTE) for joint in robot.articulation.joints)
    return replace(robot, articulation=replace(robot.articulation, joints=joints))


JOINTS = {"revolute": limited_rotor, "prismatic": slider}


@pytest.mark.parametrize("kind", JOINTS)
@pytest.mark.parametrize(
    ("lower", "upper"), [(-0.1, 0.2), (-math.inf, 0.2), (-0.1, math.inf)], ids=["both", "upper alone", "lower alone"]
)
def test_limits_hold(make_engine: MakeEngine, kind: str, lower: float, upper: float) -> None:
    """A joint pressed against a limit stays within 0.01 rad or m of it; without a limit it goes on."""
    robot = JOINTS[kind](lower_limit=lower, upper_limit=upper)
    engine = make_engine(scene(robot, terrain=()), num_envs=2)
    inertia = INERTIA if kind == "revolute" else MASS
    engine.efforts[:] = torch.tensor([[1.5], [-1.5]]) * inertia
    engine.step(200)  # one second, in which a free joint goes 0.75 rad or m
    truth = torch.tensor([[min(upper, 0.75)], [max(lower, -0.75)]])
    assert_near(engine.joint_positions, truth, atol=0.01)


def test_a_joint_within_its_limits_moves_freely(make_engine: MakeEngine) -> None:
    """``tau t^2 / 2 I`` right up to 0.7 rad of a limit of 1 rad; 1 %."""
    engine = make_engine(scene(limited_rotor(lower_limit=-1.0, upper_limit=1.0), terrain=()), num_envs=2)
    engine.efforts[:] = torch.tensor([[0.7], [-0.7]])
    engine.step(200)
    assert_near(engine.joint_positions, torch.tensor([[0.7], [-0.7]]), rtol=0.01)


def test_an_actuator_groups_armature_takes_the_joints_place(make_engine: MakeEngine, needs: Needs) -> None:
    """``omega = tau t / (I + armature)``, the group's where it names one, else the joint's; 1e-3."""
    needs(Capability.ARMATURE)
    for joints, group, armature in ((0.0, 0.25, 0.25), (0.1, 0.25, 0.25), (0.1, 0.0, 0.0), (0.1, None, 0.1)):
        motor = IdealPd(joints=(".*",), armature=group)
        engine = make_engine(scene(rotor(inertia=INERTIA, armature=joints, actuators=(motor,)), terrain=()))
        engine.efforts.fill_(1.0)
        engine.step(100)
        assert_near(engine.joint_velocities[0, 0], torch.tensor(0.5 / (INERTIA + armature)), rtol=1e-3)


def test_an_actuator_groups_effort_limit_takes_the_joints_place(make_engine: MakeEngine, needs: Needs) -> None:
    """Commands of 10 N m both ways give ``omega = limit t / I``, and the reported effort is the limit; 1e-3."""
    needs(Capability.EFFORT_LIMITS)
    motor = IdealPd(joints=(".*",), effort_limit=2.0)
    engine = make_engine(scene(rotor(inertia=INERTIA, effort_limit=5.0, actuators=(motor,)), terrain=()), num_envs=2)
    engine.efforts[:] = torch.tensor([[10.0], [-10.0]])
    engine.step(100)
    assert_near(engine.joint_velocities[:, 0], torch.tensor([2.0, -2.0]), rtol=1e-3)
    assert_near(engine.joint_efforts[:, 0], torch.tensor([2.0, -2.0]), rtol=1e-5)


def light_ended_arm(stiffness: float = 0.0, damping: float = 0.0) -> RobotSpec:
    """Two bars, the second of a hundredth of the first one's mass; implicit drives where there are gains."""
    links, joints = [Link("base")], []
    for number, mass in enumerate((2.0, 0.02)):
        links.append(Link(f"bar{number}", mass, (0.2, 0.0, 0.0), np.eye(3) * mass * 0.01))
        place = Pose((0.4 if number else 0.0, 0.0, 0.0))
        joints.append(Joint(f"joint{number}", JointType.REVOLUTE, links[-2].name, links[-1].name, place,
                            axis=(0.0, 1.0, 0.0), lower_limit=-3.0, upper_limit=3.0))  # fmt: skip
    drives = implicit(stiffness, damping) if stiffness or damping else explicit()
    return RobotSpec(
        name="arm", articulation=Articulation("arm", tuple(links), tuple(joints)), fixed_base=True, actuators=drives
    )


@pytest.mark.parametrize("delay", [0.0, 0.002])
def test_explicit_gains_diverge_beyond_the_limit_that_the_core_computes_and_not_below(
    make_engine: MakeEngine, delay: float
) -> None:
    """Efforts ``-k (q + delay v)`` of a two-link arm with a light end, from 1e-4 rad off, for 2 s; 4 %."""
    spec = light_ended_arm()
    much = np.full(2, 1e6)
    gains = ExplicitGains(stiffness=much, damping=delay * much, implicit_damping=np.zeros(2))
    # The core's own limit of stability decides what it refuses, so that it has to fit every engine.
    edge = unstable_drive(spec.articulation, gains, np.zeros(2), scene().physics_dt, fixed_base=True)
    assert edge is not None
    # 4 % on either side of the edge.
    for factor, diverges in ((0.96, False), (1.04, True)):
        stiffness = 1e6 * edge.share * factor
        engine = make_engine(scene(spec, gravity=WEIGHTLESS, terrain=()))
        engine.write_joint_state(index(0, 1), torch.tensor([[0.0, 1e-4]]), None)
        farthest = 0.0
        for _ in range(400):
            engine.efforts[:] = -stiffness * (engine.joint_positions + delay * engine.joint_velocities)
            engine.step(1)
            farthest = max(farthest, float(engine.joint_positions.abs().max()))
            # A thousand times the start: it has diverged, and more steps would only overflow.
            if farthest > 0.1:
                break
        assert (farthest > 0.1) is diverges


@pytest.mark.parametrize("damping", [0.0, 1e-3, 1.0])
@pytest.mark.parametrize("factor", [1.0, 1e2, 1e5])
def test_no_gain_of_an_implicit_drive_makes_a_light_ended_arm_diverge(
    backend: Backend, make_engine: MakeEngine, needs: Needs, factor: float, damping: float
) -> None:
    """The drive starts 0.01 rad off, for 2 s, at multiples of the largest stable explicit stiffness, 130 N m/rad."""
    needs(Capability.IMPLICIT_DRIVES)
    if backend.drive_integration is DriveIntegration.EXPLICIT:
        pytest.skip(f"{backend.name}: takes its drives' efforts at the beginning of a step")
    spec = light_ended_arm(130.0 * factor, damping * 130.0 * factor)
    engine = make_engine(scene(spec, gravity=WEIGHTLESS, terrain=()))
    engine.write_joint_state(index(0, 1), torch.full((1, 2), 0.01), None)
    farthest = 0.0
    for _ in range(400):
        engine.step(1)
        farthest = max(farthest, float(engine.joint_positions.abs().max()))
    assert farthest < 0.1


def test_an_actuator_groups_friction_takes_the_joints_place(make_engine: MakeEngine, needs: Needs) -> None:
    """``omega = (tau - friction) t / I`` with the group's friction; 2 %."""
    needs(Capability.JOINT_FRICTION)
    motor = IdealPd(joints=(".*",), friction=0.4)
    engine = make_engine(scene(rotor(inertia=INERTIA, friction=0.1, actuators=(motor,)), terrain=()))
    engine.efforts.fill_(1.0)
    engine.step(100)
    assert_near(engine.joint_velocities[0, 0], torch.tensor(0.6), rtol=0.02)


def test_a_drive_follows_its_velocity_target(make_engine: MakeEngine, needs: Needs) -> None:
    """Per environment, with damping alone; 1 %."""
    needs(Capability.IMPLICIT_DRIVES)
    engine = make_engine(scene(rotor(actuators=implicit(0.0, 20.0)), terrain=()), num_envs=2)
    engine.velocity_targets[:] = torch.tensor([[1.5], [-0.5]])
    engine.step(100)
    assert_near(engine.joint_velocities[:, 0], torch.tensor([1.5, -0.5]), rtol=0.01)


def test_a_mimic_joint_stays_with_its_written_leader(make_engine: MakeEngine, needs: Needs) -> None:
    """Both at rest without gravity: they stay there for 0.1 s; 0.01 rad."""
    needs(Capability.MIMIC_JOINTS)
    engine = make_engine(scene(geared(1.0, 0.0), gravity=WEIGHTLESS))
    engine.write_joint_state(index(0, 1), torch.tensor([[0.5, 0.5]]), None)
    engine.step(20)
    assert_near(engine.joint_positions, torch.tensor([[0.5, 0.5]]), atol=0.01)


def test_gravity_compensation_holds_a_free_chain(make_engine: MakeEngine, needs: Needs) -> None:
    """Without drives, at an angle, for 1 s: it stays within 1e-3 rad; without compensation it falls."""
    needs(Capability.GRAVITY_COMPENSATION)
    held = make_engine(scene(pendulum(gravity_compensation=True, home=0.5)))
    falling = make_engine(scene(pendulum(home=0.5)))
    for engine in (held, falling):
        engine.step(200)
    assert_near(held.joint_positions, torch.tensor([[0.5, 0.0]]), rtol=0, atol=1e-3)
    assert (falling.joint_positions[0, 0] - 0.5).abs() > 0.5


def test_drive_gains_per_environment(make_engine: MakeEngine, needs: Needs) -> None:
    """A constant effort deflects each drive by ``effort / stiffness``; 1 %. The gains survive a reset."""
    needs(Capability.RANDOMIZE_GAINS, Capability.IMPLICIT_DRIVES)
    engine = make_engine(scene(rotor(actuators=implicit(50.0, 20.0))), num_envs=3)
    gains = torch.tensor([[100.0], [25.0]])
    engine.set_drive_gains(index(0), gains, torch.full((2, 1), 20.0), index(2, 1))
    engine.reset()
    engine.efforts.fill_(5.0)
    # Long enough for the softest of the drives to settle.
    engine.step(1500)
    assert_near(engine.joint_positions, torch.tensor([[0.1], [0.2], [0.05]]), rtol=0.01, atol=0)
    engine.position_targets.fill_(1.0)
    engine.efforts.fill_(0.0)
    engine.step(1500)
    assert_near(engine.joint_positions, torch.ones(3, 1), rtol=0.01, atol=0)


def test_joint_types_move_as_they_should(make_engine: MakeEngine) -> None:
    engine = make_engine(scene(slider(), gravity=WEIGHTLESS))
    assert engine.layout.joints[0].type is JointType.PRISMATIC
    engine.write_joint_state(index(0), torch.tensor([[0.3]]), torch.tensor([[0.1]]))
    assert engine.link_poses[0, 1, :3].tolist() == pytest.approx([0.3, 0.0, 0.0], abs=1e-6)
    assert engine.link_velocities[0, 1].tolist() == pytest.approx([0.1, 0, 0, 0, 0, 0], abs=1e-6)
