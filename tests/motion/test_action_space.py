"""Every action space, driven by its own inverse, brings the hand where it should be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from orbit_assets.catalogue import robot as catalogue_robot
from orbit_core.actions import ACTION_PRESETS, Actuate, MotionGenerator, preset_terms, with_drives_for
from orbit_core.dynamics.transforms import pose_error, quat_from_rotation_vector, quat_multiply
from orbit_core.interfaces import SceneLayout, UnknownNameError
from orbit_core.scene import Scene

MakeRobot = Callable[..., Any]
OPEN = torch.tensor([True, False, True, False])


def action_space(robot: Any, name: str) -> tuple[MotionGenerator, ...]:
    return tuple(term.build(key, robot) for key, term in preset_terms(robot.spec, name).items())


def _turn(robot: Any, generators: tuple[MotionGenerator, ...], commands: list[Tensor]) -> None:
    for generator, command in zip(generators, commands, strict=True):
        outputs = generator.compute({"command": command})
        Actuate(robot, generator).compute(outputs)


def _goal(robot: Any) -> Tensor:
    hand = robot.frame_pose(robot.spec.end_effector.frame)
    offset = torch.tensor([[0.1, 0.0, -0.1], [-0.05, 0.1, 0.1], [0.0, -0.15, 0.05], [0.05, 0.1, 0.0]])
    turn = quat_from_rotation_vector(torch.tensor([[0.0, 0, 0.4], [0.2, 0.1, 0], [0, 0.3, 0], [-0.2, 0, -0.3]]))
    return torch.cat((hand[:, :3] + offset, quat_multiply(turn, hand[:, 3:])), -1)


@pytest.mark.parametrize("name", [name for name in ACTION_PRESETS if name != "joint_effort"])
def test_encoded_commands_reach_a_pose(kinematic_robot: MakeRobot, name: str) -> None:
    robot = kinematic_robot()
    generators = action_space(robot, name)
    goal = _goal(robot)
    for _ in range(40):
        commands = [generator.encode(goal, OPEN) for generator in generators]
        assert all(command.abs().max() <= 1.0 for command in commands)
        _turn(robot, generators, commands)
    error = pose_error(robot.frame_pose(robot.spec.end_effector.frame), goal)
    assert error.abs().max() < 2e-3
    gripper = generators[-1].joints
    assert robot.q[:, gripper].squeeze(-1).tolist() == pytest.approx([0.04, 0.0, 0.04, 0.0])


@pytest.mark.parametrize("name", list(ACTION_PRESETS))
def test_shapes_fit_the_declared_ports(kinematic_robot: MakeRobot, name: str) -> None:
    robot = kinematic_robot()
    generators = action_space(robot, name)
    assert [generator.name for generator in generators] == [name, "gripper"]
    for generator in generators:
        outputs = generator.compute({"command": torch.zeros(4, generator.command_size)})
        assert {port.name: (4, *port.shape) for port in generator.outputs} == {
            port: tuple(value.shape) for port, value in outputs.items()
        }


@pytest.mark.parametrize("name", ["joint_position", "ik_absolute", "ik_relative", "joint_position_relative"])
def test_zero_command_stays_home(kinematic_robot: MakeRobot, name: str) -> None:
    robot = kinematic_robot()
    generator = action_space(robot, name)[0]
    targets = generator.compute({"command": torch.zeros(4, generator.command_size)})["position_targets"]
    torch.testing.assert_close(targets, robot.home_positions[generator.joints].expand(4, -1), atol=1e-5, rtol=0)


@pytest.mark.parametrize("name", ["joint_position", "joint_position_relative", "ik_absolute", "ik_relative"])
def test_targets_stay_within_limits(kinematic_robot: MakeRobot, name: str) -> None:
    robot = kinematic_robot()
    generators = action_space(robot, name)
    generator = torch.Generator().manual_seed(0)
    command = torch.rand(4, generators[0].command_size, generator=generator).sign()
    lower, upper = robot.position_limits[generators[0].joints].unbind(-1)
    for _ in range(50):
        _turn(robot, generators[:1], [command])
        positions = robot.q[:, generators[0].joints]
        assert ((positions >= lower) & (positions <= upper)).all()


def test_unknown_action_space_suggests_a_known_one(kinematic_robot: MakeRobot) -> None:
    with pytest.raises(UnknownNameError, match="ik_relative"):
        action_space(kinematic_robot(), "ik_relativ")


@pytest.mark.parametrize(("name", "stiffness", "damping"), [("joint_velocity", 0, 80), ("joint_effort", 0, 0)])
def test_drives_do_not_work_against_commands(name: str, stiffness: float, damping: float) -> None:
    spec = catalogue_robot("franka_panda")
    adapted = with_drives_for(spec, preset_terms(spec, name))
    parameters = SceneLayout.of(Scene(robots=(adapted,))).joint_parameters
    before = SceneLayout.of(Scene(robots=(spec,))).joint_parameters
    assert parameters.drive_stiffness[:7].tolist() == [stiffness] * 7
    assert parameters.drive_damping[:7].tolist() == [damping] * 7
    assert parameters.drive_stiffness[7:].tolist() == before.drive_stiffness[7:].tolist()
    assert parameters.effort_limit.tolist() == before.effort_limit.tolist()
    assert with_drives_for(spec, preset_terms(spec, "ik_relative")) is spec
