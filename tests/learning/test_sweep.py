"""Sweeps on a real local Ray cluster: a killed process loses nothing, populations exchange, bad files are refused."""

from __future__ import annotations

import json
import math
import os
import signal
import socket
import sys
import threading
import time
import types
from pathlib import Path
from unittest import mock

import pytest

from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.interfaces import ArgumentError, ConfigurationError, OrbitError, UnknownNameError
from orbit_learn.curves import curve_of, sparkline
from orbit_learn.sweep import cluster
from orbit_learn.sweep.cluster import ClusterWatch, connected
from orbit_learn.sweep.plan import Range, read_plan
from orbit_learn.sweep.running import Sweep, best_values
from orbit_learn.sweep.search import search_of

TRAIN = f"""
[train]
task = "Reach"
backend = "{default_backend()}"
num_envs = 2
iterations = 4
library = "sb3"
save_every = 1
fields = {{ episode_length = 0.1 }}
ppo = {{ steps_per_iteration = 8, hidden_sizes = [8] }}
"""
VARY = """
[vary]
"ppo.clip" = { low = 0.1, high = 0.4 }
"ppo.epochs" = [1, 2]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "sweep.toml"
    path.write_text(text)
    return path


def kill_a_training(folder: Path, killed: list[int]) -> None:
    """Kill the first process that trains in the folder, as soon as it has a checkpoint."""
    while not killed:
        if any(folder.rglob("checkpoint_0*")):
            for process in Path("/proc").iterdir():
                # Ray names its processes by what they do.
                if process.name.isdigit() and b"_train_part" in _command(process):
                    os.kill(int(process.name), signal.SIGKILL)
                    killed.append(int(process.name))
                    return
        time.sleep(0.02)


def _command(process: Path) -> bytes:
    try:
        return (process / "cmdline").read_bytes()
    except OSError:  # it has just ended
        return b""


def test_a_sweep_whose_process_is_killed_is_whole_and_goes_on_with_more_trials(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("ray", reason="capability 'sweep' is not installed: pip install 'orbit-learn[sweep]'")
    folder, killed = tmp_path / "out", []
    text = 'search = "tpe"\ntrials = 2\nobjective = "episode_return"\nlast = 2\n' + TRAIN + VARY
    more = text.replace("trials = 2", "trials = 3")
    killer = threading.Thread(target=kill_a_training, args=(folder, killed), daemon=True)
    killer.start()
    assert main(["sweep", str(written(tmp_path, text)), "--output", str(folder)]) == 0
    assert killed
    sweep = Sweep(read_plan(tmp_path / "sweep.toml"), folder)
    assert [len(trial.scores) for trial in sweep.trials] == [1, 1]
    for trial in sweep.trials:
        curve = curve_of(sweep.folder_of(trial, 0))
        assert [line["iteration"] for line in curve] == [0, 1, 2, 3]
        assert trial.scores["0"] == pytest.approx(sum(line["episode_return"] for line in curve[-2:]) / 2)
    values = [trial.values for trial in sweep.trials]
    assert main(["sweep", str(written(tmp_path, more)), "--output", str(folder)]) == 0
    again = Sweep(read_plan(tmp_path / "sweep.toml"), folder)
    assert [trial.values for trial in again.trials[:2]] == values
    assert len([*best_values(again)]) == 3
    page = (folder / "sweep.html").read_text()
    assert page.count("data:image/png") == 2
    other = more.replace('"ppo.epochs" = [1, 2]', '"ppo.epochs" = [1, 3]')
    capfd.readouterr()
    assert main(["sweep", str(written(tmp_path, other)), "--output", str(folder)]) == 2
    assert "holds a sweep with another settings to vary" in capfd.readouterr().err


def test_a_population_copies_its_best_and_changes_their_settings(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="capability 'sweep' is not installed: pip install 'orbit-learn[sweep]'")
    text = 'search = "population"\ntrials = 2\ninterval = 2\nobjective = "episode_return"\n' + TRAIN + VARY
    assert main(["sweep", str(written(tmp_path, text)), "--output", str(tmp_path / "out")]) == 0
    sweep = Sweep(read_plan(tmp_path / "sweep.toml"), tmp_path / "out")
    (copy,) = [trial for trial in sweep.trials if trial.copied]
    (source,) = [trial for trial in sweep.trials if not trial.copied]
    assert copy.copied == [f"after 2 iterations: trial {source.number}"]
    assert copy.values["ppo.clip"] != source.values["ppo.clip"]
    curves = [curve_of(sweep.folder_of(trial, 0)) for trial in (copy, source)]
    assert curves[0][:2] == curves[1][:2]
    assert curves[0][2:] != curves[1][2:]
    assert [len(curve) for curve in curves] == [4, 4]


def test_a_cluster_that_does_not_answer_is_one_clear_error(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("ray", reason="capability 'sweep' is not installed: pip install 'orbit-learn[sweep]'")
    path = written(tmp_path, "seeds = [0, 1]\n" + TRAIN)
    assert main(["sweep", str(path), "--output", str(tmp_path / "out"), "--ray", "127.0.0.1:1"]) == 2
    assert "no Ray cluster answers at '127.0.0.1:1'" in capfd.readouterr().err


class SlowRay(types.ModuleType):
    """Ray of a busy machine, whose starts take too long at first."""

    def __init__(self, failing: int) -> None:
        super().__init__("ray")
        self.left, self.ended = failing, 0

    def init(self, *_: object, **__: object) -> None:
        signal.signal(signal.SIGTERM, lambda *_: None)  # as Ray does
        if self.left:
            self.left -= 1
            raise Exception("The current node timed out during startup.")

    def shutdown(self) -> None:
        self.ended += 1


def test_a_cluster_that_starts_slowly_is_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    late, never = SlowRay(2), SlowRay(9)
    monkeypatch.setitem(sys.modules, "ray", late)
    before = signal.getsignal(signal.SIGTERM)
    assert connected("local") is late
    assert signal.getsignal(signal.SIGTERM) is before
    assert (late.left, late.ended) == (0, 2)
    monkeypatch.setitem(sys.modules, "ray", never)
    with pytest.raises(ConfigurationError, match=r"did not start .* in 3 attempts .*timed out.*--ray"):
        connected("local")


class GoneRay(types.ModuleType):
    """Ray whose work never ends, and whose control process is at a port of this machine."""

    def __init__(self, port: int) -> None:
        super().__init__("ray")
        self.exceptions = types.SimpleNamespace(RayError=RuntimeError)
        self.gcs_address = f"127.0.0.1:{port}"

    def get_runtime_context(self) -> GoneRay:
        return self

    def wait(self, _: object, timeout: float) -> tuple[list[object], list[object]]:
        return [], []


def test_a_cluster_that_goes_away_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ray itself would end the program after a minute."""
    monkeypatch.setattr(cluster, "_SILENT_FOR", 0.0)
    with socket.create_server(("127.0.0.1", 0)) as control:
        ray = GoneRay(control.getsockname()[1])
        watch = ClusterWatch(ray, "auto")
        assert watch.wait([]) == watch.wait([]) == []
    assert watch.wait([]) == []  # it may come back
    with pytest.raises(ConfigurationError, match=r"the Ray cluster is gone .*repeat the command"):
        watch.wait([])
    monkeypatch.setattr(ray, "wait", mock.Mock(side_effect=ConnectionError("lost")))
    with pytest.raises(ConfigurationError, match=r"is gone \(lost\)"):
        ClusterWatch(ray, "ray://127.0.0.1:1").wait([])


def test_a_grid_has_all_combinations_and_random_draws_stay_in_their_ranges(tmp_path: Path) -> None:
    grid = read_plan(written(tmp_path, TRAIN + '[vary]\n"ppo.epochs" = [1, 2]\nnum_envs = [2, 4, 8]\n'))
    search = search_of(grid)
    asked = [search.ask(number, None) for number in range(7)]
    assert asked[6] is None
    assert {(each["ppo.epochs"], each["num_envs"]) for each in asked if each} == {
        (epochs, count) for epochs in (1, 2) for count in (2, 4, 8)
    }
    settings = grid.settings({"ppo.epochs": 2, "num_envs": 4, "fields.tolerance": 0.1}, 7)
    assert (settings.num_envs, settings.seed, settings.ppo[-1], settings.fields["tolerance"]) == (4, 7, "epochs=2", 0.1)
    wide = '[vary]\n"ppo.clip" = { low = 0.01, high = 1.0, log = true }\n'
    drawn = search_of(read_plan(written(tmp_path, 'search = "random"\ntrials = 200\n' + TRAIN + wide)))
    clips = [(drawn.ask(number, None) or {})["ppo.clip"] for number in range(200)]
    assert all(0.01 <= clip <= 1.0 for clip in clips)
    # Half of what is drawn by its logarithm is below the geometric mean of the bounds.
    assert 70 < sum(clip < 0.1 for clip in clips) < 130


@pytest.mark.parametrize(
    ("text", "kind", "message"),
    [
        ("serch = 'grid'" + TRAIN + VARY, UnknownNameError, "serch"),
        ("search = 'grit'" + TRAIN + VARY, UnknownNameError, "grit"),
        (TRAIN + VARY, ConfigurationError, "a grid has lists, but ppo.clip"),
        ("search = 'random'" + TRAIN + VARY, ConfigurationError, "give the number of trials"),
        (TRAIN, ConfigurationError, "varies nothing"),
        (TRAIN.replace("iterations = 4", ""), ConfigurationError, "names the task and the number of iterations"),
        (TRAIN.replace("num_envs", "num_env"), UnknownNameError, "num_env"),
        (TRAIN + "seed = 3", ConfigurationError, r"sets seed, which each training of the sweep has itself"),
        (TRAIN + "[vary]\nppo = ['clip=1']", ConfigurationError, "are written with a dot"),
        (TRAIN + "[vary]\n'num_envs.x' = [1]", ConfigurationError, "are written with a dot"),
        (TRAIN + "[vary]\nnum_envs = ['many']", ConfigurationError, "num_envs"),
        (TRAIN + "[vary]\nnum_envs = 3", ConfigurationError, "is a list of values, or a range"),
        (TRAIN + "[vary]\n'ppo.clip' = { low = 2.0, high = 1.0 }", OrbitError, "from low to high"),
        (TRAIN + "[vary]\n'ppo.clip' = { low = 1.0, high = 2.0, lin = true }", UnknownNameError, "lin"),
        ("search = 'population'\ntrials = 4" + TRAIN + VARY, ConfigurationError, "exchanges them each interval"),
        (
            "search = 'population'\ntrials = 4\ninterval = 2" + TRAIN + "[vary]\n'ppo.learning_rate' = [1e-3, 1e-4]",
            ConfigurationError,
            "cannot vary ppo.learning_rate",
        ),
        ("seeds = [1, 1]" + TRAIN, ConfigurationError, "different numbers"),
        (TRAIN + "[vary]\n'ppo.clop' = [0.1]", ConfigurationError, r"ppo.clop of .* is 0.1: unknown .* 'clop'"),
        (TRAIN + "[vary]\n'ppo.clip' = [0.1, -1.0]", ConfigurationError, r"ppo.clip of .* is -1.0: ppo: clip is -1.0"),
        (TRAIN + "[vary]\n'fields.tolerence' = [0.1]", ConfigurationError, "unknown field 'tolerence' in task Reach"),
        (TRAIN + "[vary]\ntask = ['Reach', 'Reech']", ConfigurationError, "unknown task 'Reech'"),
        (TRAIN.replace("sb3", "sb4") + "[vary]\nnum_envs = [1, 2]", UnknownNameError, "sb4"),
        (
            "search = 'random'\ntrials = 1" + TRAIN + "[vary]\nnum_envs = { low = 2, high = 9 }",
            ConfigurationError,
            "'num_envs' .* must be a whole number",
        ),
        ("cpus = 0" + TRAIN + "[vary]\nnum_envs = [1, 2]", ConfigurationError, "cpus"),
    ],
)  # fmt: skip
def test_a_file_that_contradicts_itself_is_refused(
    text: str, kind: type[OrbitError], message: str, tmp_path: Path
) -> None:
    with pytest.raises(kind, match=message):
        read_plan(written(tmp_path, text))


def test_a_folder_with_other_files_is_left_alone(tmp_path: Path) -> None:
    plan = read_plan(written(tmp_path, "seeds = [0, 1]" + TRAIN))
    folder = tmp_path / "other"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(ConfigurationError, match="holds other files"):
        Sweep(plan, folder)
    assert [path.name for path in folder.iterdir()] == ["notes.txt"]
    (folder / "sweep.json").write_text("{}")
    with pytest.raises(ConfigurationError, match="is no file of a sweep"):
        Sweep(plan, folder)
    with pytest.raises(ArgumentError, match="above zero"):
        Range(low=0.0, high=1.0, log=True)


def test_curves_are_drawn_against_each_other(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for name, gain in (("one", 0.1), ("two", 0.2)):
        (tmp_path / name).mkdir()
        lines = [
            {"iteration": k, "env_steps": 100 * k, "seconds": 1.0 * k, "success_rate": gain * k, "metrics": {"x": 1.0}}
            for k in range(4)
        ]
        (tmp_path / name / "curve.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))
        with (tmp_path / name / "curve.jsonl").open("a") as file:
            file.write('{"iteration": 4, "env_st')  # of a training that was killed, or writes at the moment
        assert curve_of(tmp_path / name) == lines
    words = ["plot", str(tmp_path / "one"), str(tmp_path / "two"), "--output", str(tmp_path / "curves.png")]
    assert main(words) == 0
    assert (tmp_path / "curves.png").read_bytes()[:4] == b"\x89PNG"
    assert main(words) == 2
    assert main([*words, "--overwrite", "--number", "reward"]) == 2
    assert "has no 'reward': it has env_steps, iteration, seconds, success_rate, x" in capfd.readouterr().err


def test_a_line_of_text_draws_a_curve() -> None:
    assert sparkline([]) == sparkline([math.nan]) == ""
    assert sparkline([2.0, 2.0]) == "▁▁"
    assert sparkline([0.0, math.nan, 7.0, 3.0]) == "▁█▄"
    assert sparkline([float(step // 50) for step in range(1000)]) == "▁▁▂▂▂▃▃▄▄▄▅▅▅▆▆▇▇▇██"
