"""Wrenches measured and applied, and the parameters that act through Newton's law."""

from __future__ import annotations

import math

import pytest
import torch

from orbit_conformance.bodies import WEIGHTLESS, G, cube, index, pendulum, rotor, scene, yaw_quaternion
from orbit_conformance.contract.fixtures import MakeEngine, Needs, assert_near
from orbit_core.interfaces import Capability
from orbit_core.scene import ForceTorqueSpec, IdealPd, ImplicitPd, Pose

HELD = (ImplicitPd(joints=(".*",), stiffness=1e4, damping=1e3),)


def wrench(link: str) -> ForceTorqueSpec:
    return ForceTorqueSpec(name=link, entity="pendulum", link=link)


def test_a_joint_wrench_is_in_the_links_axes(make_engine: MakeEngine, needs: Needs) -> None:
    """Hanging straight down, the link's x points down: the support's force is along its -x; 1 %."""
    needs(Capability.JOINT_WRENCHES)
    robot = pendulum(links=1, home=math.pi / 2, base=Pose((0.0, 0.0, 2.0), (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))))
    engine = make_engine(scene(robot, sensors=(wrench("link0"),)))
    engine.step(20)
    expected = torch.tensor([-G, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert_near(engine.joint_wrenches[0, 0], expected, rtol=0, atol=0.05)


def test_an_external_force_accelerates(make_engine: MakeEngine, needs: Needs) -> None:
    """``F = m a`` in world axes for any orientation of the body, until set again; 1e-3."""
    needs(Capability.EXTERNAL_WRENCHES)
    engine = make_engine(scene(cube(mass=2.0), gravity=WEIGHTLESS, terrain=()), num_envs=3)
    engine.write_root_state(0, torch.tensor([[0.0, 0.0, 1.0, *yaw_quaternion(1.0)]] * 3), None)
    # Written for environments 2 and 0, in that order.
    forces = torch.tensor([[[4.0, 0.0, 2.0, 0.0, 0.0, 0.0]], [[0.0, -4.0, 0.0, 0.0, 0.0, 0.0]]])
    engine.set_wrenches(index(0), forces, index(2, 0))
    # In two calls: a wrench acts until it is set again, not for one call only.
    engine.step(60)
    engine.step(40)
    expected = torch.tensor([[0.0, -1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.5]])
    assert_near(engine.link_velocities[:, 0, :3], expected, rtol=1e-3, atol=1e-4)
    engine.set_wrenches(index(0), torch.zeros(3, 1, 6))
    engine.step(100)
    assert_near(engine.link_velocities[:, 0, :3], expected, rtol=1e-3, atol=1e-4)


def test_an_external_force_acts_at_the_centre_of_mass(make_engine: MakeEngine, needs: Needs) -> None:
    """A force turns nothing, however far off the link's origin is; a torque turns with ``tau / I``; 1 %."""
    needs(Capability.EXTERNAL_WRENCHES)
    engine = make_engine(
        scene(cube(half=0.3, center_of_mass=(0.2, 0.0, 0.0)), gravity=WEIGHTLESS, terrain=()), num_envs=2
    )
    engine.set_wrenches(index(0), torch.tensor([[[0.0, 1.0, 0, 0, 0, 0]], [[0.0, 0, 0, 0, 0, 0.1]]]))
    engine.step(100)
    assert engine.link_velocities[0, 0, 3:].abs().max() < 1e-4
    assert engine.link_velocities[0, 0, 1] == pytest.approx(0.5, rel=1e-3)
    assert engine.link_velocities[1, 0, 5] == pytest.approx(0.1 * 0.5 / (0.6**2 / 6), rel=0.01)


def test_mass_of_an_articulated_link(make_engine: MakeEngine, needs: Needs) -> None:
    """A link ten times as heavy has ten times the inertia about its axis; 1e-3."""
    needs(Capability.RANDOMIZE_MASS)
    engine = make_engine(scene(rotor(actuators=(IdealPd(joints=(".*",)),))), num_envs=2)
    engine.set_masses(index(1), torch.tensor([[10.0]]), index(1))
    engine.efforts.fill_(1.0)
    engine.step(100)
    assert_near(engine.joint_velocities[:, 0], torch.tensor([1.0, 0.1]), rtol=1e-3, atol=0)


def test_centre_of_mass_per_environment(make_engine: MakeEngine, needs: Needs) -> None:
    """A force at the shifted centre turns nothing; the origin of a spinning body circles that centre; 1 mm."""
    needs(Capability.RANDOMIZE_CENTER_OF_MASS)
    engine = make_engine(scene(cube(), gravity=WEIGHTLESS, terrain=(), dt=0.001), num_envs=2)
    # Only in environment 1; environment 0 is the reference.
    engine.set_centers_of_mass(index(0), torch.tensor([[[0.1, 0.0, 0.0]]]), index(1))
    spin = torch.tensor([[0.0, 0, 0, 0, 0, math.pi]] * 2)
    # The origin's velocity of a body whose centre rests: half a turn in one second.
    spin[1, 1] = -0.1 * math.pi
    engine.write_root_state(0, None, spin)
    engine.step(1000)
    expected = torch.tensor([[0.0, 0.0, 0.05], [0.2, 0.0, 0.05]])
    assert_near(engine.link_poses[:, 0, :3], expected, rtol=0, atol=2e-3)


def test_gravity_compensation_follows_the_gravity_of_the_environment(make_engine: MakeEngine, needs: Needs) -> None:
    needs(Capability.RANDOMIZE_GRAVITY, Capability.GRAVITY_COMPENSATION)
    engine = make_engine(scene(pendulum(gravity_compensation=True, home=0.3)), num_envs=2)
    engine.set_gravity(torch.tensor([[0.0, 0.0, -3.0]]), index(1))
    engine.step(100)
    assert_near(engine.joint_positions[:, 0], torch.tensor([0.3, 0.3]), rtol=0, atol=1e-3)
