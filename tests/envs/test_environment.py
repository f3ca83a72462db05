"""The vectorised environment: steps, resets, terms, and what it says to bad input."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.envs import Environment, RewardTerm, TerminationTerm, make, task_entries
from orbit_core.envs.terms import once_per_state, terms_of
from orbit_core.interfaces import (
    ArgumentError,
    BackendNotInstalledError,
    ConfigurationError,
    NonFiniteError,
    ShapeError,
    UnknownNameError,
)
from orbit_tasks.lift import Lift, LiftRewards, LiftTerminations
from orbit_tasks.reach import Reach
from orbit_tasks.velocity_flat import VelocityFlat
from orbit_tasks.walking import overspeed

BACKEND = default_backend()


@pytest.fixture(scope="module")
def reach():
    environment = make("Reach", num_envs=3, backend=BACKEND)
    yield environment
    environment.close()


def test_a_step_gives_batched_tensors(reach: Environment) -> None:
    observation, info = reach.reset(seed=0)
    assert info == {}
    assert observation["policy"].shape == (3, reach.observation_size)
    observation, reward, terminated, truncated, info = reach.step(torch.zeros(3, reach.action_size))
    assert observation["policy"].shape == (3, reach.observation_size)
    assert observation["policy"].dtype == torch.float32
    assert reward.shape == terminated.shape == truncated.shape == (3,)
    assert reward.dtype == torch.float32
    assert terminated.dtype == truncated.dtype == torch.bool
    assert info == {}


def test_the_time_limit_truncates_and_begins_anew_in_the_same_step() -> None:
    environment = make("Reach", num_envs=2, backend=BACKEND, episode_length=0.1)
    environment.reset(seed=0)
    action = torch.zeros(2, environment.action_size)
    for _ in range(4):
        _, _, _, truncated, _ = environment.step(action)
        assert not truncated.any()
    observation, _, terminated, truncated, info = environment.step(action)
    assert truncated.all()
    assert not terminated.any()
    end = info["final"]
    assert end.env_ids.tolist() == [0, 1]
    assert end.steps.tolist() == [5, 5]
    assert end.observation["policy"].shape == observation["policy"].shape
    # The new episode has another goal than the last state's observation shows.
    assert not torch.allclose(end.observation["policy"], observation["policy"])
    assert environment.state.episode_step.tolist() == [0, 0]
    environment.close()


@pytest.mark.rotates
@pytest.mark.parametrize("task", list(task_entries()))
def test_an_environment_does_the_same_whatever_their_number(task: str) -> None:
    few, many = (make(task, num_envs=n, backend=BACKEND, seed=3, episode_length=0.2) for n in (2, 5))
    few.reset(seed=3), many.reset(seed=3)
    generator = torch.Generator().manual_seed(0)
    for _ in range(25):
        action = 2.0 * torch.rand(5, many.action_size, generator=generator) - 1.0
        observation_few, reward_few, *_ = few.step(action[:2])
        observation_many, reward_many, *_ = many.step(action)
        torch.testing.assert_close(observation_few["policy"], observation_many["policy"][:2], rtol=0, atol=0)
        # A sum over terms may be ordered otherwise for another number of columns.
        torch.testing.assert_close(reward_few, reward_many[:2], rtol=1e-5, atol=1e-8)
    few.close(), many.close()


def test_a_seed_repeats_and_another_differs(reach: Environment) -> None:
    first, _ = reach.reset(seed=1)
    again, _ = reach.reset(seed=1)
    other, _ = reach.reset(seed=2)
    assert torch.equal(first["policy"], again["policy"])
    assert not torch.equal(first["policy"], other["policy"])


def test_actions_beyond_one_are_clipped(reach: Environment) -> None:
    reach.reset(seed=0)
    reach.step(torch.full((3, reach.action_size), 7.0))
    assert (reach.state.last_action == 1.0).all()


def test_a_nan_action_names_environment_and_component(reach: Environment) -> None:
    action = torch.zeros(3, reach.action_size)
    action[1, 2] = float("nan")
    with pytest.raises(NonFiniteError, match="component 2 of environment 1 is nan"):
        reach.step(action)


def test_a_wrongly_shaped_action_says_both_shapes(reach: Environment) -> None:
    with pytest.raises(ShapeError, match=rf"\(3, {reach.action_size}\).*\(4, 2\)"):
        reach.step(torch.zeros(4, 2))


def test_a_term_is_changed_without_subclassing() -> None:
    task = Reach()
    task.rewards.position = RewardTerm(lambda env: torch.ones(env.num_envs), 3.0)
    for name in ("position_finely", "rotation", "action_rate", "joint_speed"):
        setattr(task.rewards, name, None)
    environment = Environment(task, 2, BACKEND)
    _, reward, *_ = environment.step(torch.zeros(2, environment.action_size))
    torch.testing.assert_close(reward, torch.full((2,), 3.0 * environment.step_dt))
    assert list(environment.reward_terms) == ["position"]
    environment.close()


def test_the_task_given_is_left_as_it_was() -> None:
    task = Lift()
    Environment(task, 1, BACKEND).close()
    assert not hasattr(task, "goal")


def test_a_field_that_is_no_term_is_refused() -> None:
    @dataclass
    class Rewards:
        wrong: object = 3

    with pytest.raises(TypeError, match=r"Rewards\.wrong must be a RewardTerm"):
        terms_of(Rewards(), RewardTerm)


def test_a_cached_term_is_computed_once_per_state(reach: Environment) -> None:
    calls = []

    @once_per_state
    def term(env):
        calls.append(env.world.clock.version)
        return torch.zeros(3)

    reach.reset(seed=0)
    term(reach), term(reach)
    assert len(calls) == 1
    reach.step(torch.zeros(3, reach.action_size))
    term(reach)
    assert len(calls) == 2


def test_a_snapshot_of_the_world_repeats() -> None:
    environment = make("Lift", num_envs=2, backend=BACKEND)
    environment.reset(seed=0)
    action = torch.full((2, environment.action_size), 0.3)
    environment.step(action)
    state = environment.world.save_state()
    cube = environment.world.objects["cube"]

    def rollout() -> torch.Tensor:
        for _ in range(5):
            environment.world.step(4)
        return torch.cat((cube.root_pose, environment.world.robots["robot"].joint_positions), 1).clone()

    first = rollout()
    environment.world.load_state(state)
    assert torch.equal(first, rollout())
    environment.close()


@pytest.mark.parametrize(
    ("keywords", "error", "message"),
    [
        ({"task": "Lfit"}, UnknownNameError, "unknown task 'Lfit'.*'Lift'"),
        ({"robot": "franka"}, UnknownNameError, "unknown robot 'franka'.*'franka_panda'"),
        ({"action": "ik_relativ"}, UnknownNameError, "unknown action space 'ik_relativ'.*'ik_relative'"),
        ({"tolerence": 0.1}, UnknownNameError, "unknown field 'tolerence' in task Lift.*'tolerance'"),
        ({"tolerance": "big"}, ConfigurationError, "field 'tolerance' of task Lift is 'big', but must be a number"),
        ({"episode_length": 0.05}, ConfigurationError, r"no whole number of steps of 0\.02 s.*use 0\.0[46]"),
        ({"physics_dt": 0.0}, ConfigurationError, "physics_dt must be above zero seconds, not 0"),
        ({"physics_dt": -0.005}, ConfigurationError, "physics_dt must be above zero seconds, not -0.005"),
        ({"decimation": 0}, ArgumentError, "decimation must be at least 1, not 0"),
        ({"robot": "anymal_c"}, ConfigurationError, "robot 'anymal_c' has no end effector, which this task needs"),
        ({"task": "Velocity-Flat", "robot": "franka_panda"}, ConfigurationError, "'franka_panda' has no feet"),
        ({"num_envs": 0}, ArgumentError, "num_envs must be at least 1"),
        ({"settings": {"nonsense": 1}}, UnknownNameError, "unknown setting 'nonsense'"),
    ],
)
def test_bad_input_is_one_clear_error(keywords: dict, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        make(**{"task": "Lift", "num_envs": 1, "backend": BACKEND, **keywords})


def test_a_backend_nobody_has_is_named() -> None:
    with pytest.raises((UnknownNameError, BackendNotInstalledError), match="nosuchengine"):
        make("Lift", backend="nosuchengine")


def test_walking_costs_what_joints_are_faster_than_they_can_be() -> None:
    environment = make("Velocity-Flat", num_envs=2, backend=BACKEND)
    task, robot = environment.task, environment.world.robots["robot"]
    assert isinstance(task, VelocityFlat)
    environment.reset(seed=0)
    velocities = torch.zeros(2, len(robot.joints))
    velocities[1, :3] = torch.tensor([7.0, -8.5, 10.0])  # of joints whose limits are 7.5
    robot.set_joint_state(robot.joint_positions, velocities)
    torch.testing.assert_close(overspeed(environment), torch.tensor([0.0, 3.5]))
    environment.close()


@dataclass
class OddRewards(LiftRewards):
    odd: RewardTerm | None = None


@dataclass
class OddTerminations(LiftTerminations):
    odd: TerminationTerm | None = None


@pytest.mark.parametrize(
    ("value", "error", "message"),
    [
        (torch.full((2,), torch.nan), NonFiniteError, "reward term 'odd' is not finite in environments 0, 1"),
        (torch.tensor([0.0, torch.inf]), NonFiniteError, "reward term 'odd' is not finite in environment 1"),
        (torch.zeros(2, 1), ShapeError, r"reward term 'odd' has shape \(2, 1\), but must have \(2,\)"),
        (torch.zeros(3), ShapeError, r"reward term 'odd' has shape \(3,\)"),
        (1.0, ConfigurationError, "reward term 'odd' gives a float"),
        (torch.zeros(2, dtype=torch.complex64), ConfigurationError, "must give real numbers"),
    ],
)
def test_a_reward_that_cannot_be_names_its_term(value: Any, error: type[Exception], message: str) -> None:
    environment = make(Lift(rewards=OddRewards(odd=RewardTerm(lambda env: value, 1.0))), 2, default_backend())
    with pytest.raises(error, match=message):
        environment.step(torch.zeros(2, environment.action_size))


@pytest.mark.parametrize(
    ("value", "error", "message"),
    [
        (torch.zeros(2), ConfigurationError, r"termination term 'odd' gives torch.float32: its function must give"),
        (torch.zeros(2, 1, dtype=torch.bool), ShapeError, r"termination term 'odd' has shape \(2, 1\)"),
        (None, ConfigurationError, "termination term 'odd' gives a NoneType"),
    ],
)
def test_an_end_that_cannot_be_names_its_term(value: Any, error: type[Exception], message: str) -> None:
    terms = OddTerminations(odd=TerminationTerm(lambda env: value))
    environment = make(Lift(terminations=terms), 2, default_backend())
    with pytest.raises(error, match=message):
        environment.step(torch.zeros(2, environment.action_size))


def test_rewards_may_be_of_any_real_kind() -> None:
    term = RewardTerm(lambda env: torch.ones(2, dtype=torch.bool), 50.0)
    environment = make(Lift(rewards=OddRewards(None, None, None, None, None, None, term)), 2, default_backend())
    assert environment.step(torch.zeros(2, environment.action_size))[1].tolist() == [1.0, 1.0]
