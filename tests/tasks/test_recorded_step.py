"""A step that an engine records is the step that it does not."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from orbit_core.tasks import make
from orbit_core.tasks.environment import Environment
from orbit_core.tasks.recording import RecordedStep, needs_python


def recorded(environment: Environment) -> Environment:
    parts = (environment.world, environment.task, environment._cut)
    environment._recorded = RecordedStep(*parts, environment._advance, environment._compute_observation)
    return environment


def test_a_recorded_step_is_the_same_step() -> None:
    plain, other = make("Lift", 3, "mujoco", seed=1), recorded(make("Lift", 3, "mujoco", seed=1))
    generator = torch.Generator().manual_seed(0)
    for step in range(plain.max_episode_steps + 5):
        action = 4 * torch.rand(3, plain.action_size, generator=generator) - 2
        (mine, *ours, _), (its, *theirs, _) = plain.step(action), other.step(action)
        for own, its_own in zip((mine["policy"], *ours), (its["policy"], *theirs), strict=True):
            assert torch.equal(own, its_own), step
    assert plain.world.clock.steps == other.world.clock.steps
    plain.close()
    other.close()


def test_a_failed_recording_is_begun_again() -> None:
    """An engine that stops in the midst of recording and calls the operations once more, as Engine.record allows."""
    plain, other = make("Lift", 2, "mujoco", seed=1), make("Lift", 2, "mujoco", seed=1)

    def record(operations: Callable[[], None]) -> Callable[[], None]:
        def run() -> None:
            saved, steps = other.world.save_state(), other.task.episode_step.clone()
            last_action = other.task.last_action.clone()
            operations()
            other.world.load_state(saved)  # what was recorded has not happened
            other.task.episode_step.copy_(steps)
            other.task.last_action.copy_(last_action)
            operations()

        return run

    other.world.engine.record = record
    recorded(other)
    action = torch.full((2, plain.action_size), 0.3)
    for _ in range(5):
        ours, theirs = plain.step(action)[0]["policy"], other.step(action)[0]["policy"]
        assert torch.equal(ours, theirs)
    assert other.world.clock.steps == plain.world.clock.steps
    assert other._cut.graph.step_count == plain._cut.graph.step_count
    plain.close()
    other.close()


@pytest.mark.parametrize(("task", "reason"), [("Lift", ""), ("Reach", ""), ("Velocity-Flat", "sensor 'contacts'")])
def test_what_needs_python_is_named(task: str, reason: str) -> None:
    environment = make(task, 1, "mujoco")
    assert needs_python(environment.world, environment.task, environment._cut)[: len(reason)] == reason
    assert bool(needs_python(environment.world, environment.task, environment._cut)) == bool(reason)
    environment.close()
