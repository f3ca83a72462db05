"""What every registered motion generator refuses: numbers, names, robots and commands that cannot be."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import re
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import pytest
import torch

from orbit_core.actions import ActionTerm, Actuate
from orbit_core.actions.presets import motion_generators
from orbit_core.agent import AgentGraph, Edge
from orbit_core.interfaces import ArgumentError, ConfigurationError, NonFiniteError, ShapeError, UnknownNameError
from orbit_core.scene import ContactSensorSpec
from orbit_motion import GainRange
from tests.motion.servo_world import BACKENDS, Held, held

MakeRobot = Callable[..., Any]
WORDS = motion_generators().names
ANY_NUMBER = {"open_position", "closed_position"}
"""Fields of which no number is refused but what is not finite: places."""
SETTINGS: dict[str, dict[str, Any]] = {"admittance": {"sensor": "touch"}, "hybrid": {"sensor": "touch"}}
ROBOTS = {
    "base_velocity": "base_omni_franka_panda",
    "differential_drive": "tiago",
    "locomotion": "anymal_c",
    "trunk_mpc": "unitree_go2",
    "whole_body_ik": "base_omni_franka_panda",
}
"""Where a Franka on the ground does not do."""
LACKING = {
    "base_velocity": ("franka_panda", "robot 'franka_panda' has no planar base: name the joints of its x, y and yaw"),
    "differential_drive": ("franka_panda", "has no differential base: give its description one, or choose base_velo"),
    "joint_effort": ("franka_panda", "has effort limit 0.* give JointEffortConfig a scale"),
    "locomotion": ("franka_panda", "policy 'velocity_flat'.*"),
    "trunk_mpc": ("franka_panda", "moves a trunk on feet, and robot 'franka_panda' has a fixed base: choose hand_mpc"),
    "whole_body_ik": ("franka_panda", "has no base that moves: choose qp_ik, which moves the arm alone"),
}
"""A robot without what the generator needs, and what is told; of all others a quadruped, which has no hand."""
HOLDING = ("full_ik", "hand_mpc", "trunk_mpc")
"""Generators whose joints hold still where there is nothing to go to; the others' targets are refused."""


def config_of(word: str) -> type[ActionTerm]:
    return motion_generators().get(word)


def world_with(word: str, **fields: Any) -> Held:
    if word.endswith("_mpc") and importlib.util.find_spec("crocoddyl") is None:
        pytest.skip("crocoddyl is not installed")
    touch = ContactSensorSpec(name="touch", entity="robot", links=(".*",), rate=200.0)
    sensors = (touch,) if word in SETTINGS else ()
    term = config_of(word)(**SETTINGS.get(word, {}), **fields)
    name = ROBOTS.get(word, "franka_panda")
    return held(term, BACKENDS[0], name=name, num_envs=1, physics_dt=0.005, sensors=sensors)


@pytest.mark.parametrize("word", WORDS)
def test_no_field_takes_what_means_nothing(word: str) -> None:
    config = config_of(word)
    for field in dataclasses.fields(config):
        kind, told = str(field.type), f"{config.__name__}.*{field.name}"
        wrong: list[Any] = [object()]
        if re.search(r"\b(float|int)\b", kind) and "tuple" not in kind:
            wrong += [math.nan, "fast"]
            wrong += [] if field.name in config.unbounded else [math.inf]
            wrong += [] if field.name in ANY_NUMBER else [-1.0 if "float" in kind else -1]
        for value in wrong:
            with pytest.raises((ArgumentError, ConfigurationError), match=told):
                config(**{field.name: value})


@pytest.mark.parametrize(("low", "high"), [(2.0, 1.0), (0.0, 1.0), (math.nan, 1.0), (1.0, math.inf)])
def test_a_range_of_gains_begins_above_zero_and_ends_above_its_beginning(low: float, high: float) -> None:
    with pytest.raises(ConfigurationError, match=f"from {low} to {high} is no range above zero"):
        GainRange(low=low, high=high)


@pytest.mark.parametrize("word", WORDS)
def test_joints_and_frames_that_are_not_there_are_named(word: str, kinematic_robot: MakeRobot) -> None:
    config, robot = config_of(word), kinematic_robot(ROBOTS.get(word, "franka_panda"), 1)
    for name in {"joints", "frame"} & {field.name for field in dataclasses.fields(config)}:
        value = ("elbwo",) if name == "joints" else "elbwo"
        with pytest.raises(UnknownNameError, match=r"unknown (joint|frame|end effector) 'elbwo' in .*'"):
            config(**SETTINGS.get(word, {}), **{name: value}).build("it", robot)


@pytest.mark.parametrize("word", WORDS)
def test_a_robot_without_what_is_needed_is_told_so(word: str, kinematic_robot: MakeRobot) -> None:
    if word in ("joint_position", "joint_velocity", "joint_impedance", "joint_effort"):
        pytest.skip("every robot has joints")
    name, told = LACKING.get(
        word, ("unitree_go2", "robot 'unitree_go2' has no end effector: choose an action space of")
    )
    with pytest.raises(ConfigurationError, match=told):
        config_of(word)(**SETTINGS.get(word, {})).build("it", kinematic_robot(name, 1))


@pytest.mark.parametrize("word", WORDS)
def test_commands_that_are_no_numbers_or_too_few_move_nothing(word: str) -> None:
    it = world_with(word)
    generator, actuate = it.generator, Actuate(it.robot, it.generator)
    edges = [Edge("command", f"{generator.name}.command")]
    edges += [Edge(f"{generator.name}.{port.name}", f"{actuate.name}.{port.name}") for port in actuate.inputs]
    graph = AgentGraph([generator, actuate], edges, rate=50.0, inputs=generator.inputs)
    size = generator.command_size
    with pytest.raises(ShapeError, match=rf"'command'.*{size}"):
        graph.step({"command": torch.zeros(1, size + 1)})
    before = it.robot.joint_positions.clone()
    refusal = nullcontext() if word in HOLDING else pytest.raises(NonFiniteError, match=r"'robot'.*component")
    told = pytest.warns(UserWarning, match="holds still: a command is not a number")
    with told if word.endswith("_mpc") else nullcontext(), refusal:
        for _ in range(6):
            graph.step({"command": torch.full((1, size), math.nan)})
            it.world.step(4)
    torch.testing.assert_close(it.robot.joint_positions, before, atol=0.02, rtol=0.0)
    it.world.close()
