"""Commands are sampled within ranges, again in time or when a term says so, and follow their configuration live."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest
import torch
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_core.envs import CommandTerm, Environment, ObservationGroup, ObservationTerm, RewardTerm, make
from orbit_core.envs.captured_step import CapturedStep
from orbit_core.envs.configuration import configure
from orbit_core.interfaces import ConfigurationError, ShapeError, UnknownNameError
from orbit_core.mdp.commands import (
    HeadingVelocityCommand,
    UniformPoseCommand,
    UniformScalarCommand,
    UniformVelocityCommand,
    generated_command,
)
from orbit_tasks.lift import Lift
from orbit_tasks.reach import Reach

BACKEND = default_backend()


@dataclass
class Shown(ObservationGroup):
    """The command."""

    number: ObservationTerm | None = ObservationTerm(generated_command("number"))


@dataclass
class Observations:
    """Policies see the command."""

    policy: Shown = field(default_factory=Shown)


@dataclass
class Commands:
    """One number."""

    number: CommandTerm | None = UniformScalarCommand(value=(1.0, 2.0), resampling_time=(0.04, 0.04))


@dataclass
class Rewards:
    """The command."""

    number: RewardTerm | None = RewardTerm(lambda env: env.commands["number"][:, 0], 1.0)


@dataclass(kw_only=True)
class Commanded(Reach):
    """Reach with a number that is commanded, every two steps another."""

    observations: Any = field(default_factory=Observations)
    rewards: Any = field(default_factory=Rewards)
    commands: Any = field(default_factory=Commands)
    physics_dt: float = 0.005

    def success(self, env: Environment) -> Tensor:
        return env.commands["number"][:, 0] > 0.0

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"number": env.commands["number"][:, 0]}


def environment_of(task: Any, captured: bool = False, count: int = 3) -> Environment:
    environment = Environment(task, count, BACKEND)
    if captured:
        environment._closed = CapturedStep(environment, compile=False, whole=True)
    return environment


def numbers(environment: Environment, steps: int) -> Tensor:
    """(steps, N) the command that is shown after each step."""
    action = torch.zeros(environment.num_envs, environment.action_size)
    return torch.stack([environment.step(action)[0]["policy"][:, 0].clone() for _ in range(steps)])


@pytest.fixture(params=[False, True], ids=["eager", "captured"])
def commanded(request: pytest.FixtureRequest) -> Iterator[Environment]:
    environment = environment_of(Commanded(), request.param)
    numbers(environment, 3)
    yield environment
    assert (environment._closed is not None) == request.param, "a captured step stays captured"
    environment.close()


def test_a_command_is_sampled_again_after_its_time(commanded: Environment) -> None:
    commanded.reset(seed=1)
    seen = numbers(commanded, 8)
    assert ((seen >= 1.0) & (seen < 2.0)).all()
    changed = (seen[1:] != seen[:-1]).all(1)
    assert changed.tolist() == [True, False, True, False, True, False, True]


def test_a_step_earns_by_the_command_that_it_was_taken_under(commanded: Environment) -> None:
    commanded.reset(seed=1)
    action = torch.zeros(3, commanded.action_size)
    for _ in range(4):
        before = commanded.commands["number"][:, 0].clone()
        torch.testing.assert_close(commanded.step(action)[1], before * commanded.step_dt)


def test_a_range_set_acts_at_the_next_sample_without_another_capture(commanded: Environment) -> None:
    replays = [f.replay for part in (commanded._closed.parts if commanded._closed else ()) for f in part.functions]
    commanded.task.commands.number.value = (5.0, 6.0)
    seen = numbers(commanded, 3)[-1]
    assert ((seen >= 5.0) & (seen < 6.0)).all()
    assert replays == [
        f.replay for part in (commanded._closed.parts if commanded._closed else ()) for f in part.functions
    ]


def test_a_resampling_time_set_holds_from_the_next_sample_on(commanded: Environment) -> None:
    commanded.task.commands.number.resampling_time = (0.02, 0.02)
    seen = numbers(commanded, 6)[2:]
    assert (seen[1:] != seen[:-1]).all()


def test_commands_draw_the_same_for_an_environment_whatever_their_number() -> None:
    few, many = (environment_of(Commanded(), count=count) for count in (2, 5))
    for environment in (few, many):
        environment.reset(seed=3)
    torch.testing.assert_close(numbers(few, 6), numbers(many, 6)[:, :2])
    few.close(), many.close()


@pytest.mark.parametrize(
    ("value", "match"),
    [
        ((2.0, 1.0), r"range 'value' of command 'number' is empty, for its least 2 is above its most 1"),
        ((0.0, math.inf), "range 'value' of command 'number' must be two finite numbers"),
        ((0.0,), "must be two finite numbers"),
        ("wide", "must be two finite numbers, not 'wide'"),
        (3.0, "must be two finite numbers"),
    ],
)
def test_a_range_that_cannot_be_is_named(value: Any, match: str) -> None:
    with pytest.raises(ConfigurationError, match=match):
        environment_of(Commanded(commands=Commands(UniformScalarCommand(value=value))))
    environment = environment_of(Commanded())
    environment.task.commands.number.value = value
    with pytest.raises(ConfigurationError, match=match):
        numbers(environment, 1)
    environment.close()


def test_times_and_shapes_that_cannot_be_are_named() -> None:
    @dataclass(unsafe_hash=True, kw_only=True)
    class Flat(UniformScalarCommand):
        def command(self, env: Environment, drawn: Tensor, env_ids: Tensor) -> Tensor:
            return drawn.sum()

    for term, error, match in (
        (UniformScalarCommand(value=(0.0, 1.0), resampling_time=(2.0, 1.0)), ConfigurationError, "resampling time of"),
        (Flat(value=(0.0, 1.0)), ShapeError, r"command 'number' has shape \(\)"),
    ):
        with pytest.raises(error, match=match):
            environment_of(Commanded(commands=Commands(term)))


def test_a_command_that_is_not_there_or_is_replaced_is_named() -> None:
    environment = environment_of(Commanded())
    with pytest.raises(UnknownNameError, match=r"unknown command 'nubmer'.*did you mean 'number'"):
        environment.commands["nubmer"]
    with pytest.raises(ConfigurationError, match=r"command 'number' was replaced.*env\.commands\['number'\]\[:\]"):
        environment.commands["number"] = torch.zeros(3, 1)
    environment.close()
    with pytest.raises(UnknownNameError, match="unknown command 'goal' in task Lift"):
        make(Lift(commands=None), 1, BACKEND)


def test_a_pose_keeps_to_the_ranges_that_are_given_and_else_to_the_workspace() -> None:
    task = Reach()
    task.commands.goal = UniformPoseCommand(x=(0.4, 0.41), marker="goal")
    environment = environment_of(task, count=16)
    goal = environment.commands["goal"]
    assert ((goal[:, 0] >= 0.4) & (goal[:, 0] <= 0.41)).all()
    assert goal[:, 1].std() > 0.05
    torch.testing.assert_close(environment.world.markers["goal"].pose, goal)
    environment.close()
    assert configure(Reach, {"commands.goal.z": (0.2, 0.3)}).commands.goal.z == (0.2, 0.3)


def test_a_velocity_opens_with_the_difficulty_and_a_heading_is_turned_to() -> None:
    environment = make("Velocity-Flat", 8, BACKEND, curriculum_enabled=True, seed=0)
    assert (environment.commands["velocity"][:, 0].abs() <= 0.25).all(), "a quarter at difficulty 0"
    environment.task.commands.velocity = UniformVelocityCommand(forward=(0.5, 0.5), left=(0.0, 0.0), easy_share=1.0)
    environment.step(torch.zeros(8, environment.action_size))
    environment.reset()
    assert (environment.commands["velocity"][:, 0] == 0.5).all()
    environment.close()
    with pytest.raises(ConfigurationError, match="range 'heading' of command 'velocity' is empty"):
        make("Velocity-Rough", 1, BACKEND, **{"commands.velocity": HeadingVelocityCommand(heading=(1.0, -1.0))})
