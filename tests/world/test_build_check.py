"""An engine that built something else than the description says is refused before it steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_conformance.bodies import pendulum, scene
from orbit_core import backends
from orbit_core.interfaces import BuildError, BuiltModel, Engine, SceneLayout
from orbit_core.scene import Joint, JointType, RobotSpec
from orbit_core.world import simulate
from orbit_core.world.checks import check_build

JointChange = Callable[[Joint], Joint]


def right(layout: SceneLayout) -> BuiltModel:
    """What an engine that built everything as described tells."""
    parameters = layout.joint_parameters
    return BuiltModel(
        masses=np.array([link.mass for link in layout.links]),
        centers_of_mass=np.array([link.center_of_mass for link in layout.links]),
        inertias=np.array([link.inertia for link in layout.links]),
        lower_limits=parameters.lower_limit,
        upper_limits=np.where(np.isinf(parameters.upper_limit), 1e9, parameters.upper_limit),
        armatures=parameters.armature,
    )


def limited() -> RobotSpec:
    robot = pendulum()
    of_range = {"type": JointType.REVOLUTE, "lower_limit": -1.0, "upper_limit": 2.0}
    joints = tuple(replace(joint, **of_range) for joint in robot.articulation.joints)
    return replace(robot, articulation=replace(robot.articulation, joints=joints))


def engine_of(robot: RobotSpec, num_envs: int = 2) -> Engine:
    plugin = backends.backend("mujoco")
    layout = SceneLayout.of(scene(robot))
    return plugin.create_engine(layout, num_envs, torch.device("cpu"), plugin.config_type())


def test_a_right_build_passes_and_stays_in_its_initial_state() -> None:
    engine = engine_of(limited())
    before = engine.link_poses.clone(), engine.joint_positions.clone()
    check_build(engine, "mujoco")
    assert torch.equal(engine.link_poses, before[0])
    assert torch.equal(engine.joint_positions, before[1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda model: replace(model, masses=model.masses * 1.01), "the mass of link .* kg instead of"),
        (lambda model: replace(model, centers_of_mass=model.centers_of_mass + 1e-3), "the centre of mass of link"),
        (lambda model: replace(model, inertias=model.inertias * 2), "the inertia of link"),
        (lambda model: replace(model, lower_limits=np.rad2deg(model.lower_limits)), "the lower limit of joint .* -57"),
        (lambda model: replace(model, upper_limits=np.full(2, np.inf)), "the upper limit of joint .* inf instead of 2"),
        (lambda model: replace(model, armatures=model.armatures + 0.1), "the armature of joint"),
        (lambda model: replace(model, effort_limits=np.ones(2)), "the effort limit of joint .* is 1 instead of inf"),
    ],
)
def test_wrong_numbers_are_named(change: Callable[[BuiltModel], BuiltModel], message: str) -> None:
    engine = engine_of(limited())
    engine.built_model = lambda: (change(right(engine.layout)),)
    with pytest.raises(BuildError, match=f"'mujoco' built the scene wrong: {message}"):
        check_build(engine, "mujoco")


def test_what_the_engine_does_not_keep_is_not_compared() -> None:
    engine = engine_of(limited())
    engine.built_model = lambda: (replace(right(engine.layout), armatures=None, upper_limits=None),)
    check_build(engine, "mujoco")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda joint: replace(joint, parent_pose=replace(joint.parent_pose, position=(0.3, 0.0, 0.1))),
            "at home, link",
        ),
        (lambda joint: replace(joint, axis=(1.0, 0.0, 0.0)), "with the joints of the last environment moved, link"),
    ],
)
def test_wrong_kinematics_are_named(change: JointChange, message: str) -> None:
    robot = limited()
    joints = robot.articulation.joints
    wrong = replace(robot, articulation=replace(robot.articulation, joints=(*joints[:-1], change(joints[-1]))))
    engine = engine_of(wrong)
    engine.layout = SceneLayout.of(scene(robot))
    with pytest.raises(BuildError, match=message):
        check_build(engine, "mujoco")


def test_a_world_that_was_built_wrong_is_not_made(monkeypatch: pytest.MonkeyPatch) -> None:
    plugin = backends.backend("mujoco")
    engine = engine_of(limited())
    engine.built_model = lambda: (replace(right(engine.layout), masses=np.ones(3) * 77),)
    monkeypatch.setattr(type(plugin), "create_engine", lambda *_: engine)
    with pytest.raises(BuildError, match="77 kg"):
        simulate(scene(limited()), 2, "mujoco")
