"""Command line over file over defaults, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orbit_core.cli.parsing import parse_settings
from orbit_core.cli.runner import run
from orbit_core.cli.settings import BenchSettings, RunSettings
from orbit_core.cli.values import check_values, defaults_of, parse_values
from orbit_core.interfaces import ConfigurationError, OrbitError, UnknownNameError

FILE = """
task = "Lift"
num_envs = 8
seed = 3
json = "result.json"

[fields]
cube_size = 0.06

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
    assert parsed.fields == {"cube_size": 0.06}
    assert parsed.settings == {"iterations": 50}
    assert parsed.renderer_settings == {"samples_per_pixel": 4}


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
    with pytest.raises(ConfigurationError, match="video_size must be a width and a height"):
        run(run_settings("Reach", "--config", str(path)))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("num_env = 3", ["num_env", "'num_envs'"]),
        ("cofig = 3", ["cofig"]),
        ('config = "other.toml"', ["config"]),
        ('set = ["cube_size=1"]', ["set", "'settings'"]),
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


@dataclass
class Owner:
    size: float = 0.5
    count: int = 3
    name: str = "a"
    on: bool = False
    pair: tuple[float, float] = (1.0, 2.0)
    free: object = None


DEFAULTS = defaults_of(Owner)


def test_only_plain_fields_can_be_set():
    assert set(DEFAULTS) == {"size", "count", "name", "on", "pair"}


@pytest.mark.parametrize(
    ("pair", "value"),
    [
        ("size=1", 1.0),
        ("size=-2.5e-3", -2.5e-3),
        ("count=-4", -4),
        ("name=3", "3"),
        ("name=a=b", "a=b"),
        ("on=true", True),
        ("pair=3,4.5", (3.0, 4.5)),
        ("pair=[3, 4.5]", (3.0, 4.5)),
    ],
)
def test_a_value_takes_its_defaults_type(pair: str, value: object):
    (parsed,) = parse_values([pair], DEFAULTS, "field", "task T").values()
    assert parsed == value
    assert type(parsed) is type(value)


@pytest.mark.parametrize("pair", ["size=big", "size=true", "count=1.5", "on=1", "on=yes", "pair=a,b", "size", "size="])
def test_a_value_of_another_type_is_refused(pair: str):
    with pytest.raises(ConfigurationError, match="task T"):
        parse_values([pair], DEFAULTS, "field", "task T")


def test_an_unknown_field_is_named_with_the_nearest():
    with pytest.raises(UnknownNameError, match="'siz' in task T: did you mean 'size'"):
        parse_values(["siz=1"], DEFAULTS, "field", "task T")
    with pytest.raises(UnknownNameError, match="'counts' in task T: did you mean 'count'"):
        check_values({"counts": 1}, DEFAULTS, "field", "task T")


@given(st.floats(allow_nan=False, allow_infinity=False), st.integers(-(2**40), 2**40), st.booleans())
@settings(max_examples=50, deadline=None)
def test_numbers_survive_the_command_line(size: float, count: int, on: bool):
    pairs = [f"size={size!r}", f"count={count}", f"on={str(on).lower()}"]
    assert parse_values(pairs, DEFAULTS, "field", "task T") == {"size": size, "count": count, "on": on}
