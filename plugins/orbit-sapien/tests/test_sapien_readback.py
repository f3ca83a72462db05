"""What PhysX holds is read from PhysX: a wrong mass, frame, limit or armature shows; and what diverged is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from orbit_core import backends
from orbit_core.interfaces import MAX_SPEED, BuildError, SceneLayout, SimulationError
from orbit_core.scene import Articulation, Joint, JointType, Link, ObjectSpec, Pose, RobotSpec, Scene
from orbit_core.world.checks import check_build
from orbit_sapien.engine import SapienEngine
from orbit_sapien.native import NativePose


def arm() -> RobotSpec:
    """A free base and a limited link, whose inertia has products and whose centre of mass is off its origin."""
    inertia = np.array([[0.03, 0.002, 0.001], [0.002, 0.02, 0.003], [0.001, 0.003, 0.04]])
    links = Link("base", 2.0, (0.1, 0.0, 0.0), inertia), Link("arm", 1.0, (0.0, 0.2, 0.1), inertia)
    joint = Joint(
        "hinge", JointType.REVOLUTE, "base", "arm", Pose((0.3, 0.0, 0.0)), axis=(0.0, 1.0, 0.0),
        lower_limit=-1.0, upper_limit=2.0, armature=0.1,
    )  # fmt: skip
    return RobotSpec(name="arm", articulation=Articulation("arm", links, (joint,)), pose=Pose((0.0, 0.0, 1.0)))


def engine_of(scene: Scene, num_envs: int = 2) -> SapienEngine:
    plugin = backends.backend("sapien")
    made = plugin.create_engine(SceneLayout.of(scene), num_envs, torch.device("cpu"), plugin.config_type())
    assert isinstance(made, SapienEngine)
    return made


def test_a_right_build_passes() -> None:
    check_build(engine_of(Scene(robots=(arm(),))), "sapien")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda joint: joint.child_link.set_mass(1.1), "the mass of link 'arm'"),
        (lambda joint: joint.child_link.set_inertia([0.02, 0.03, 0.05]), "the inertia of link 'arm'"),
        (lambda joint: joint.child_link.set_cmass_local_pose(NativePose()), "the centre of mass of link 'arm'"),
        (lambda joint: joint.set_limits(np.array([[-1.0, 3.0]], np.float32)), "the upper limit of joint 'hinge'"),
        (lambda joint: joint.set_armature(np.zeros(1, np.float32)), "the armature of joint 'hinge'"),
    ],
)
def test_what_physx_holds_wrongly_is_named(spoil: Callable[[Any], None], message: str) -> None:
    engine = engine_of(Scene(robots=(arm(),)))
    spoil(engine.native_joints[0][0])
    with pytest.raises(BuildError, match=message):
        check_build(engine, "sapien")


@pytest.mark.parametrize("axis", [0, 4])
def test_a_body_faster_than_any_is_refused_with_its_environment(axis: int) -> None:
    """Twice the bound in m/s along x, or in rad/s about y."""
    body = Articulation("ball", (Link("ball", 1.0, inertia=np.eye(3)),))
    engine = engine_of(Scene(objects=(ObjectSpec(name="ball", articulation=body),), terrain=()), 3)
    velocity = torch.zeros(1, 6)
    velocity[0, axis] = 2.0 * MAX_SPEED
    engine.write_root_state(0, None, velocity, torch.tensor([1]))
    with pytest.raises(SimulationError, match=r"environments 1 diverged"):
        engine.step(1)
