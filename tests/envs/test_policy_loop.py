"""Steps by a policy in one recording: the same as the policy, the step and what is kept, called one by one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_core.envs import Environment
from orbit_core.envs.captured_step import CapturedStep, StepResult
from orbit_core.envs.observation_layout import Observation
from orbit_core.envs.policy_loop import PolicyLoop
from orbit_learn.ends import EpisodeTally
from tests.envs.test_captured_step import lift
from tests.envs.test_step_path import slow

BACKEND = default_backend()
STEPS = 26


class Kept:
    """A policy with noise, and what a learner would keep, at a place that the device counts."""

    def __init__(self, environment: Environment) -> None:
        count, size, seen = environment.num_envs, environment.action_size, environment.observation_size
        generator = torch.Generator().manual_seed(0)
        self.weights = 0.3 * torch.randn(seen, size, generator=generator)
        self.noise = torch.randn(STEPS, count, size, generator=generator)
        self.seen, self.reward = torch.zeros(STEPS, count, seen), torch.zeros(STEPS, count)
        self.ended = torch.zeros(STEPS, count, dtype=torch.bool)
        self.place = torch.zeros(1, dtype=torch.int64)
        self.tally = EpisodeTally(environment.device)
        self.count, self.calls = count, 0

    def act(self, observation: Observation) -> Tensor:
        seen: Any = observation["policy"]
        self.seen.index_copy_(0, self.place, seen[None])
        return torch.tanh(seen @ self.weights) + self.noise.index_select(0, self.place)[0]

    def keep(self, result: StepResult) -> None:
        self.calls += 1
        _, reward, terminated, truncated, info = result
        self.reward.index_copy_(0, self.place, reward[None])
        self.ended.index_copy_(0, self.place, (terminated | truncated)[None])
        self.tally.add(info, self.count)
        self.place.add_(1)


def as_on_a_gpu(environment: Environment) -> Environment:
    """A step whose resets are in it, and whose numbers the host does not look at."""
    environment._closed = CapturedStep(environment, compile=False, whole=True)
    environment._checks = False
    return environment


def lives(environment: Environment, between: Callable[[Environment, int], None]) -> tuple[Kept, PolicyLoop]:
    environment.reset(seed=5)
    kept = Kept(environment)
    loop = PolicyLoop(environment, kept.act, kept.keep)
    for step in range(STEPS):
        between(environment, step)
        environment.step_by(loop)
    return kept, loop


def nothing(environment: Environment, step: int) -> None:
    """Leave the environment alone."""


def another_seed(environment: Environment, step: int) -> None:
    """Reset between steps."""
    if step == 15:
        environment.reset(seed=9)


def another_weight(environment: Environment, step: int) -> None:
    """Change a weight, which a tensor holds, and the noise of a term, which a captured step has taken as it was."""
    if step == 12:
        environment.task.rewards.reach.weight = 3.0
        environment.task.observations.policy.cube_pose.noise_std = 0.02


@pytest.mark.parametrize("between", [nothing, another_seed, another_weight])
@pytest.mark.parametrize("make", [lambda: Environment(lift(), 4, BACKEND), lambda: slow(3)], ids=["Lift", "phases"])
def test_steps_in_one_recording_are_the_same(
    make: Callable[[], Environment], between: Callable[[Environment, int], None]
) -> None:
    plain, other = make(), as_on_a_gpu(make())
    (mine, _), (its, loop) = lives(plain, between), lives(other, between)
    assert loop._composed is not None
    assert mine.calls == its.calls == STEPS
    assert mine.ended.any()
    assert torch.equal(mine.ended, its.ended)
    torch.testing.assert_close(its.seen, mine.seen, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(its.reward, mine.reward, rtol=1e-4, atol=1e-6)
    assert its.tally.read() == pytest.approx(mine.tally.read(), rel=1e-4)
    assert its.tally.metrics == pytest.approx(mine.tally.metrics, rel=1e-3, abs=1e-5)
    torch.testing.assert_close(other.observe(), plain.observe(), rtol=1e-4, atol=1e-5)
    assert other.steps == plain.steps == STEPS
    plain.close(), other.close()
