"""The runner: whose episodes count, and what a run reports."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.cli.bench import bench
from orbit_core.cli.run import run
from orbit_core.cli.settings import BenchSettings, RunSettings
from orbit_core.interfaces import ConfigurationError, UnknownNameError

BACKEND = default_backend()


def lift(num_envs: int, episodes: int, agent: str = "random") -> RunSettings:
    return RunSettings(
        task="Lift",
        backend=BACKEND,
        num_envs=num_envs,
        episodes=episodes,
        agent=agent,
        set=("tolerance=0.06",),
        fields={"episode_length": 0.1, "tolerance": 0.05},
    )


def test_a_run_counts_exactly_and_reports_itself():
    shown: list[int] = []
    result = run(lift(num_envs=3, episodes=7), lambda episodes, filmed: shown.append(episodes))
    assert result.episodes == 7
    assert result.episode_steps.mean == 5
    assert shown == sorted(shown)
    assert shown[-1] == 7
    report = json.loads(json.dumps(result.as_json(), allow_nan=False))
    assert (report["task"], report["backend"], report["agent"], report["num_envs"]) == ("Lift", BACKEND, "random", 3)
    assert {"orbit", "torch", "python"} < set(report["versions"])
    assert report["metric"]["name"] == next(iter(report["metrics"]))
    assert report["env_steps_per_second"] > 0
    low, high = report["success_interval"]
    assert 0.0 <= low <= report["success_rate"] <= high <= 1.0


def test_the_same_seed_runs_the_same():
    first, second = run(lift(2, 4)), run(lift(2, 4))
    assert first.metrics == second.metrics
    assert first.episode_return == second.episode_return


def test_random_actions_do_not_depend_on_the_number_of_environments():
    from orbit_core.cli.making import make_environment
    from orbit_core.envs.actors import RandomActor

    actions = []
    for num_envs in (1, 3):
        environment = make_environment(lift(num_envs, 1), num_envs)
        agent = RandomActor(environment, seed=5)
        actions.append(torch.stack([agent.act()[0] for _ in range(4)]))
        environment.close()
    torch.testing.assert_close(actions[0], actions[1])
    assert actions[0].abs().max() <= 1.0
    assert actions[0].std() > 0.3


def test_an_unknown_agent_is_refused_before_anything_is_built():
    with pytest.raises(UnknownNameError, match="did you mean 'expert'"):
        run(lift(1, 1, agent="exprt"))


@pytest.mark.parametrize(("option", "name"), [("json", "kept.json"), ("video", "kept.mp4")])
def test_a_file_that_is_there_is_kept_unless_it_may_be_replaced(
    option: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Told before anything is built."""
    path = tmp_path / name
    path.write_text("kept")

    def build(*arguments: object) -> None:
        raise RuntimeError("it builds")

    monkeypatch.setattr("orbit_core.cli.run.make_environment", build)
    settings = dataclasses.replace(lift(1, 1), **{option: path})
    with pytest.raises(ConfigurationError, match=rf"{name} is there already: give another name, or --overwrite"):
        run(settings)
    assert path.read_text() == "kept"
    with pytest.raises(RuntimeError, match="it builds"):
        run(dataclasses.replace(settings, overwrite=True))


@pytest.mark.parametrize(("option", "name"), [("json", "kept.json"), ("plot", "kept.png")])
def test_a_benchmark_keeps_files_too(option: str, name: str, tmp_path: Path):
    path = tmp_path / name
    path.write_text("kept")
    with pytest.raises(ConfigurationError, match=rf"{name} is there already"):
        bench(dataclasses.replace(BenchSettings(task="Lift", backend=BACKEND), **{option: path}))
