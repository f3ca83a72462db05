"""A run repeats from the file that it wrote, and what came out otherwise is listed with its causes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from orbit_core.backends import backend, default_backend
from orbit_core.cli import main
from orbit_core.cli.rerun import differences
from orbit_core.interfaces import Capability, Level


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("run") / "result.json"
    words = ["Cartpole-Balance", "--num-envs", "2", "--episodes", "2", "--agent", "random", "--seed", "3"]
    assert (
        main(["run", *words, "--set", "episode_length=0.5", "--backend", default_backend(), "--json", str(file)]) == 0
    )
    return file


def changed(file: Path, **changes: object) -> Path:
    values = json.loads(file.read_text())
    other = file.with_name("changed.json")
    other.write_text(json.dumps({**values, **changes}))
    return other


def test_a_run_repeats_number_by_number(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if backend(default_backend()).capabilities()[Capability.DETERMINISTIC].level is not Level.EXACT:
        pytest.skip("the backend does not repeat its runs")
    assert main(["rerun", str(recorded)]) == 0
    assert "the same: 2 episodes of Cartpole-Balance" in capsys.readouterr().out


def test_another_result_is_listed_with_both_numbers_and_other_versions(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = json.loads(recorded.read_text())
    assert main(["rerun", str(changed(recorded, episode_return={**values["episode_return"], "mean": -7.5},
                                      versions={**values["versions"], "torch": "1.0"}))]) == 1  # fmt: skip
    words = capsys.readouterr().out
    assert "episode_return.mean" in words
    assert "-7.5" in words
    assert "torch was 1.0 and is" in words


def test_the_clock_and_descriptions_are_no_results(recorded: Path) -> None:
    values = json.loads(recorded.read_text())
    assert not [*differences(values, {**values, "wall_seconds": 1e3, "versions": {}, "env_steps_per_second": 0.0})]
    assert [each.name for each in differences(values, {**values, "episodes": 3})] == ["episodes"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "cannot read the result of a run"),
        ("{", "cannot read the result of a run"),
        ("[]", "holds no settings of a run"),
        ('{"settings": {"tusk": "Lift"}}', "unknown setting 'tusk'"),
        ('{"settings": {"num_envs": "many"}}', "num_envs"),
    ],
)
def test_a_file_that_is_no_result_is_one_sentence(
    text: str | None, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "result.json"
    if text is not None:
        file.write_text(text)
    assert main(["rerun", str(file)]) == 2
    assert words in capsys.readouterr().err
