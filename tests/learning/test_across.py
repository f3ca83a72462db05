"""Training on several engines together: rows, ends of episodes, success by engine, and the command line."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from orbit_core.backends import backend_names, default_backend
from orbit_core.cli import main
from orbit_core.envs import Environment, PpoSettings
from orbit_core.interfaces import ConfigurationError
from orbit_learn.across import AcrossEngines
from orbit_learn.cli.play import restored_settings
from orbit_learn.cli.trained import PlaySettings
from orbit_learn.ends import EpisodeTally
from orbit_learn.policy import load_policy
from orbit_learn.ppo import PpoTrainer
from orbit_learn.teacher import teacher_of
from orbit_learn.trackers import TrackerLog
from orbit_learn.trainer import Progress
from orbit_learn.training import Training
from orbit_tasks.reach import Reach

BACKEND = default_backend()
_OTHERS = [name for name in backend_names() if name != BACKEND]
# Starts faster than one that compiles.
OTHER = "bullet" if "bullet" in _OTHERS else next(iter(_OTHERS), "")
several = pytest.mark.skipif(not OTHER, reason="capability: a second engine is not installed")


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def reach(num_envs: int, length: float = 0.1, backend: str = BACKEND) -> Environment:
    return Environment(Reach(action="ik_relative", episode_length=length), num_envs, backend)


def test_rows_of_each_part_are_what_it_does_alone() -> None:
    """Observations, rewards and ends of 2 and 3 environments, whose episodes end at different steps."""
    alone, joined = (reach(2), reach(3)), AcrossEngines((reach(2), reach(3)))
    joined.reset(5)
    for part, seed in zip(alone, (5, 1_000_005), strict=True):
        part.reset(seed)
    for environments in (alone, joined.parts):
        environments[0].state.episode_step += torch.tensor([0, 2])
        environments[1].state.episode_step += torch.tensor([1, 0, 2])
    ended: list[list[int]] = []
    for step in range(5):
        action = torch.full((5, joined.action_size), 0.1 * step)
        seen, reward, terminated, truncated, info = joined.step(action)
        results = [part.step(action[:2] if part is alone[0] else action[2:]) for part in alone]
        torch.testing.assert_close(seen["policy"], torch.cat([result[0]["policy"] for result in results]))  # pyright: ignore[reportArgumentType]
        torch.testing.assert_close(reward, torch.cat([result[1] for result in results]))
        assert torch.equal(terminated | truncated, torch.cat([result[2] | result[3] for result in results]))
        ended.append(info["final"].env_ids.tolist() if info else [])
        finals = [result[4]["final"] for result in results if "final" in result[4]]
        if info:
            torch.testing.assert_close(
                info["final"].metrics["position_error_m"],
                torch.cat([final.metrics["position_error_m"] for final in finals]),
            )
    assert ended == [[], [], [1, 4], [2], [0, 3]]
    joined.close()
    for part in alone:
        part.close()


def test_each_part_has_its_own_expert() -> None:
    joined = AcrossEngines((reach(1), reach(2)))
    alone = reach(1), reach(2)
    wanted = teacher_of(joined, "expert")(joined.observe())
    expected = torch.cat([teacher_of(part, "expert")(part.observe()) for part in alone])
    assert wanted.abs().max() > 0.1
    torch.testing.assert_close(wanted, expected)
    for environment in (joined, *alone):
        environment.close()


def test_parts_must_be_alike() -> None:
    one, other = reach(1), reach(1, length=0.2)
    with pytest.raises(ConfigurationError, match=r"the same max_episode_steps on each: it is 5 on .*, and 10"):
        AcrossEngines((one, other))
    one.close()
    other.close()


def test_successes_are_counted_apart() -> None:
    environment = reach(3)
    tally = EpisodeTally(environment.device, {"first": slice(0, 1), "second": slice(1, 3)})
    while "final" not in (info := environment.step(torch.zeros(3, environment.action_size))[-1]):
        pass
    info["final"].success.copy_(torch.tensor([True, False, True]))
    tally.add(info, 3)
    assert tally.read()[1:] == (pytest.approx(2 / 3), 3)
    assert tally.parts == {"first": 1.0, "second": 0.5}
    tally.add(info, 3, torch.tensor([False, True, False]))
    tally.read()
    assert tally.parts == {"first": 1.0, "second": 0.0}, "one without new episodes keeps its last rate"
    environment.close()


@several
def test_ppo_learns_on_two_engines(tmp_path: Path) -> None:
    joined = AcrossEngines((reach(4), reach(4, backend=OTHER)))
    settings = PpoSettings(iterations=2, steps_per_iteration=6, hidden_sizes=(16,))
    trainer = PpoTrainer(joined, settings, tmp_path, 0)  # pyright: ignore[reportArgumentType] - as the command does
    before = trainer.actor().module.state_dict()["layers.0.weight"]
    Training(trainer, "Reach", {}).run(2, 100, lambda progress: None)
    assert not torch.equal(before, trainer.actor().module.state_dict()["layers.0.weight"])
    policy = load_policy(tmp_path)
    assert policy.description.backend == f"{BACKEND}, {OTHER}"
    assert policy.manifest is not None
    assert (policy.manifest.num_envs, set(policy.manifest.settings)) == (8, {BACKEND, OTHER})
    alone = reach(8)
    other = Training(PpoTrainer(alone, settings, tmp_path, 0), "Reach", {})
    told = f"it began on {BACKEND}, {OTHER}, and is resumed on {BACKEND}; give --backend {BACKEND} {OTHER}, or begin"
    with pytest.raises(ConfigurationError, match=told):
        other.run(3, 100, lambda progress: None, resume=True)
    curve: list[int] = []
    turned = AcrossEngines(joined.parts[::-1])
    again = PpoTrainer(turned, settings, tmp_path, 0)  # pyright: ignore[reportArgumentType]
    Training(again, "Reach", {}).run(3, 100, lambda progress: curve.append(progress.iteration), resume=True)
    assert curve == [2], "the order of the same engines is free"
    joined.close()
    alone.close()


def test_trackers_take_the_success_of_each_engine() -> None:
    taken: dict[str, float] = {}

    class Run:
        def log(self, numbers: dict[str, float], step: int) -> None:
            taken.update(numbers, step=step)

    log = TrackerLog()
    log._run = Run()
    log.add(Progress(3, 10, 1.0, 0.5, 0.5, engines={"first": 0.25, "second": math.nan}))
    assert taken["episode/success_rate_first"] == 0.25
    assert "episode/success_rate_second" not in taken
    assert taken["step"] == 3


@several
def test_the_command_line_takes_several_engines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Environments are divided, success is counted by engine, and either engine's settings are played with."""
    folder = tmp_path / "kept"
    words = ["train", "Reach", "--backend", BACKEND, OTHER, "--num-envs", "3", "--iterations", "2"]
    words += ["--set", "episode_length=0.06", "--output", str(folder)]
    taught = ["--library", "distill", "--teacher", "expert", "--distillation", "teacher_led=0"]
    small = ["--action", "ik_relative", "--distillation", "steps_per_iteration=3", "--distillation", "batch_size=8"]
    own = ["--setting", f"{OTHER}.simplify_meshes=false"]
    assert main([*words, *taught, *small, *(own if OTHER == "bullet" else [])]) == 0
    last = json.loads((folder / "curve.jsonl").read_text().splitlines()[-1])
    assert last["env_steps"] == 3 * (3 + 2 * 3)
    assert set(last["engines"]) == {BACKEND, OTHER}
    assert "of them on" in capsys.readouterr().out
    record = json.loads((folder / "training.json").read_text())
    assert record["settings"]["backend"] == [BACKEND, OTHER]
    for engine in (BACKEND, OTHER):
        played = restored_settings(PlaySettings(policy=folder, backend=engine)).settings
        assert played.backend == engine
        assert "simplify_meshes" in played.settings or engine != "bullet"
    config = tmp_path / "one.toml"
    config.write_text(f'task = "Reach"\nbackend = ["{BACKEND}"]\nnum_envs = 2\n[fields]\nepisode_length = 0.06\n')
    one = ["train", "--config", str(config), "--iterations", "1", "--output", str(tmp_path / "one")]
    assert main([*one, *taught, *small]) == 0
    assert json.loads((tmp_path / "one" / "training.json").read_text())["settings"]["backend"] == BACKEND
    assert main([*words[:-1], str(tmp_path / "other"), "--library", "rsl-rl"]) == 2
    assert "learns on one engine" in capsys.readouterr().err
    assert main([*words[:-1], str(tmp_path / "other"), *taught, "--setting", "gap=1"]) == 2
    assert "names none of the engines" in capsys.readouterr().err
    assert main(["train", "Reach", "--backend", OTHER, OTHER]) == 2
    assert "names an engine twice" in capsys.readouterr().err
