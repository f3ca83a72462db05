"""A task's configuration is read while it runs: what is set acts at the next step, captured or not, or is refused."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
import torch
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_core.envs import (
    Environment,
    EventTerm,
    EventTime,
    ModifyTerm,
    ObservationTerm,
    PremiseTerm,
    RewardTerm,
    TerminationTerm,
)
from orbit_core.envs.captured_step import CapturedStep
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.mdp import randomize
from orbit_core.mdp.randomize import Range
from orbit_tasks.handover import RECEIVER, Handover
from orbit_tasks.lift import Lift, LiftEvents
from orbit_tasks.reach import Reach, ReachRewards

BACKEND = default_backend()


def one(env: Environment) -> Tensor:
    return torch.ones(env.num_envs, device=env.device)


def two(env: Environment) -> Tensor:
    return 2.0 * one(env)


def nothing(env: Environment, env_ids: Tensor) -> None:
    pass


@dataclass
class Rewards:
    """One that is easy to foretell."""

    one: RewardTerm | None = RewardTerm(one, 1.0)


@dataclass
class Curriculum:
    """What the tests put in."""

    term: Any = None
    other: Any = None


UNIT = Range(0.0, 1.0)


@dataclass(kw_only=True)
class Plain(Reach):
    """Reach with a constant reward."""

    rewards: Rewards = field(default_factory=Rewards)
    reach: Range = UNIT


@dataclass
class PushedEvents(LiftEvents):
    """The cube is pushed at each step."""

    push: EventTerm | None = EventTerm(randomize.push("cube", Range(0.0, 0.0)), EventTime.INTERVAL, (0.02, 0.02))


def environment_of(task: Any, captured: bool) -> Environment:
    environment = Environment(task, 2, BACKEND)
    if captured:
        environment._closed = CapturedStep(environment, compile=False, whole=True)
    return environment


def step(environment: Environment, times: int = 1) -> float:
    """The last reward, for each second."""
    for _ in range(times):
        reward = environment.step(torch.zeros(2, environment.action_size))[1]
    return round(float(reward[0]) / environment.step_dt, 4)


@pytest.fixture(params=[False, True], ids=["eager", "captured"])
def plain(request: pytest.FixtureRequest) -> Iterator[Environment]:
    environment = environment_of(Plain(), request.param)
    step(environment, 3)
    yield environment
    assert (environment._closed is not None) == request.param, "a captured step stays captured"
    environment.close()


def test_a_weight_set_acts_at_the_next_step(plain: Environment) -> None:
    for weight in (30.0, 2, -1.5):
        plain.task.rewards.one.weight = weight
        assert step(plain) == weight
    assert float(plain.reward_sums[0, 0]) == pytest.approx((3.0 + 30.0 + 2.0 - 1.5) * plain.step_dt)


def test_a_weight_set_is_not_captured_again(plain: Environment) -> None:
    replays = [f.replay for part in (plain._closed.parts if plain._closed else ()) for f in part.functions]
    plain.task.rewards.one.weight = 3.0
    assert step(plain) == 3.0
    assert replays == [f.replay for part in (plain._closed.parts if plain._closed else ()) for f in part.functions]


def test_a_term_and_a_collection_replaced_act_at_the_next_step(plain: Environment) -> None:
    plain.task.rewards.one = RewardTerm(two, 2.0)
    assert step(plain) == 4.0
    plain.task.rewards.one.function = one
    assert step(plain) == 2.0
    plain.task.rewards = Rewards()
    assert step(plain) == 1.0


@pytest.mark.parametrize("captured", [False, True])
def test_each_agents_sum_takes_the_new_weights(captured: bool) -> None:
    environment = environment_of(Handover(), captured)
    for name, term in vars(environment.task.rewards).items():
        if term is not None:
            setattr(environment.task.rewards, name, replace(term, weight=0.0))
    step(environment, 3)
    environment.task.rewards.lift.weight = 7.0
    environment.task.rewards.lift.function = one
    environment.task.rewards.receiver_reach.weight = 2.0
    environment.task.rewards.receiver_reach.function = lambda env, agent: one(env)
    assert step(environment) == 9.0
    rewards = environment.multi_agent.rewards()  # pyright: ignore[reportOptionalMemberAccess]
    earned = {agent: round(float(value[0]) / environment.step_dt, 4) for agent, value in rewards.items()}
    assert earned == {agent: 9.0 if agent == RECEIVER else 7.0 for agent in earned}
    environment.close()


@pytest.mark.parametrize("wrong", ["much", None, float("nan"), True, torch.ones(1)])
def test_a_weight_that_is_no_number_is_named(wrong: Any) -> None:
    environment = environment_of(Plain(), False)
    environment.task.rewards.one.weight = wrong
    with pytest.raises(ConfigurationError, match="the weight of reward term 'one' must be a finite number"):
        step(environment)
    environment.close()


def test_a_default_shared_by_all_tasks_cannot_be_set() -> None:
    task = Reach()
    with pytest.raises(ConfigurationError, match=r"ReachRewards\.\w+ is the default of every task.*replace"):
        next(iter(vars(task.rewards).values())).weight = 3.0
    own = copy.deepcopy(task)
    next(iter(vars(own.rewards).values())).weight = 3.0
    assert next(iter(vars(ReachRewards()).values())).weight != 3.0


def test_terms_that_cannot_change_any_more_are_refused() -> None:
    def refused(change: Any, match: str, task: Any = None) -> None:
        environment = environment_of(task or Plain(), False)
        change(environment.task)
        with pytest.raises(ConfigurationError, match=match):
            step(environment)
        environment.close()

    def set_to(**values: Any) -> Any:
        return lambda task: [setattr(task, name, value) for name, value in values.items()]

    refused(lambda t: setattr(t.rewards, "one", None), "'one' was there when.*set its weight to 0")
    refused(set_to(rewards=ReachRewards()), "reward term 'one' was there")
    refused(set_to(episode_length=1.0), "field 'episode_length'.*make another")
    refused(set_to(decimation=1), "field 'decimation'")
    refused(lambda t: setattr(t.observations.policy, "joint_positions", None), "group 'policy' has other terms")
    refused(lambda t: setattr(t.observations.policy.joint_positions, "history", 3), "group 'policy' has other")
    refused(lambda t: setattr(t.observations.policy.joint_positions, "delay", (1, 2)), "the delay of .*joint_pos")
    late = Plain()
    late.events.place_robot = EventTerm(nothing, EventTime.STARTUP)
    refused(
        lambda t: setattr(t.events.place_robot, "function", lambda env, env_ids: None),
        "STARTUP was changed after",
        late,
    )


def test_terminations_events_and_observations_follow(plain: Environment) -> None:
    before = plain.observe()["policy"].clone()
    plain.task.observations.policy.joint_positions.scale = 0.0
    plain.task.observations.policy.joint_velocities.noise_std = 0.5
    plain.task.events.place_robot.function = lambda env, env_ids: env.state.action_before.fill_(7.0)
    observation, *_ = plain.step(torch.zeros(2, plain.action_size))
    columns = plain.observation["policy"].columns
    assert not observation["policy"][:, columns["joint_positions"]].any()
    assert (observation["policy"] - before)[:, columns["joint_velocities"]].abs().max() > 0.1
    plain.reset()
    assert (plain.state.action_before == 7.0).all(), "the event's new function ran"


def test_an_interval_and_a_range_hold_from_the_next_draw_on() -> None:
    task = Lift(events=PushedEvents())
    for captured in (False, True):
        environment = environment_of(task, captured)
        step(environment, 3)
        environment.task.events.push.function = randomize.push("cube", Range(5.0, 5.0))
        step(environment)
        assert environment.world.objects["cube"].root_velocity[:, :2].norm(dim=1).min() > 2.0
        environment.task.events.push.interval = (0.5, 0.2)
        with pytest.raises(ConfigurationError, match="interval of event 'push'"):
            step(environment)
        environment.close()


@pytest.mark.parametrize("captured", [False, True])
def test_a_curriculum_changes_weights_ranges_and_fields(captured: bool) -> None:
    weight = ModifyTerm("rewards.one.weight", lambda steps, value: 10.0 if steps >= 4 else value)
    high = ModifyTerm("reach.high", lambda steps, value: 5.0 if steps >= 6 else value)
    task = Plain(curriculum=Curriculum(weight, high), curriculum_enabled=True)
    task.rewards.one = RewardTerm(lambda env: env.task.reach.high * one(env), 1.0)
    environment = environment_of(task, captured)
    assert [step(environment) for _ in range(8)] == [1.0] * 4 + [10.0] * 2 + [50.0] * 2
    assert float(environment.state.difficulty.min()) == 1.0, "no term sets the difficulty"
    assert "difficulty" not in environment.metrics()
    assert (environment._closed is not None) == captured
    environment.close()


def test_a_curriculum_is_held_to_what_there_is() -> None:
    for address, error, match in (
        ("rewards.won.weight", UnknownNameError, "did you mean 'one'"),
        ("rewards.one.wait", UnknownNameError, "did you mean 'weight'"),
        ("episode_lenght", UnknownNameError, "did you mean 'episode_length'"),
    ):
        term = ModifyTerm(address, lambda steps, value: value)
        with pytest.raises(error, match=match):
            Environment(Plain(curriculum=Curriculum(term), curriculum_enabled=True), 1, BACKEND)
    fixed = ModifyTerm("episode_length", lambda steps, value: 1.0)
    environment = Environment(Plain(curriculum=Curriculum(fixed), curriculum_enabled=True), 2, BACKEND)
    with pytest.raises(ConfigurationError, match="field 'episode_length'"):
        step(environment)
    environment.close()


def test_collections_that_are_none_have_no_terms() -> None:
    task = Reach(rewards=None, terminations=None, events=None, curriculum=None, premises=None)
    task.observations.policy.goal = None
    for captured in (False, True):
        environment = environment_of(task, captured)
        assert step(environment, 3) == 0.0
        assert environment.reward_terms == {}
        environment.close()
    with pytest.raises(ConfigurationError, match="must be a dataclass of ObservationGroup"):
        Environment(Reach(observations=None), 1, BACKEND)


def test_a_premise_and_a_termination_replaced_count() -> None:
    @dataclass
    class Premises:
        good: PremiseTerm | None = PremiseTerm(lambda env: one(env) > 0.0, "never")

    environment = environment_of(Plain(premises=Premises()), True)
    step(environment, 3)
    environment.task.premises.good.function = lambda env: one(env) < 0.0
    ended = TerminationTerm(lambda env: one(env) > 0.0)
    environment.task.terminations = _ends(ended)
    *_, terminated, _, _ = environment.step(torch.zeros(2, environment.action_size))
    assert terminated.all()
    assert not environment.metrics()["premise_good"].any()
    environment.close()


def _ends(term: TerminationTerm) -> Any:
    @dataclass
    class Ends:
        now: TerminationTerm | None = term

    return Ends()


def test_a_bias_that_is_new_is_drawn(plain: Environment) -> None:
    term: ObservationTerm = plain.task.observations.policy.joint_positions
    term.bias_std = 1.0
    columns = plain.observation["policy"].columns["joint_positions"]
    before = plain.observe()["policy"][:, columns]
    step(plain)
    biased = plain.observe()["policy"][:, columns]
    assert (biased - before).abs().max() > 0.1
    step(plain)
    assert (plain.observe()["policy"][:, columns] - biased).abs().max() < 0.1, "kept through the episode"
