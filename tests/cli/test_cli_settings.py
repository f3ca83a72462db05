"""Command line over file over defaults, and what is refused."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
from tyro.conf import Positional, arg

from orbit_core.cli.settings import BenchSettings, RunSettings, parse_settings
from orbit_core.interfaces import ConfigurationError, OrbitError, UnknownNameError

FILE = """
task = "Lift"
num_envs = 8
seed = 3
json = "result.json"

[fields]
tolerance = 0.06

[settings]
iterations = 50

[renderer_settings]
samples_per_pixel = 4
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "run.toml"
    path.write_text(FILE)
    return path


def run_settings(*words: str) -> RunSettings:
    return parse_settings(RunSettings, words, "orbit run")


def test_defaults_stand_where_nothing_is_said():
    assert run_settings("Lift") == RunSettings(task="Lift")


def test_the_file_wins_over_defaults(file: Path):
    parsed = run_settings("--config", str(file))
    assert (parsed.task, parsed.num_envs, parsed.seed, parsed.episodes) == ("Lift", 8, 3, 200)
    assert parsed.json == Path("result.json")
    assert parsed.fields == {"tolerance": 0.06}
    assert parsed.settings == {"iterations": 50}
    assert parsed.renderer_settings == {"samples_per_pixel": 4}


def test_a_file_goes_with_what_only_the_command_line_can_say(file: Path):
    @dataclass(frozen=True, kw_only=True)
    class Played(RunSettings):
        policy: Annotated[Positional[str], arg(metavar="POLICY")]

    parsed = parse_settings(Played, ["Reach", "out/policy", "--config", str(file)], "orbit play")
    assert (parsed.task, parsed.policy, parsed.num_envs) == ("Reach", "out/policy", 8)


def test_the_command_line_wins_over_the_file(file: Path):
    parsed = run_settings("Reach", "--config", str(file), "--seed", "7", "--set", "a=1", "--set", "b=2")
    assert (parsed.task, parsed.num_envs, parsed.seed) == ("Reach", 8, 7)
    assert parsed.set == ("a=1", "b=2")


def test_an_option_that_repeats_the_default_wins_over_the_file(file: Path):
    assert run_settings("--config", str(file), "--num-envs", "16").num_envs == 16


def test_a_file_holds_lists(tmp_path: Path):
    path = tmp_path / "bench.toml"
    path.write_text('task = "Lift"\nnum_envs = [2, 8]\nplot = "a.png"')
    parsed = parse_settings(BenchSettings, ["--config", str(path)], "orbit bench")
    assert parsed.num_envs == (2, 8)
    assert parsed.plot == Path("a.png")


def test_a_video_has_a_width_and_a_height(tmp_path: Path):
    path = tmp_path / "run.toml"
    path.write_text("video_size = [64, 48, 3]")
    assert run_settings("--video-size", "208", "160").video_size == (208, 160)
    with pytest.raises(ConfigurationError, match=r"'video_size' of configuration file .* must be a list of 2"):
        run_settings("Reach", "--config", str(path))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("num_env = 3", ["num_env", "'num_envs'"]),
        ("cofig = 3", ["cofig"]),
        ('config = "other.toml"', ["config"]),
        ('set = ["tolerance=1"]', ["set", "'settings'"]),
        ('num_envs = "many"', ["num_envs", "whole number"]),
        ("num_envs = true", ["num_envs", "whole number"]),
        ("seed = 1.5", ["seed", "whole number"]),
        ('overwrite = "yes"', ["overwrite", "true or false"]),
        ("task = 3", ["task", "text"]),
        ("fields = 3", ["fields", "table"]),
        ("num_envs =", ["not TOML"]),
    ],
)
def test_a_wrong_key_or_value_is_named_with_its_file(tmp_path: Path, text: str, named: list[str]):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(OrbitError) as raised:
        run_settings("Lift", "--config", str(path))
    for part in [str(path), *named]:
        assert part in str(raised.value)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("a = " + "[" * 900 + "]" * 900, "deeper than 32"),
        ("[fields]\nx = " + "{a = " * 300 + "1" + "}" * 300, "deeper than 32"),
        (f"fields.{'.'.join('a' * 3000)} = 1", "deeper than 32"),
        (f"seed = {'9' * 6000}", "not TOML"),
        ("#" * 2**20 + "\n", "larger than 1,048,576 bytes"),
    ],
)
def test_a_file_of_a_size_that_no_settings_have_is_refused(tmp_path: Path, text: str, why: str):
    path = tmp_path / "huge.toml"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=f"huge.toml.*{why}"):
        run_settings("Lift", "--config", str(path))


def test_a_pipe_and_a_device_are_no_files_of_settings(tmp_path: Path):
    """They may never end."""
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path):
        with pytest.raises(ConfigurationError, match=f"{path} is no regular file"):
            run_settings("Lift", "--config", str(path))


def test_switches_are_turned_off_and_options_have_the_names_that_help_shows():
    @dataclass(frozen=True, kw_only=True)
    class Driving(RunSettings):
        input_device: Annotated[str, arg(name="device")] = "browser"
        device: Annotated[str, arg(name="torch-device")] = "cpu"

    settings = parse_settings(
        Driving, ["Lift", "--no-capture", "--device", "keyboard", "--torch-device", "cpu:0"], "orbit drive"
    )
    assert (settings.capture, settings.input_device, settings.device) == (False, "keyboard", "cpu:0")
    for word in ("--no-seed", "--input-device"):
        with pytest.raises(UnknownNameError, match=f"unknown option '{word}'"):
            parse_settings(Driving, ["Lift", word, "3"], "orbit drive")


def test_a_missing_file_is_named():
    with pytest.raises(ConfigurationError, match=r"/nowhere/run\.toml"):
        run_settings("--config", "/nowhere/run.toml")


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--num-env", "3"], "did you mean '--num-envs'"),
        (["--fields", "3"], "unknown option '--fields'"),
        (["--num-envs", "many"], "--num-envs"),
        (["--num-envs"], "--num-envs"),
        (["Lift", "Reach"], "unexpected argument 'Reach'"),
    ],
)
def test_a_wrong_option_is_named_in_one_line(words: list[str], named: str):
    with pytest.raises(OrbitError) as raised:
        run_settings(*words)
    assert named in str(raised.value)
    assert "\n" not in str(raised.value)
