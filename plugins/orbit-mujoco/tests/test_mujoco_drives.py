"""Drives that are too stiff for the time step, on both backends that step MuJoCo's model."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from orbit_assets.catalogue import robot
from orbit_conformance.bodies import WEIGHTLESS, rotor, scene
from orbit_core.backends import backend_names
from orbit_core.interfaces import World
from orbit_core.scene import (
    Articulation,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    RobotSpec,
    Scene,
    Shape,
    Sphere,
)
from orbit_core.world import simulate

STEP, INERTIA = 0.005, 0.5
BACKENDS = [name for name in ("mujoco", "warp") if name in backend_names()]


def gains(frequency: float, ratio: float) -> tuple[float, float]:
    """Stiffness and damping, of a natural frequency in radians per step and a damping ratio."""
    return INERTIA * (frequency / STEP) ** 2, 2 * ratio * INERTIA * frequency / STEP


def world_of(stiffness: float, damping: float, backend: str, num_envs: int = 1, **settings: object) -> World:
    drive = ImplicitPd(joints=(".*",), stiffness=stiffness, damping=damping)
    spec = rotor(inertia=INERTIA, actuators=(drive,))
    return simulate(scene(spec, gravity=WEIGHTLESS, terrain=()), num_envs, backend, settings=settings)


def positions_of(world: World, steps: int) -> torch.Tensor:
    """(steps, N) of the joint on its way to one."""
    (rotor,) = world.robots.values()
    rotor.set_position_targets(torch.ones(world.num_envs, 1))
    positions = []
    for _ in range(steps):
        world.step(1)
        positions.append(rotor.joint_positions[:, 0].clone())
    return torch.stack(positions)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("frequency", "ratio"), [(2.5, 0.1), (10.0, 0.1), (10.0, 1.0), (40.0, 2.0)])
def test_a_drive_too_stiff_for_the_step_rests_at_its_target(backend: str, frequency: float, ratio: float) -> None:
    positions = positions_of(world_of(*gains(frequency, ratio), backend), 60)
    assert positions.max() < 1.2
    assert (positions[-20:] - 1).abs().max() < 1e-5


@pytest.mark.parametrize(("frequency", "ratio"), [(0.3, 0.0), (0.99, 0.1), (5.0, 3.0)])
def test_soft_and_well_damped_drives_are_left_as_they_are(frequency: float, ratio: float) -> None:
    stiffness, damping = gains(frequency, ratio)
    world = world_of(stiffness, damping, "mujoco")
    np.testing.assert_allclose(world.native[0].actuator_biasprm[0, :3], (0.0, -stiffness, -damping))
    assert not world.build_report


@pytest.mark.parametrize("integrator", ["implicitfast", "implicit", "discrete", "euler"])
def test_the_effort_is_the_one_that_the_integrator_applied(integrator: str) -> None:
    """``I (v1 - v0) / h`` of a free rotor; 1e-4 of the largest."""
    world = world_of(*gains(0.2, 1.0), "mujoco", integrator=integrator)
    (rotor,) = world.robots.values()
    rotor.set_position_targets(torch.ones(1, 1))
    before, largest = 0.0, 0.0
    for _ in range(5):
        world.step(1)
        effort, velocity = float(rotor.joint_efforts), float(rotor.joint_velocities)
        largest = max(largest, abs(effort))
        assert effort == pytest.approx(INERTIA * (velocity - before) / STEP, abs=1e-4 * largest)
        before = velocity


def driven_base(**drive: float) -> RobotSpec:
    """A trunk on one wheel of 2e-3 kg m^2."""
    wheel = Link("wheel", 0.4, (0.0, 0.0, 0.0), np.eye(3) * 2e-3, collisions=(Shape(Sphere(0.1)),))
    trunk = Link("trunk", 10.0, (0.0, 0.0, 0.0), np.eye(3) * 0.1)
    axle = Joint("axle", JointType.CONTINUOUS, "trunk", "wheel", axis=(0.0, 1.0, 0.0))
    motor = ImplicitPd(joints=(".*",), **drive)
    return RobotSpec(name="base", articulation=Articulation("base", (trunk, wheel), (axle,)), actuators=(motor,))


def test_contacts_are_solved_with_a_strong_velocity_drive_of_a_wheel_and_that_is_reported() -> None:
    world = simulate(scene(driven_base(damping=20.0)), 1, "mujoco")
    assert world.native[0].opt.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE
    (line,) = [line for line in world.build_report if line.subject == "the integrator"]
    assert (line.asked, line.got) == ("implicitfast", "discrete")
    assert "joint 'axle' of 'base'" in line.why


@pytest.mark.parametrize(
    "drive", [{"damping": 20.0, "effort_limit": 5.0}, {"damping": 0.3}, {"damping": 20.0, "stiffness": 1.0}]
)
def test_limited_weak_and_position_drives_keep_the_integrator(drive: dict[str, float]) -> None:
    world = simulate(scene(driven_base(**drive)), 1, "mujoco")
    assert world.native[0].opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST


@pytest.mark.parametrize(("damping", "swings"), [(190.0, False), (210.0, True)])
def test_the_build_report_names_a_drive_that_swings_at_its_limit(damping: float, swings: bool) -> None:
    """Twice the inertia over a step is 200 N m s/rad; a limit of 10 N m gives 0.1 rad/s in a step."""
    drive = ImplicitPd(joints=(".*",), damping=damping, effort_limit=10.0)
    world = simulate(scene(rotor(inertia=INERTIA, actuators=(drive,)), gravity=WEIGHTLESS, terrain=()), 1, "mujoco")
    told = [line.got for line in world.build_report if "joint 'spin'" in line.subject]
    assert told == (["one that swings by 0.1 rad/s once it was at its limit"] if swings else [])


def test_the_build_report_names_a_drive_that_is_damped_more_than_asked() -> None:
    (line,) = world_of(*gains(10.0, 0.1), "mujoco").build_report
    assert line.subject == "joint 'spin' of 'rotor'"
    assert line.asked == "a drive of stiffness 2e+06 and damping 200"
    assert line.got == "damping 9900"  # h k - m / h


@pytest.mark.parametrize(("integrator", "lines"), [("euler", 1), ("rk4", 1), ("discrete", 0)])
def test_integrators_that_cannot_hold_a_stiff_drive_say_so(integrator: str, lines: int) -> None:
    report = world_of(*gains(3.0, 0.1), "mujoco", integrator=integrator).build_report
    assert ["not stable in steps of 0.005 s" in line.got for line in report] == [True] * lines


@pytest.mark.parametrize("backend", BACKENDS)
def test_gains_and_masses_set_per_environment_keep_drives_stable(backend: str) -> None:
    world = world_of(10.0, 1.0, backend, num_envs=3)
    (rotor,) = world.robots.values()
    stiffness, damping = gains(torch.tensor([0.3, 0.9, 10.0]), 0.2)  # pyright: ignore[reportArgumentType]
    rotor.set_gains(stiffness[:, None], damping[:, None])
    link = rotor.link_names.index("rotor")
    lighter = world.layout.links[link].mass * torch.tensor([[1.0], [0.05], [1.0]])  # 0.9 becomes 4 radians per step
    rotor.set_masses(lighter, [link])
    positions = positions_of(world, 300)
    assert (positions[-1] - 1).abs().max() < 1e-4
    assert positions[:, 0].max() > 1.5  # the soft drive is underdamped as it was asked to be


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_stiff_arm_comes_to_rest(backend: str) -> None:
    """Seven drives of 3 to 30 radians per step that share one mass matrix, without effort limits."""
    arm = robot("franka_panda")
    drive = ImplicitPd(joints=("panda_joint[1-7]",), stiffness=1e5, damping=50.0, effort_limit=1e9)
    world = simulate(Scene(robots=(replace(arm, actuators=(drive,)),), terrain=()), 1, backend)
    (panda,) = world.robots.values()
    targets = panda.joint_positions.clone()
    targets[:, :7] += torch.tensor([0.3, -0.2, 0.25, 0.3, -0.3, 0.2, 0.4])
    panda.set_position_targets(targets)
    world.step(150)
    assert (panda.joint_positions - targets)[:, :7].abs().max() < 1e-3
