"""Plain Python that a step changes is never frozen in silence: the step is refused from capture, or captured again."""

from __future__ import annotations

import random
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from random import gauss
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import _disable_current_modes

from orbit_core.backends import default_backend
from orbit_core.envs import Environment, EventTerm, RewardTerm, TaskState, buffer
from orbit_core.envs.captured_step import CapturedStep
from orbit_core.interfaces import ConfigurationError
from orbit_tasks.reach import Reach

BACKEND = default_backend()
calls = 0


def late(count: float) -> bool:
    return count > 5


def ramp(env: Environment[Counting]) -> Tensor:
    return torch.full((env.num_envs,), float(late(env.state.total)), device=env.device)


def in_a_global(env: Environment[Reach]) -> Tensor:
    global calls
    calls += 1
    return torch.full((env.num_envs,), float(calls))


def in_a_closure() -> Callable[..., Tensor]:
    count = 0

    def term(env: Environment[Reach]) -> Tensor:
        nonlocal count
        count += 1
        return torch.full((env.num_envs,), float(count))

    return term


def in_a_default(env: Environment[Reach], counts: list[int] = []) -> Tensor:  # noqa: B006 - what users write
    counts.append(1)
    return torch.full((env.num_envs,), float(len(counts)))


def in_an_attribute_of_the_function(env: Environment[Reach]) -> Tensor:
    term: Any = in_an_attribute_of_the_function
    term.count = getattr(term, "count", 0) + 1
    return torch.full((env.num_envs,), float(term.count))


class InAnObject:
    total = 0

    def __init__(self, where: str) -> None:
        self.where, self.count, self.seen = where, 0, {"steps": [0]}
        self.array, self.rng, self.random = np.zeros(2), np.random.default_rng(0), random.Random(0)

    def __call__(self, env: Environment[Reach]) -> Tensor:
        return torch.full((env.num_envs,), float(getattr(self, self.where)()))

    def attribute(self) -> int:
        self.count += 1
        return self.count

    def nested(self) -> int:
        self.seen["steps"][0] += 1
        return self.seen["steps"][0]

    def of_the_class(self) -> int:
        InAnObject.total += 1
        return InAnObject.total

    def in_an_array(self) -> float:
        self.array[0] += 1.0
        return self.array[0]

    def drawn_by_numpy(self) -> float:
        return self.rng.uniform()

    def drawn_by_python(self) -> float:
        return self.random.random()


def drawn_globally(env: Environment[Reach]) -> Tensor:
    return torch.full((env.num_envs,), random.random())


def drawn_by_numpy_globally(env: Environment[Reach]) -> Tensor:
    return torch.full((env.num_envs,), np.random.uniform())  # noqa: NPY002 - what users write


def drawn_by_a_function(env: Environment[Reach]) -> Tensor:
    return torch.full((env.num_envs,), gauss(0.0, 1.0))


def as_numpy(env: Environment[Reach]) -> Tensor:
    return torch.from_numpy(env.commands["goal"].numpy()[:, 0] * 2.0)


def as_a_list(env: Environment[Reach]) -> Tensor:
    return torch.tensor(env.commands["goal"][:, 0].tolist())


def as_an_array(env: Environment[Reach]) -> Tensor:
    return torch.as_tensor(np.asarray(env.commands["goal"])[:, 0] + 1.0)


@dataclass
class One:
    """A reward that changes in Python."""

    term: RewardTerm | None = None


class Count(TaskState):
    """Counts its steps in plain Python, as mjlab's and Isaac Lab's environments do."""

    total: Any = 0

    def update(self, env: Environment) -> None:
        self.total += 1


class CountInATensor(TaskState):
    """Counts its steps in a tensor."""

    total: Tensor = buffer(keep=True)

    def update(self, env: Environment) -> None:
        self.total += 1


@dataclass(kw_only=True)
class Limited(Reach):
    """Reach with one reward, and a field that it may read."""

    rewards: One = field(default_factory=One)
    limit: float = 1.0


@dataclass(kw_only=True)
class Counting(Limited):
    """Counts its steps in plain Python."""

    state_type: ClassVar[type[TaskState]] = Count
    rewards: One = field(default_factory=lambda: One(RewardTerm(ramp, 50.0)))


def captured(task: Reach, whole: bool = True) -> Environment:
    environment = Environment(task, 2, BACKEND)
    environment._closed = CapturedStep(environment, compile=False, whole=whole)
    return environment


def rewards_of(environment: Environment, steps: int = 8) -> list[float]:
    action = torch.zeros(2, environment.action_size)
    return [float(environment.step(action)[1][0]) for _ in range(steps)]


def line_of(text: str) -> int:
    with open(__file__) as file:
        return next(number for number, line in enumerate(file, 1) if text in line)


def test_a_counter_of_the_state_is_refused_by_name_and_counts_without_capture() -> None:
    environment = Environment(Counting(), 2, BACKEND)
    with pytest.raises(ConfigurationError, match=r"state 'total' of Count was set to 1.*total: Tensor = buffer\(\)"):
        rewards_of(environment, 1)
    environment.close()
    plain = Environment(Counting(), 2, BACKEND, capture=False)
    assert rewards_of(plain) == [0.0] * 5 + [pytest.approx(50.0 * plain.step_dt)] * 3
    plain.close()


@pytest.mark.parametrize(
    ("term", "name"),
    [
        (in_a_global, "calls"),
        (in_a_closure(), "count"),
        (in_a_default, "counts"),
        (in_an_attribute_of_the_function, "count"),
        (partial(InAnObject("attribute")), "count"),
        (InAnObject("nested"), "steps"),
        (InAnObject("of_the_class"), r"InAnObject\.total"),
        (InAnObject("in_an_array"), "array"),
        (InAnObject("drawn_by_numpy"), "rng"),
        (InAnObject("drawn_by_python"), "random"),
        (drawn_globally, "random"),
        (drawn_by_numpy_globally, "np"),
        (drawn_by_a_function, "gauss"),
        (as_numpy, r"Tensor\.numpy"),
        (as_a_list, r"Tensor\.tolist"),
        (as_an_array, r"Tensor\.(numpy|__array__)"),
    ],
)
def test_python_of_every_kind_in_a_term_is_refused(term: Callable[..., Tensor], name: str) -> None:
    environment = captured(Reach(rewards=One(RewardTerm(term, 1.0))))
    with pytest.warns(RuntimeWarning, match=rf"each step waits for the device: .*({name})"):
        seen = rewards_of(environment)
    if "numpy" not in name and "tolist" not in name:
        assert len(set(seen)) == len(seen), "each step has its own value"
    environment.close()


def reads_constants_outside_of_the_trace(env: Environment[Reach]) -> Tensor:
    with _disable_current_modes():  # as a law does that is made one kernel
        share = torch.full((3,), 0.5).tolist()[0]
    return env.commands["goal"][:, 0] * share


def test_constants_that_are_read_outside_of_the_trace_are_taken() -> None:
    environment = captured(Reach(rewards=One(RewardTerm(reads_constants_outside_of_the_trace, 1.0))))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rewards_of(environment)
    environment.close()


def test_a_counter_in_a_reset_event_is_refused() -> None:
    counts = {"episodes": 0}

    def count(env: Environment[Reach], env_ids: Tensor) -> None:
        counts["episodes"] += 1

    task = Reach(episode_length=0.2)
    task.events.place_robot = EventTerm(count)
    environment = captured(task, whole=False)
    with pytest.warns(RuntimeWarning, match=r"episodes.*changes in Python"):
        rewards_of(environment, environment.max_episode_steps + 2)
    environment.close()


def test_a_counter_is_refused_from_a_compiled_step_with_the_remedy() -> None:
    environment = captured(Reach(rewards=One(RewardTerm(in_a_closure(), 1.0))))
    environment._compile = True
    with pytest.raises(ConfigurationError, match=r"cannot be compiled: .*count.*leave compile out"):
        rewards_of(environment)
    environment.close()
    with pytest.raises(ConfigurationError, match="compile=True needs the step to be captured"):
        Environment(Counting(), 1, BACKEND, compile=True, capture=False)


def test_a_counter_in_a_tensor_is_captured() -> None:
    @dataclass(kw_only=True)
    class InATensor(Limited):
        state_type: ClassVar[type[TaskState]] = CountInATensor

    task = InATensor(rewards=One(RewardTerm(lambda env: (env.state.total > 5).float(), 50.0)))
    environment = captured(task)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        assert rewards_of(environment) == [0.0] * 5 + [pytest.approx(50.0 * environment.step_dt)] * 3
    assert environment._closed is not None
    environment.close()


def test_what_is_set_between_steps_acts_at_the_next_captured_one() -> None:
    term = RewardTerm(lambda env: torch.full((2,), env.task.limit), 1.0)
    environment = captured(Limited(rewards=One(term)))
    assert rewards_of(environment, 4) == [pytest.approx(environment.step_dt)] * 4
    environment.task.limit = 3.0
    assert rewards_of(environment, 2) == [pytest.approx(3.0 * environment.step_dt)] * 2
    other = replace(environment.task.rewards.term, function=lambda env: torch.full((2,), 7.0))
    environment.task.rewards.term = other
    assert rewards_of(environment, 2) == [pytest.approx(7.0 * environment.step_dt)] * 2
    assert environment._closed is not None, "the step is still captured"
    environment.close()


def test_what_changes_between_all_steps_is_named() -> None:
    environment = captured(Limited(rewards=One(RewardTerm(lambda env: torch.zeros(2), 1.0))))

    def change_at_each_step() -> None:
        for number in range(10):
            environment.task.limit = float(number)
            rewards_of(environment, 1)

    with pytest.warns(RuntimeWarning, match=r"Limited\.limit.*changes between steps, 8 times"):
        change_at_each_step()
    environment.close()


def test_what_is_looked_up_at_first_use_is_captured_by_the_next_trace() -> None:
    found: dict[str, list[int]] = {}

    def lazy(env: Environment[Reach]) -> Tensor:
        if not found:
            found["count"] = [env.num_envs]
        return torch.zeros(2)

    environment = captured(Reach(rewards=One(RewardTerm(lazy, 1.0))))
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        rewards_of(environment, 5)
    assert environment._closed is not None
    assert environment._closed.parts[0].ready
    environment.close()
