"""Tasks run unchanged on a world that is no simulation: recorded states, played back."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor
from torch.utils._pytree import tree_leaves

from orbit_core.envs import Environment, make
from orbit_core.interfaces import ConfigurationError, UnknownNameError, UnsupportedCapabilityError
from tests.world.playback import Recording

STEPS = 12
TASKS = ("Lift", "Velocity-Flat")


def rollout(environment: Environment, action: Callable[[], Tensor], seen: Callable[[], None]) -> list[Tensor]:
    """Observations, rewards, ends, metrics and success of some steps, one after another."""
    found = [leaf.clone() for leaf in tree_leaves(environment.observe())]
    seen()
    for _ in range(STEPS):
        observation, reward, terminated, _, _ = environment.step(action())
        seen()
        task, world = environment.task, environment.world
        told = (observation, reward, terminated, task.metrics(environment), task.success(environment), world.link_poses)
        found += [leaf.clone() for leaf in tree_leaves(told)]
    return found


@pytest.mark.parametrize("name", TASKS)
def test_a_task_sees_in_a_recording_what_it_saw_when_it_was_made(name: str) -> None:
    original = make(name, 2, "mujoco", seed=3)
    recording = Recording(original.task.decimation)
    actions = torch.rand(STEPS, 2, original.action_size, generator=torch.manual_seed(0)) * 0.4 - 0.2
    live = iter(actions)
    expected = rollout(original, lambda: next(live), lambda: recording.add(original.world))
    assert not original.done.any()  # an episode's end would go back to the first frame
    original.close()

    played = make(name, 2, seed=3, world=recording)
    same = iter(actions)
    found = rollout(played, lambda: next(same), lambda: None)
    assert len(found) == len(expected) > 5 * STEPS
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-5)


def test_commands_to_a_recording_have_no_effect() -> None:
    original = make("Lift", 1, "mujoco")
    recording = Recording(original.task.decimation)
    zeros = torch.zeros(1, original.action_size)
    rollout(original, lambda: zeros, lambda: recording.add(original.world))
    original.close()
    played = make("Lift", 1, world=recording)
    states = []
    for action in (zeros, zeros + 1.0):
        played.reset()
        played.step(action)
        states.append(played.world.link_poses.clone())
    assert torch.equal(*states)


def test_what_a_recording_cannot_do_says_so() -> None:
    original = make("Lift", 1, "mujoco")
    recording = Recording(original.task.decimation)
    recording.add(original.world)
    original.close()
    world = make("Lift", 1, world=recording).world
    assert world.build_report == ()
    for use, what in (
        (lambda: world.engine, "engine"),
        (world.save_state, "snapshots"),
        (lambda: world.create_renderer(()), "renderer"),
        (lambda: world.set_gravity(torch.zeros(1, 3)), "gravity to set"),
        (lambda: world.add_servo(lambda: None), "servos at the physics rate"),
        (lambda: world.copy_state(0), "states to copy"),
    ):
        with pytest.raises(UnsupportedCapabilityError, match=f"this world has no {what}: PlaybackWorld"):
            use()
    with pytest.raises(UnsupportedCapabilityError, match="'robot' has no masses to set"):
        world.robots["robot"].set_masses(torch.ones(1, 1))


def test_a_world_of_ones_own_takes_no_backend() -> None:
    with pytest.raises(ConfigurationError, match="backend and renderer given beside a world of your own"):
        make("Lift", 1, "mujoco", renderer="mujoco", world=Recording(1))


def test_a_name_that_nothing_bears_is_answered_with_what_does() -> None:
    environment = make("Lift", 1, "mujoco")
    world = environment.world
    try:
        for things, name in ((world.robots, "robto"), (world.objects, "cub")):
            nearest = next(iter(things)) if name == "robto" else "cube"
            with pytest.raises(UnknownNameError, match=f"did you mean '{nearest}'"):
                things[name]
        with pytest.raises(UnknownNameError, match=r"'cube' is an object: world.objects\['cube'\]"):
            world.robots["cube"]
        with pytest.raises(ConfigurationError, match=r"world\.robots is read only"):
            world.robots["other"] = world.robots["robot"]  # pyright: ignore[reportIndexIssue]
        assert world.objects.get("cub") is None
    finally:
        environment.close()
