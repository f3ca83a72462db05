"""A world refuses drives that would make it diverge, and takes what the refusal says is stable."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_core.backends import backend, default_backend
from orbit_core.interfaces import ConfigurationError, DriveIntegration, World
from orbit_core.scene import (
    ActuatorConfig,
    Articulation,
    DcMotor,
    IdealPd,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    LoopJoint,
    RobotSpec,
    Scene,
)
from orbit_core.world import simulate

INERTIA, STEP = 0.1, 0.005


def wheel(drive: ActuatorConfig, **changes: object) -> RobotSpec:
    """A rotor of 0.1 kg m^2."""
    links = (Link("base"), Link("rotor", 1.0, inertia=np.eye(3) * INERTIA))
    joint = Joint("axle", JointType.REVOLUTE, "base", "rotor", lower_limit=-3.0, upper_limit=3.0, velocity_limit=50.0)
    body = Articulation("wheel", links, (replace(joint, **changes),))
    return RobotSpec(name="wheel", articulation=body, fixed_base=True, actuators=(drive,))


def world_of(spec: RobotSpec, step: float = STEP) -> World:
    return simulate(Scene(robots=(spec,), terrain=(), gravity=(0.0, 0.0, 0.0), physics_dt=step), 1, default_backend())


def settles(spec: RobotSpec, step: float = STEP) -> bool:
    world = world_of(spec, step)
    robot = world.robots["wheel"]
    robot.set_joint_state(torch.tensor([[0.01]]), None)
    for _ in range(400):
        world.step()
    off = float(robot.joint_positions.abs())
    world.close()
    return off < 0.02


@pytest.mark.parametrize("kind", [IdealPd, DcMotor])
def test_what_a_refusal_says_is_stable_is(kind: type[IdealPd]) -> None:
    more = {"saturation_effort": 1e4} if kind is DcMotor else {}
    drive = kind(joints=("axle",), stiffness=4000.0, damping=100.0, **more)
    with pytest.raises(ConfigurationError, match="'axle' of 'wheel', with stiffness 4000 and damping 100") as told:
        world_of(wheel(drive))
    words = str(told.value)
    assert "physics steps of 0.005 s" in words
    assert "ImplicitPd" in words
    stiffness, damping, step = (
        float(re.search(pattern, words).group(1))  # type: ignore[union-attr]
        for pattern in (r"\(stiffness ([\d.e+-]+)", r"damping ([\d.e+-]+)\)", r"physics_dt of at most ([\d.e+-]+);")
    )
    share = 4 * INERTIA / (4000.0 * STEP**2 + 2 * 100.0 * STEP)
    assert stiffness == pytest.approx(4000.0 * share, rel=1e-2)
    assert damping == pytest.approx(100.0 * share, rel=1e-2)
    assert step == pytest.approx((math.sqrt(100.0**2 + 4 * INERTIA * 4000.0) - 100.0) / 4000.0, rel=1e-2)
    assert settles(wheel(replace(drive, stiffness=stiffness, damping=damping)))
    assert settles(wheel(drive), step)
    assert settles(wheel(replace(drive, armature=0.5)))


def test_engines_own_drives_of_the_same_gains_are_taken() -> None:
    assert settles(wheel(ImplicitPd(joints=("axle",), stiffness=4000.0, damping=100.0)))


def test_the_mechanisms_damping_counts_where_the_engine_takes_it_at_the_end_of_a_step() -> None:
    drive = IdealPd(joints=("axle",), stiffness=0.0, damping=41.0)
    with pytest.raises(ConfigurationError, match=r"damping 41, is unstable"):
        world_of(wheel(drive))
    assert settles(wheel(drive, damping=2.0))


def test_an_engine_that_takes_its_own_drives_explicitly_has_them_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(backend(default_backend())), "drive_integration", DriveIntegration.EXPLICIT)
    drive = ImplicitPd(joints=("axle",), stiffness=4000.0, damping=100.0)
    with pytest.raises(ConfigurationError, match="joint 'axle' of 'wheel'") as told:
        world_of(wheel(drive))
    assert "ImplicitPd" not in str(told.value)
    world_of(wheel(replace(drive, stiffness=400.0, damping=10.0))).close()


def test_closed_loops_are_not_judged() -> None:
    drive = IdealPd(joints=("axle",), stiffness=4000.0, damping=100.0)
    spec = wheel(drive)
    body = replace(spec.articulation, loops=(LoopJoint("pin", "base", "rotor"),))
    world_of(replace(spec, articulation=body)).close()
