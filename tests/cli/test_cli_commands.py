"""The command: what it prints, writes and returns. Most are run in this process, for every other loads torch anew."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from orbit_conformance.robots.checks import CHECKS
from orbit_conformance.scenarios import SCENARIOS
from orbit_core import cli
from orbit_core.backends import backend, default_backend
from orbit_core.cli import main
from orbit_core.envs import task_entries
from orbit_core.interfaces import Capability, UnknownNameError

BACKEND = default_backend()
PROGRAM = [sys.executable, "-c", "import sys; from orbit_core.cli import main; sys.exit(main())"]
Printed = Callable[..., str]
SHORT = ["--backend", BACKEND, "--agent", "zero", "--set", "episode_length=0.04"]


def orbit(*words: str) -> subprocess.CompletedProcess[str]:
    """In a process of its own, as it is called."""
    environment = {**os.environ, "ORBIT_DEBUG": ""}
    return subprocess.run([*PROGRAM, *words], capture_output=True, text=True, timeout=120, env=environment)


@pytest.fixture
def printed(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Printed:
    """What a command prints that succeeds, in this process."""
    monkeypatch.delenv("ORBIT_DEBUG", raising=False)

    def run(*words: str) -> str:
        code, told = main(words), capfd.readouterr()
        assert code == 0, told.err
        return told.out

    return run


@pytest.mark.parametrize("kind", ["tasks", "robots", "objects", "backends", "policies"])
def test_lists_load_no_tensor_library_and_no_engine(kind: str):
    script = (
        "import sys; from orbit_core.cli import main; code = main(['list', sys.argv[1]]);"
        "heavy = {'torch', sys.argv[2], 'trimesh', 'pxr', 'gymnasium', 'viser'} & set(sys.modules);"
        "sys.exit(f'loaded {heavy}' if heavy else code)"
    )
    done = subprocess.run([sys.executable, "-c", script, kind, BACKEND], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    names = {
        "tasks": list(task_entries()),
        "robots": ["franka_panda"],
        "objects": ["box", "cabinet"],
        "backends": [BACKEND],
        "policies": ["reach"],
    }
    for name in names[kind]:
        assert f"\n{name} " in f"\n{done.stdout}"


@pytest.mark.parametrize(
    ("kind", "name"), [("actions", "ik_relative"), ("motion", "differential_ik"), ("sensors", "ImuSpec")]
)
def test_action_spaces_motion_generators_and_sensors_are_listed(kind: str, name: str, printed: Printed):
    assert f"\n{name} " in f"\n{printed('list', kind)}"


def test_a_tasks_action_terms_are_told_with_their_joints(printed: Printed):
    told = " ".join(printed("info", "Lift").split())
    assert "gripper binary_gripper robot 1: opening panda_finger_joint1" in told


def test_the_kinds_that_can_be_listed_are_listed(printed: Printed):
    assert {"tasks", "robots", "backends", "libraries"} <= {*printed("list").splitlines()}


def test_backends_are_listed_with_versions(printed: Printed):
    text = printed("list", "backends")
    for package, version in backend(BACKEND).versions().items():
        assert f"{package} {version}" in text


def test_info_of_a_task(printed: Printed):
    text = printed("info", "Lift")
    words = ("Lift", "BoxConfig(", "0.05", "hand_to_cube", "action_rate", "franka_panda", "native PD", "clip")
    assert all(word in text for word in words)


def test_info_of_an_object_tells_its_parameters_and_what_they_make(printed: Printed):
    text = printed("info", "cabinet")
    assert "drawer_joint" in text
    text = " ".join(printed("info", "sphere").split())
    assert "radius 0.025" in text
    assert "mass: 0.03272 kg" in text


def test_info_of_a_sensor_tells_its_specification_and_its_values(printed: Printed):
    text = " ".join(printed("info", "ImuSpec").split())
    assert "rate None" in text
    assert "linear_acceleration Linear acceleration (N, 3), m/s^2" in text


def test_info_of_a_robot(printed: Printed):
    text = printed("info", "franka_panda")
    for word in ("Apache-2.0", "example-robot-data", "panda_joint7", "panda_hand_tcp", "ImplicitPd", "armature"):
        assert word in text


def test_info_of_a_backend_shows_every_capability_with_its_reason(printed: Printed):
    text = " ".join(printed("info", BACKEND).split())
    capabilities = backend(BACKEND).capabilities()
    for capability in Capability:
        words = capability.value.split()[0]
        assert words in text
        assert all(word in text for word in capabilities[capability].reason.split())


def test_info_of_a_backend_shows_every_declared_gap_with_its_limit_unit_and_reason(printed: Printed):
    text = " ".join(printed("info", BACKEND).split())
    gaps = backend(BACKEND).gaps()
    assert gaps
    units = {(asked.name, metric.name): metric.unit for asked in (*SCENARIOS, *CHECKS) for metric in asked.metrics}
    for gap in gaps:
        limit = f"{gap.limit:g} {units[gap.scenario, gap.metric]}".strip()
        assert f"{gap.scenario} {gap.metric} {limit} " in text
        assert all(word in text for word in gap.reason.split())


def test_run_writes_its_result(tmp_path: Path, printed: Printed):
    path = tmp_path / "result.json"
    text = printed("run", "Lift", *SHORT, "--num-envs", "2", "--episodes", "3", "--json", str(path))
    result = json.loads(path.read_text())
    assert result["episodes"] == 3
    assert result["episode_steps"] == {"mean": 2.0, "deviation": 0.0}
    assert "success rate" in text
    assert result["metric"]["name"] in text


def test_run_from_a_file(tmp_path: Path, printed: Printed):
    file, path = tmp_path / "run.toml", tmp_path / "result.json"
    file.write_text(
        f'task = "Lift"\nbackend = "{BACKEND}"\nnum_envs = 2\nepisodes = 2\nagent = "zero"\njson = "{path}"\n'
        "[fields]\nepisode_length = 0.04\n"
    )
    printed("run", "--config", str(file), "--seed", "4")
    result = json.loads(path.read_text())
    assert (result["num_envs"], result["seed"]) == (2, 4)


def test_run_films_a_video(tmp_path: Path, printed: Printed):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    if not backend(BACKEND).capabilities().has(Capability.RGB):
        pytest.skip("the backend draws nothing")
    path = tmp_path / "lift.mp4"
    length = ["--set", "episode_length=0.08"]
    printed("run", "Lift", *SHORT[:-2], *length, "--num-envs", "2", "--episodes", "2", "--video", str(path))
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert frames == 2  # four steps at 50 Hz, filmed at 25 Hz
    assert seconds == pytest.approx(0.08)


def test_bench_measures_each_size(tmp_path: Path, printed: Printed):
    figures, plot = tmp_path / "bench.json", tmp_path / "bench.png"
    words = ["--backend", BACKEND, "--num-envs", "4", "1", "--steps", "5", "--json", str(figures), "--plot", str(plot)]
    text = printed("bench", "Lift", *words)
    result = json.loads(figures.read_text())
    assert [row["num_envs"] for row in result["throughput"]] == [1, 4]
    assert all(row["env_steps_per_second"] > 0 for row in result["throughput"])
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert "ms per step" in text


def test_view_serves_a_page(printed: Printed):
    pytest.importorskip("viser")
    text = printed("view", "Lift", *SHORT, "--max-steps", "3")
    assert "watch at http://127.0.0.1:" in text


MISTAKES = [
    (["lst"], "did you mean 'list'"),
    (["list", "task"], "did you mean 'tasks'"),
    (["info", "Lft"], "did you mean 'Lift'"),
    (["info", "frank_panda"], "did you mean 'franka_panda'"),
    (["info"], "NAME"),
    (["run"], "name a task"),
    (["run", "Lft"], "did you mean 'Lift'"),
    (["run", "Lift", "--num-env", "3"], "did you mean '--num-envs'"),
    (["run", "Lift", "--num-envs", "many"], "--num-envs"),
    (["run", "Lift", "--episodes", "0"], "episodes must be at least 1"),
    (["run", "Lift", "--agent", "exprt"], "did you mean 'expert'"),
    (["run", "Lift", "--backend", "physx9"], "unknown backend 'physx9'"),
    (["run", "Lift", "--json", "/nowhere/a.json"], "there is no folder /nowhere"),
    (["run", "Lift", "--video", "a.gif"], "must end in .mp4"),
    (["run", "--config", "/nowhere/a.toml"], "/nowhere/a.toml"),
    (["bench", "Lift", "--steps", "0"], "steps must be at least 1"),
    (["view", "Lift", "--agent", "nobody"], "unknown actor or policy 'nobody'"),
    (["run", "Lift", "--robot", "franka"], "did you mean 'franka_panda'"),
    (["view", "Lift", "--max-steps", "-1"], "max_steps must be at least 1"),
    (["record", "Lift", "--output", ""], "is not, or not only, a dataset"),
    (["record", "Lift", "--output", "x.hdf5", "--resume", "--overwrite"], "give one of them"),
    (["conformance", "--scenario", "free_fall", "--time-limit", "nan"], "time_limit must be positive and finite"),
]
BUILT_MISTAKES = [
    (["--num-envs", "0"], "num_envs must be at least 1"),
    (["--action", "ik_relativ"], "did you mean 'ik_relative'"),
    (["--device", "gpu"], "device 'gpu'"),
    (["--renderer", "crayons"], "unknown renderer 'crayons'"),
    (["--set", "cube.siz=1"], "did you mean 'size'"),
    (["--set", "tolerance"], "key=value"),
    (["--set", "episode_length=1e18"], "more than 2,147,483,647 steps"),
    (["--set", "physics_dt=1e-300"], "more than 2,147,483,647 steps"),
    (["--set", "num_envs=1"], "unknown field 'num_envs'"),
    (["--set", "tolerance=big"], "'tolerance' of task Lift is 'big'"),
    (["--matter-setting", "substep=1"], "nothing in this scene bends or flows"),
    (["--setting", "nothing_of_the_kind=1"], "unknown setting 'nothing_of_the_kind'"),
]


def test_a_character_that_the_terminal_lacks_is_no_error_after_the_work_is_done(monkeypatch: pytest.MonkeyPatch):
    """As with PYTHONUTF8=0 in the C locale, and with names of files that are no text."""
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="ascii"))
    monkeypatch.setattr(cli, "_dispatch", lambda words: print("1 \u00b1 2 in \udcff.hdf5", flush=True) or 0)
    assert main([]) == 0
    assert written.getvalue().strip() == rb"1 \xb1 2 in \udcff.hdf5"


def assert_one_line(code: int, out: str, err: str, named: str) -> None:
    assert code == 2
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert named in err


def test_a_mistake_is_told_by_the_command_as_it_is_called():
    words, named = MISTAKES[0]
    done = orbit(*words)
    assert_one_line(done.returncode, done.stdout, done.stderr, named)


@pytest.mark.parametrize(("words", "named"), MISTAKES, ids=[" ".join(words) for words, _ in MISTAKES])
def test_a_mistake_is_told_in_one_line(words: list[str], named: str, capfd: pytest.CaptureFixture[str]):
    assert_one_line(main(words), *capfd.readouterr(), named)


@pytest.mark.parametrize(("words", "named"), BUILT_MISTAKES, ids=[" ".join(words) for words, _ in BUILT_MISTAKES])
def test_a_mistake_in_the_environment_is_told_in_one_line(
    words: list[str], named: str, capfd: pytest.CaptureFixture[str]
):
    code = main(["run", "Lift", "--backend", BACKEND, *words])
    assert_one_line(code, *capfd.readouterr(), named)


@pytest.mark.parametrize(("words", "variable"), [(["--debug"], ""), ([], "1")])
def test_debugging_shows_where_a_mistake_was_found(words: list[str], variable: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("ORBIT_DEBUG", variable)
    with pytest.raises(UnknownNameError):
        main(["run", "Lft", *words])


def test_help_says_what_every_command_and_option_does(printed: Printed):
    shown = printed("--help")
    assert "view" in shown
    assert "entry point" not in shown  # stands for a command that nobody has described
    text = orbit("run", "--help").stdout
    for option in ("--num-envs", "--episodes", "--config", "--setting"):
        assert option in text


RESETS_ARE_TOLD = """
import sys
from pathlib import Path
from orbit_core.cli import main
from orbit_core.envs import Environment

def reset(*words, _reset=Environment.reset, **named):
    Path(sys.argv[1]).touch()
    return _reset(*words, **named)

Environment.reset = reset
sys.exit(main(sys.argv[2:]))
"""


def test_an_interrupt_is_quiet(tmp_path: Path):
    begun = tmp_path / "begun"
    words = ["run", "Reach", "--backend", BACKEND, "--num-envs", "1", "--episodes", "100000", "--agent", "zero"]
    command = [sys.executable, "-c", RESETS_ARE_TOLD, str(begun), *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        while not begun.exists():
            assert process.poll() is None, process.communicate()
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    # The one warning that depends on the processor.
    said = [line for line in err.splitlines() if not line.startswith("warning: matrix products")]
    assert (process.returncode, out, said) == (130, "", [])
