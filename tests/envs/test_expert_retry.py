"""An expert goes back where a phase has not done what it should, as often as it may."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

from orbit_core.envs import Environment, make
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp import common
from orbit_motion.experts import Expert, Phase, Retry
from orbit_tasks.mdp import picking


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    made = make("Reach", 3, "mujoco", seed=0)
    yield made
    made.close()


def here(env: Environment) -> Tensor:
    return common.hand_pose(env)


def in_the_first(env: Environment) -> Tensor:
    """(N,) bool: all is well in environment 0 alone."""
    return torch.arange(env.num_envs) == 0


def test_phases_are_done_again_where_they_failed_and_no_oftener_than_told(environment: Environment) -> None:
    phases = (Phase(here), Phase(here, retry=Retry(2, in_the_first, most=2)), Phase(here))
    expert = Expert(environment, phases)
    environment.reset(seed=0)
    seen = []
    for _ in range(8):
        environment.step(expert.compute({})["action"])
        seen.append(expert.phase.clone())
    told = torch.stack(seen, 1).tolist()
    assert told[0] == [1, 2, 2, 2, 2, 2, 2, 2]
    assert told[1] == told[2] == [1, 0, 1, 0, 1, 2, 2, 2]
    expert.reset(torch.tensor([1]))
    assert expert.memory()["tries"][:, 0].tolist() == [0, 0, 2]


@pytest.mark.parametrize(("number", "phases"), [(2, 1), (0, 2), (1, 0)])
def test_a_retry_that_could_not_be_is_refused(environment: Environment, number: int, phases: int) -> None:
    script = [Phase(here, retry=Retry(phases, in_the_first) if i == number else None) for i in range(3)]
    with pytest.raises(ConfigurationError, match=f"phase {number} of 0 to 2 cannot go back {phases} phases"):
        Expert(environment, script)


def test_who_teaches_is_in_the_phase_that_the_state_tells(environment: Environment) -> None:
    """However much time passes, and back to an earlier one as well; who leads goes by time."""
    stage = torch.tensor([1, 0, 2])
    phases = (Phase(here, timeout=0.1), Phase(here, gripper_open=False, timeout=0.1), Phase(here))
    expert = Expert(environment, phases, stage=lambda env: stage)
    environment.reset(seed=0)
    environment.state.episode_step += 1
    for _ in range(30):
        expert.compute({})
    assert expert.phase.tolist() == [2, 2, 2]
    expert.teaches = True
    for _ in range(30):
        expert.compute({})
    assert expert.phase.tolist() == [1, 0, 2]


def test_who_teaches_asks_for_more_until_the_hand_is_there(environment: Environment) -> None:
    """As if the goal were further in the same direction; within the tolerance, or where it leads, for what is left."""
    environment.reset(seed=0)

    def asked(height: float, teaches: bool = False, tolerance: float = 0.01, least: float = 0.0) -> Tensor:
        phase = Phase(picking.raised(here, height), position_tolerance=tolerance, least=least)
        expert = Expert(environment, (phase, Phase(here)))
        expert.teaches = teaches
        return expert.compute({})["action"]

    assert (asked(0.015) - asked(0.05)).abs().max() > 1e-3
    torch.testing.assert_close(asked(0.015, teaches=True, least=0.05), asked(0.05))
    torch.testing.assert_close(asked(0.015, teaches=True, tolerance=0.02, least=0.05), asked(0.015))
    torch.testing.assert_close(asked(0.015, least=0.05), asked(0.015))
