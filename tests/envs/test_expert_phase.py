"""Phases of a scripted expert, shown to policies that clone it."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.envs import Environment, make
from orbit_core.envs.actors import RandomActor
from orbit_core.envs.captured_step import CapturedStep
from orbit_core.envs.expert_phase import EXPERT_PHASE
from orbit_core.interfaces import ConfigurationError
from orbit_data.hdf5 import Hdf5Dataset
from orbit_data.noise import NoisyActor
from orbit_motion.experts import Expert
from orbit_tasks.lift import Lift

BACKEND = default_backend()


def lift(count: int = 2) -> Environment:
    return make("Lift", count, BACKEND, expert_phase=True, episode_length=1.8)


def shown(environment: Environment) -> torch.Tensor:
    seen = environment.observe()["policy"]
    assert isinstance(seen, torch.Tensor)
    return seen[:, environment.observation["policy"].columns[EXPERT_PHASE]]


def test_the_policy_sees_the_phase_that_the_expert_acts_in() -> None:
    environment = lift()
    expert = environment.expert()
    assert isinstance(expert, Expert)
    # Close for 0.4 s, and down for at most 1.5 s: phases 1 and 2 of four.
    assert (expert.phase_count, expert.timed_phases) == (4, (1, 2))
    met: set[int] = set()
    for step in range(95):
        # In step 90 new episodes begin, and environment 0 begins another one sooner.
        if step == 12:
            environment.reset(env_ids=torch.tensor([0]))
        begun = environment.state.episode_step == 0
        phase = torch.where(begun, 0, expert.phase)
        torch.testing.assert_close(shown(environment), torch.nn.functional.one_hot(phase, 4).float())
        met |= set(phase.tolist())
        environment.step(expert.compute({})["action"])
    environment.close()
    assert met == {0, 1, 2, 3}


def test_a_policy_that_leads_is_in_the_phase_of_the_states_that_it_reaches() -> None:
    environment, captured = lift(), lift()
    captured._closed = CapturedStep(captured, compile=False, whole=True)
    for each in (environment, captured):
        each.reset(seed=5)
    expert = environment.expert()
    for step in range(50):
        # It holds still far from the cube for a while, in which the phase does not change.
        action = torch.zeros(2, environment.action_size) if step < 5 else expert.compute({})["action"]
        environment.step(action)
        captured.step(action)
        torch.testing.assert_close(shown(environment), shown(captured))
        if step < 5:
            assert bool((shown(environment)[:, 0] == 1.0).all())
    assert bool((shown(environment)[:, 0] == 0.0).all())
    environment.close()
    captured.close()


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("Cartpole-Swing-Up", "no expert that passes through phases"),
        ("Ant", "no scripted expert"),
        ("Mobile-Reach", "drives a base"),
    ],
)
def test_experts_whose_phases_cannot_be_followed_are_refused(task: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        make(task, 1, BACKEND, expert_phase=True)


def test_a_copied_task_is_shown_the_phases_of_its_own_environment() -> None:
    first = lift(2)
    second = Environment(first.task, 3, BACKEND)
    first.close()
    assert shown(second).shape == (3, 4)
    second.close()


def test_the_task_of_the_user_stays_as_it_is() -> None:
    task = Lift(expert_phase=True)
    Environment(task, 1, BACKEND).close()
    assert not hasattr(task.observations.policy, EXPERT_PHASE)


def record(words: str, path: Path) -> int:
    line = f"record {words} --backend {BACKEND} --num-envs 2 --episodes 2 --set episode_length=0.4"
    return main([*line.split(), "--output", str(path)])


@pytest.mark.parametrize(
    ("words", "noted"),
    [("Lift", True), ("Lift --set expert_phase=true", False), ("Lift --agent zero", False), ("Reach", False)],
)
def test_a_recording_says_where_phases_end_after_a_time(
    words: str, noted: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert record(words, tmp_path / "demos.hdf5") == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert ("2 of the expert's 4 phases end after a time (1, 2), which a policy does not see" in printed) == noted
    assert ("--stray" in printed) == noted


def test_recorded_phases_are_a_term_of_the_dataset(tmp_path: Path) -> None:
    path = tmp_path / "demos.hdf5"
    assert record("Lift --set expert_phase=true", path) == 0
    dataset = Hdf5Dataset(path)
    assert dataset.read(0).arrays[f"obs/{EXPERT_PHASE}"].shape == (20, 4)
    assert dataset.known().observations["policy"].terms[EXPERT_PHASE].formula.startswith("one for the phase")
    dataset.close()


def test_a_strayed_start_is_noise_on_what_is_executed_and_then_none(tmp_path: Path) -> None:
    path = tmp_path / "demos.hdf5"
    line = f"record Reach --backend {BACKEND} --num-envs 8 --episodes 8 --stray 0.05 --set episode_length=1.0"
    assert main([*line.split(), "--output", str(path)]) == 0
    dataset = Hdf5Dataset(path)
    lasts: set[int] = set()
    for position in range(8):
        arrays = dataset.read(position).arrays
        strayed = (arrays["actions"] != arrays["clean_actions"]).any(1).nonzero()[0]
        # A fifth of the 50 steps at most, from the first on.
        assert strayed.tolist() == list(range(len(strayed)))
        assert len(strayed) <= 10
        lasts.add(len(strayed))
    dataset.close()
    assert len(lasts) > 3, "each episode strays for another time"


@pytest.mark.parametrize(("noise", "stray"), [(-0.1, 0.0), (0.0, -0.1), (0.1, float("nan")), (0.0, 0.0)])
def test_deviations_that_cannot_be_are_refused(noise: float, stray: float) -> None:
    environment = make("Reach", 1, BACKEND)
    with pytest.raises(ConfigurationError, match=r"at least zero|above zero"):
        NoisyActor(RandomActor(environment, 0), environment, noise, 0, stray)
    environment.close()
