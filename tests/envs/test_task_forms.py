"""Tasks and terms of the form that they had when a task held its state are refused with the new names."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import pytest
import torch
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_core.envs import (
    Environment,
    EventTerm,
    ModifyTerm,
    ObservationTerm,
    RewardTerm,
    Task,
    TaskState,
    TerminationTerm,
    buffer,
    make,
)
from orbit_core.envs.captured_step import remembered
from orbit_core.envs.configuration import configure
from orbit_core.interfaces import ConfigurationError
from orbit_tasks.lift import Lift
from orbit_tasks.reach import Reach
from orbit_tasks.velocity_flat import VelocityFlat

BACKEND = default_backend()


def old(world: Any, task: Any) -> Tensor:
    return torch.zeros(world.num_envs)


def old_event(world: Any, task: Any, env_ids: Tensor) -> None:
    pass


@pytest.mark.parametrize(
    ("path", "term", "match"),
    [
        (
            "rewards.position",
            RewardTerm(old, 1.0),
            r"ReachRewards\.position takes \(world, task\).*\(env\): the world is",
        ),
        ("rewards.position", RewardTerm(lambda env: 0, 1.0, "robot"), r"takes \(env\), but .* with \(env, agent\)"),
        ("rewards.position", RewardTerm(3.0, 1.0), r"function of term ReachRewards\.position is 3\.0, which cannot be"),  # pyright: ignore[reportArgumentType]
        (
            "events.masses",
            EventTerm(old_event),
            r"ReachEvents\.masses takes \(world, task, env_ids\).*\(env, env_ids\)",
        ),
        ("observations.policy.goal", ObservationTerm(old), r"ReachState\.goal takes \(world, task\).*env\.state"),
    ],
)
def test_a_term_of_another_signature_is_named_with_the_arguments_that_it_takes(
    path: str, term: Any, match: str
) -> None:
    task = Reach()
    *above, name = path.split(".")
    owner: Any = task
    for part in above:
        owner = getattr(owner, part)
    setattr(owner, name, term)
    with pytest.raises(ConfigurationError, match=match):
        make(task, 1, BACKEND)


def test_terminations_and_curricula_of_another_signature_are_named() -> None:
    @dataclass
    class Ends:
        over: TerminationTerm | None = TerminationTerm(old)

    @dataclass
    class Course:
        weight: ModifyTerm | None = ModifyTerm("rewards.position.weight", lambda steps: 1.0)  # pyright: ignore[reportArgumentType]

    with pytest.raises(ConfigurationError, match=r"Ends\.over takes \(world, task\)"):
        make(Reach(terminations=Ends()), 1, BACKEND)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ConfigurationError, match=r"Course\.weight takes \(steps\), but .* \(steps, value\)"):
        make(Reach(curriculum=Course(), curriculum_enabled=True), 1, BACKEND)


@pytest.mark.parametrize(
    ("members", "match"),
    [
        ({"start": lambda self, world: None}, r"'start', which is now TaskState\.start\(env\)"),
        ({"advance": lambda self, world: None}, r"'advance', which is now TaskState\.update\(env\)"),
        ({"reset": lambda self, env_ids: None}, r"'reset', which is now TaskState\.reset"),
        ({"subtasks": lambda self: ()}, r"'subtasks', which is now metadata\.subtasks"),
        ({"expert_success": 0.5}, r"'expert_success', which is now metadata\.expert_success"),
        ({"__annotations__": {"ppo": "PpoSettings"}}, r"'ppo', which is now metadata\.ppo"),
        (
            {"goal": field(init=False)},
            r"'goal' of task Old has init=False.*goal: Tensor = buffer\(\).*env\.state\.goal",
        ),
        ({"success": lambda self, world: None}, r"success\(self, world\) of task Old is now success\(self, env\)"),
        ({"expert": lambda self, world: None}, r"expert\(self, world\) of task Old is now expert\(self, env\)"),
    ],
)
def test_a_task_of_the_old_form_is_refused_where_it_is_written(members: dict[str, Any], match: str) -> None:
    with pytest.raises(ConfigurationError, match=match):
        type("Old", (Reach,), {"__module__": __name__, **members})


def test_a_task_takes_no_attribute_that_is_no_field() -> None:
    task = Reach()
    with pytest.raises(ConfigurationError, match=r"task Reach has no field 'count'.*count: Tensor = buffer\(\)"):
        task.count = 0  # pyright: ignore[reportAttributeAccessIssue]
    environment = make(VelocityFlat(), 1, BACKEND)
    for name, told in (
        ("goal", "has no attribute 'goal'"),
        ("velocity", r"is a command: env\.commands\['velocity'\]"),
        ("errors", r"is state: env\.state\.errors"),
        ("episode_step", r"is now env\.state\.episode_step"),
        ("generators", r"is now env\.actions\.generators"),
        ("view", r"is now metadata\.view"),
    ):
        with pytest.raises(AttributeError, match=told):
            getattr(environment.task, name)
    environment.close()


@pytest.mark.parametrize(
    ("task", "path", "now"),
    [
        (Reach, "ppo.learning_rate", "metadata.ppo.learning_rate"),
        (Lift, "events.sample_goal", "commands.goal"),
        (VelocityFlat, "max_forward", "commands.velocity.forward"),
        (VelocityFlat, "events.sample_command.interval", "commands.velocity.interval"),
    ],
)
def test_a_field_set_by_its_old_path_is_refused_with_the_new_one(task: type[Task], path: str, now: str) -> None:
    with pytest.raises(ConfigurationError, match=f"field '{path}' of task {task.__name__} is now '{now}'"):
        configure(task, {path: 1.0})


class Sums(TaskState):
    """A sum and a count."""

    total: Tensor = buffer(2)
    best: Tensor = buffer(initial=torch.inf)
    kept: Tensor = buffer(dtype=torch.int64, keep=True)

    def update(self, env: Environment) -> None:
        self.total += 1.0
        self.best.copy_(torch.minimum(self.best, self.total[:, 0]))
        self.kept += 1


@dataclass(kw_only=True)
class Summing(Reach):
    """Reach that sums."""

    state_type = Sums


def test_state_is_allocated_per_environment_and_reset_where_episodes_begin() -> None:
    environment = make(Summing(), 3, BACKEND)
    state = environment.state
    assert (state.total.shape, state.best.shape, state.kept.dtype) == ((3, 2), (3,), torch.int64)
    for _ in range(4):
        environment.step(torch.zeros(3, environment.action_size))
    environment.reset(env_ids=torch.tensor([1]))
    assert state.total[:, 1].tolist() == [4.0, 0.0, 4.0]
    assert state.best.tolist() == [1.0, math_inf, 1.0]
    assert state.kept.tolist() == [4, 4, 4]
    assert state.episode_step.tolist() == [4, 0, 4]
    assert {"total", "best", "last_action"} <= {*state.memory()}
    assert {"['Summing']['total']", "['Summing']['goal']"} <= {*remembered(environment)}, (
        "captures and recordings keep it"
    )
    environment.close()


math_inf = float("inf")


def test_a_state_tensor_that_is_replaced_is_named_and_one_that_is_written_is_not() -> None:
    environment = make(Summing(), 2, BACKEND)
    environment.state.total += 1.0
    environment.state.total[:] = 2.0
    with pytest.raises(ConfigurationError, match=r"state 'total' of Sums was replaced.*env\.state\.total\[:\] = "):
        environment.state.total = environment.state.total + 1.0
    with pytest.raises(ConfigurationError, match=r"state 'total' of Sums is a tensor, and was set to 0"):
        environment.state.total = 0.0  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(
        ConfigurationError, match=r"state 'calls' of Sums was set to 1 while.*calls: Tensor = buffer\(\)"
    ):
        environment.state.calls = 1
    environment.close()
