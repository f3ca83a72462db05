"""Evaluation of policies: paired statistics against known values, files that go on, and the command."""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from orbit_core.backends import backend_names, default_backend
from orbit_core.cli import main
from orbit_core.cli.making import configured_task
from orbit_core.cli.settings import EnvironmentSettings
from orbit_core.envs import Environment, Task
from orbit_core.interfaces import ConfigurationError, OrbitError
from orbit_learn.evaluation.disturbances import LEVELS, Disturbance
from orbit_learn.evaluation.page import page
from orbit_learn.evaluation.results import BASE, Block, BlockKey, Plan, ResultFile, read_beside, read_results
from orbit_learn.evaluation.running import fingerprint_of, run_blocks
from orbit_learn.evaluation.statistics import failure_kinds, paired_difference, success_of, variance_shares
from orbit_learn.pretrained import policy_path
from orbit_learn.remote.client import ServerAddress

PLAN = Plan("Lift", ("one", "two"), ("mujoco",), {BASE: ()}, (0,), 4)


def block(policy: str, success: str, backend: str = "mujoco", seed: int = 0) -> Block:
    """Block whose episodes succeed where there is a 1."""
    done = tuple(each == "1" for each in success)
    lift = tuple(10.0 * each for each in done)
    return Block(
        key=BlockKey(policy, backend, BASE, seed),
        engine="1.0",
        success=done,
        returns=lift,
        steps=(250,) * len(done),
        metrics={},
        rewards={"reach": (1.0,) * len(done), "lift": lift},
        failed=(False,) * len(done),
    )


def test_paired_differences_count_the_starts_that_part_them() -> None:
    found = paired_difference([block("one", "11110000")], [block("two", "11101111")])
    assert (found.only_first, found.only_second) == (1, 4)
    assert found.difference == pytest.approx(3 / 8)
    # 2 (P(X = 0) + P(X = 1) / 2) with X ~ B(5, 1/2)
    assert found.p_value == pytest.approx(2 * (1 + 2.5) / 32)
    assert found.low < found.difference < found.high


def test_equal_results_are_no_evidence() -> None:
    found = paired_difference([block("one", "1100")], [block("two", "1100")])
    assert found.difference == 0.0
    assert found.p_value == 1.0


def test_results_of_other_starts_are_not_paired() -> None:
    with pytest.raises(ValueError, match="same starts"):
        paired_difference([block("one", "11", seed=0)], [block("two", "11", seed=1)])


def test_variance_goes_to_what_success_depends_on() -> None:
    by_policy = [block("one", "1111"), block("two", "0000")]
    assert variance_shares(by_policy) == pytest.approx(
        {"start": 0, "policy": 1, "training": 0, "engine": 0, "version": 0, "variant": 0, "together and chance": 0}
    )
    by_start = [block("one", "1010"), block("two", "1010")]
    assert variance_shares(by_start)["start"] == pytest.approx(1.0)
    assert variance_shares([block("one", "1111")]) == {}


def test_variance_of_versions_is_apart_from_that_of_their_engine(tmp_path: Path) -> None:
    plan = replace(PLAN, policies=("one",), backends=("bullet", "mujoco"))
    here = [block("one", "1111"), block("one", "1100", "bullet")]
    there = [replace(each, engine="2.0") for each in (block("one", "0000"), block("one", "1100", "bullet"))]
    shares = variance_shares([*here, *there])
    # Both engines succeed in half; versions of one differ by all, those of the other by nothing.
    assert shares["engine"] == pytest.approx(0.0)
    assert shares["version"] == pytest.approx(0.5)
    elsewhere = ResultFile(tmp_path / "results.jsonl", replace(plan, policies=("other name",)))
    for each in there:
        elsewhere.add(replace(each, key=replace(each.key, policy="other name")))
    assert read_beside(tmp_path / "results.jsonl", plan) == there
    text = page(plan, here, beside=there)
    assert "<td>mujoco</td><td>2.0</td>" in text
    with pytest.raises(ConfigurationError, match="differs in episodes"):
        read_beside(tmp_path / "results.jsonl", replace(plan, episodes=5))
    elsewhere.path.write_text("".join(elsewhere.path.read_text().splitlines(keepends=True)[:-1]))
    with pytest.raises(ConfigurationError, match="lacks 1 blocks"):
        read_beside(tmp_path / "results.jsonl", plan)


def test_variance_of_trainings_is_apart_from_that_of_their_recipe() -> None:
    blocks = [block("a0", "1111"), block("a1", "0000"), block("b0", "1100"), block("b1", "1100")]
    recipes = {"a0": "a", "a1": "a", "b0": "b", "b1": "b"}
    shares = variance_shares(blocks, recipes)
    # Both recipes succeed in half; the trainings of a differ by all, those of b by nothing.
    assert shares["policy"] == pytest.approx(0.0)
    assert shares["training"] == pytest.approx(0.5)
    assert variance_shares(blocks)["policy"] == pytest.approx(0.5)
    text = page(replace(PLAN, policies=tuple(recipes), recipes=recipes), blocks)
    assert "a: 2 trainings, 50.0 % in the mean, from 0.0 to 100.0 %" in text


def test_failures_are_named_by_what_has_not_happened() -> None:
    early = replace(block("two", "0"), rewards={"reach": (1.0,), "lift": (10.0,)}, steps=(20,))
    late = replace(early, steps=(250,), success=(False,), key=BlockKey("two", "mujoco", BASE, 1))
    unanswered = replace(early, failed=(True,), key=BlockKey("two", "mujoco", BASE, 2))
    both = replace(early, steps=(20, 250), success=(False, True), key=BlockKey("two", "mujoco", BASE, 3))
    both = replace(both, rewards={"reach": (1.0, 1.0), "lift": (10.0, 10.0)}, failed=(False, False))
    kinds = failure_kinds([block("one", "100"), late, unanswered, both])
    assert {kind: len(found) for kind, found in kinds.items()} == {
        "no 'lift'": 2,
        "not done in time": 1,
        "the policy did not answer, or the simulation diverged": 1,
        "ended early": 1,
    }


def test_success_is_told_with_wilsons_interval() -> None:
    found = success_of([block("one", "1" * 8), block("one", "1" * 8, seed=1)])
    assert (found.value, found.high) == (1.0, 1.0)
    assert found.low == pytest.approx(0.806, abs=1e-3)


def test_a_file_of_results_goes_on_and_forgets_a_line_that_was_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    file = ResultFile(path, PLAN)
    file.add(block("one", "1100"))
    with path.open("a") as cut:
        cut.write('{"block": {"key"')
    again = ResultFile(path, PLAN)
    assert again.left() == [BlockKey("two", "mujoco", BASE, 0)]
    assert read_results(path)[1] == [block("one", "1100")]


def test_a_block_after_a_line_that_was_cut_off_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    ResultFile(path, PLAN).add(block("one", "1101"))
    with path.open("a") as file:
        file.write('{"block": {"key": {"pol')
    ResultFile(path, PLAN).add(block("two", "0001"))
    assert [each.key.policy for each in read_results(path)[1]] == ["one", "two"]


def test_results_of_a_policy_that_was_trained_again_are_told(tmp_path: Path) -> None:
    first, again = (replace(PLAN, digests={"one": digest}) for digest in ("ab", "cd"))
    ResultFile(tmp_path / "results.jsonl", first).add(block("one", "1101"))
    with pytest.raises(ConfigurationError, match="holds results of 'one' before it was trained again"):
        ResultFile(tmp_path / "results.jsonl", again)
    assert len(ResultFile(tmp_path / "results.jsonl", first).blocks) == 1
    ResultFile(tmp_path / "earlier.jsonl", PLAN)
    assert not ResultFile(tmp_path / "earlier.jsonl", first).blocks, "files of earlier versions have no digests"


def test_another_evaluation_in_the_file_is_told(tmp_path: Path) -> None:
    ResultFile(tmp_path / "results.jsonl", PLAN).add(block("one", "1100"))
    with pytest.raises(ConfigurationError, match="differs in seeds, episodes"):
        ResultFile(tmp_path / "results.jsonl", replace(PLAN, seeds=(0, 1), episodes=5))
    (tmp_path / "other.jsonl").write_text("[]\n")
    with pytest.raises(ConfigurationError, match="no results"):
        ResultFile(tmp_path / "other.jsonl", PLAN)


def test_a_plan_without_results_makes_room_for_another(tmp_path: Path) -> None:
    path, other = tmp_path / "results.jsonl", replace(PLAN, seeds=(0, 1))
    ResultFile(path, PLAN)
    ResultFile(path, other).add(block("one", "1100"))
    assert read_results(path) == (other, [block("one", "1100")])


def test_starts_are_the_same_whatever_a_camera_sees_of_them() -> None:
    state, depth = torch.rand(2, 5), torch.rand(2, 4, 6, 1)
    assert fingerprint_of([state, depth]) == fingerprint_of([state, 2.0 * depth])
    assert fingerprint_of([state, depth]) != fingerprint_of([state + 0.01, depth])


def test_the_page_needs_nothing_else_and_hides_no_name() -> None:
    text = page(replace(PLAN, policies=("one", "<two>")), [block("one", "1100"), block("<two>", "1111")])
    assert "&lt;two&gt;" in text
    assert "<two>" not in text
    assert "http" not in text
    assert "Differences on the same starts" in text
    assert "Differences" not in page(replace(PLAN, policies=("one",)), [block("one", "1100")])


def test_the_command_evaluates_once_and_then_reads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = f"evaluate reach expert --backend {default_backend()} --episodes 2 --jobs 1 --output {tmp_path}"
    words += " --set episode_length=0.2 --variant near:position_tolerance=10,rotation_tolerance=4"
    assert main(words.split()) == 0
    first = (tmp_path / "results.jsonl").read_text()
    assert len(first.splitlines()) == 5
    blocks = [json.loads(line)["block"] for line in first.splitlines()[1:]]
    starts = {block["fingerprint"] for block in blocks}
    assert len(starts) == 1, "policies and variants begin alike"
    assert all(any(letter.isdigit() for letter in block["engine"]) for block in blocks), "versions are kept"
    near = [block for block in blocks if block["key"]["variant"] == "near"]
    assert [block["reached"] for block in near] == [[1, 1]] * 2, "any hand is near from the first step on"
    assert all(block["reached"] == [10, 10] for block in blocks if block not in near)
    assert main(words.split()) == 0
    assert (tmp_path / "results.jsonl").read_text() == first
    assert "Where success varies" in (tmp_path / "index.html").read_text()
    capsys.readouterr()


@pytest.mark.skipif(len(backend_names()) < 2, reason="learned on another backend than it is evaluated on")
def test_settings_of_the_engine_that_a_policy_was_learned_on_stay_with_it(tmp_path: Path) -> None:
    kept = policy_path("reach")
    learned = tmp_path / "learned"
    shutil.copytree(kept if kept.is_dir() else kept.parent, learned)
    record = json.loads((learned / "training.json").read_text())
    other = next(name for name in backend_names() if name != default_backend())
    record["settings"] |= {"backend": other, "setting": ["of_that_engine=1"]}
    (learned / "training.json").write_text(json.dumps(record))
    words = f"evaluate {learned} --backend {default_backend()} --episodes 1 --jobs 1 --set episode_length=0.1"
    assert main([*words.split(), "--output", str(tmp_path / "found")]) == 0


def test_processes_report_each_block_as_it_ends() -> None:
    plan = Plan("Reach", ("zero", "nowhere.safetensors"), (default_backend(),), {BASE: ()}, (0,), 1)
    own = EnvironmentSettings(task="Reach", backend=default_backend(), set=("episode_length=0.1",))
    settings = {(policy, default_backend()): own for policy in plan.policies}
    found: list[Block] = []
    with pytest.raises(OrbitError, match="nowhere"):
        run_blocks(plan, list(plan.blocks()), settings, 2, found.append)
    assert [each.key.policy for each in found] == ["zero"], "the second of the process's two blocks fails"


def test_a_process_that_is_ended_from_outside_is_told() -> None:
    plan = Plan("Reach", ("zero",), (default_backend(),), {BASE: ()}, (0, 1, 2), 1)

    def end_all(block: Block) -> None:
        time.sleep(0.2)  # so that none holds the queue
        for child in multiprocessing.active_children():
            child.kill()

    own = EnvironmentSettings(task="Reach", backend=default_backend(), set=("episode_length=4",))
    with pytest.raises(OrbitError, match=r"ended from outside.*smaller --jobs"):
        run_blocks(plan, list(plan.blocks()), {("zero", default_backend()): own}, 2, end_all)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are found in /proc")
def test_a_killed_evaluation_leaves_no_process_behind(tmp_path: Path) -> None:
    words = f"evaluate zero --task Reach --backend {default_backend()} --episodes 1 --seeds 2000 --jobs 2"
    words += f" --set episode_length=0.1 --variant near:position_tolerance=10 --output {tmp_path}"
    call = [sys.executable, "-c", "from orbit_core.cli import main; import sys; main(sys.argv[1:])", *words.split()]
    with subprocess.Popen(call, stdout=subprocess.DEVNULL) as command:
        found = tmp_path / "results.jsonl"
        wait_until(lambda: found.exists() and found.read_text().count("\n") > 1)
        children = [p for p in map(int, filter(str.isdigit, os.listdir("/proc"))) if parent_of(p) == command.pid]
        command.kill()
    assert children
    wait_until(lambda: not any(parent_of(child) for child in children))
    assert read_results(found)[1], "blocks that had ended are kept"


def parent_of(process: int) -> int:
    """Parent of a running process; 0 of one that is gone."""
    try:
        state, parent = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[:2]
    except OSError:
        return 0
    return 0 if state == "Z" else int(parent)


def wait_until(come: Callable[[], bool]) -> None:
    """Wait for up to two minutes, as long as a busy machine may take."""
    for _ in range(1200):
        if come():
            return
        time.sleep(0.1)
    raise AssertionError("has not come")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("reach reach", "named twice"),
        ("reach lift_pixels", "give --task"),
        ("nobody", "nobody"),
        ("reach --variant slippery", "NAME:KEY=VALUE"),
        ("reach --variant slippery:fricton=1", "fricton"),
        ("reach --backend nowhere", "nowhere"),
        ("reach --episodes 0", "episodes"),
        ("reach --axis ligth", "did you mean 'light'"),
        ("reach --axis start:4", "with a level of 1 to 3"),
        ("reach --axis start --axis start:2", "named twice among --axis and --variant"),
        ("reach --axis camera", "policy of task Reach sees none"),
        ("reach --axis language", "'reach' reads none"),
        ("reach --videos 10", "videos must be from 0 to 9"),
    ],
)
def test_bad_calls_are_told(words: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", *words.split(), "--output", str(tmp_path)]) != 0
    assert told in " ".join(capsys.readouterr().err.split())


def pictured() -> Task:
    return configured_task(EnvironmentSettings(task="Lift", cameras=("front:32x24",)))


def picture_of(environment: Environment) -> Tensor:
    seen, _ = environment.reset(3)
    group = seen["policy"]
    assert isinstance(group, dict)
    return next(value for value in group.values() if value.dim() == 4).float()


def test_disturbances_of_pictures_change_them_more_at_higher_levels_and_the_start_not_at_all() -> None:
    environment = Environment(pictured(), 1, default_backend())
    plain, start = picture_of(environment), environment.world.robots["robot"].joint_positions.clone()
    changes: dict[str, list[float]] = {}
    for axis in ("texture", "appearance"):
        for level in LEVELS:
            Disturbance(axis, level).apply(environment)
            changes.setdefault(axis, []).append(float((picture_of(environment) - plain).abs().mean()))
        environment.world.robots["robot"].set_colors(
            torch.ones(1, len(environment.world.robots["robot"].link_names), 3)
        )
    environment.close()
    for axis in ("light", "camera"):
        for level in (1, 3):
            task = pictured()
            Disturbance(axis, level).prepare(task)
            other = Environment(task, 1, default_backend())
            changes.setdefault(axis, []).append(float((picture_of(other) - plain).abs().mean()))
            torch.testing.assert_close(other.world.robots["robot"].joint_positions, start)
            other.close()
    assert all(min(found) > 0.5 for found in changes.values()), changes
    for axis in ("texture", "light", "camera"):
        assert changes[axis] == sorted(changes[axis]), changes


def test_the_axis_of_starts_spreads_the_joints() -> None:
    spreads = []
    for level in LEVELS:
        task = configured_task(EnvironmentSettings(task="Lift"))
        Disturbance("start", level).prepare(task)
        environment = Environment(task, 32, default_backend())
        environment.reset(0)
        robot = environment.world.robots["robot"]
        spreads.append(float((robot.joint_positions - robot.home_positions).abs().max()))
        environment.close()
    assert spreads == sorted(spreads)
    assert 0.05 < spreads[0] <= 0.151
    task = configured_task(EnvironmentSettings(task="Lift"))
    task.events = None
    with pytest.raises(ConfigurationError, match="task Lift lacks"):
        Disturbance("start", 1).prepare(task)


def test_the_axis_of_language_rewords_the_prompt_and_keeps_the_rest_of_the_address() -> None:
    environment = Environment(configured_task(EnvironmentSettings(task="Reach")), 1, default_backend())
    told = Disturbance("language", 1).reword("ws://127.0.0.1:8000/?observation/state=goal&prompt=go+there", environment)
    address = ServerAddress.parse(told)
    assert (address.prompt, address.keys) == ("please go there", (("observation/state", ("goal",)),))
    told = Disturbance("language", 2).reword("ws://127.0.0.1:8000", environment)
    assert ServerAddress.parse(told).prompt == "the job of the robot: move the hand to the goal, nothing more"
    environment.close()


def test_failures_are_filmed_and_shown_by_their_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("av", reason="the capability is videos, which need PyAV")
    words = f"evaluate still=zero --task Reach --backend {default_backend()} --episodes 3 --jobs 1 --videos 2"
    words += f" --set episode_length=0.2 --axis start:2 --output {tmp_path}"
    assert main(words.split()) == 0
    text = (tmp_path / "index.html").read_text()
    films = re.findall(r'src="(failures/\w+.mp4)"', text)
    assert films
    assert all((tmp_path / film).stat().st_size > 1000 for film in films)
    assert "2 of 2 failed again" in text
    plan, blocks = read_results(tmp_path / "results.jsonl")
    assert plan.recipe("zero") == "still"
    assert [block.key.variant for block in blocks] == [BASE, "start 2"]
    assert "begins differently" not in text
    # Films of the same results are kept, and others deleted.
    times = {film: (tmp_path / film).stat().st_mtime_ns for film in films}
    (tmp_path / films[0]).unlink()
    assert main(words.split()) == 0
    assert (tmp_path / "index.html").read_text() == text
    assert [(tmp_path / film).stat().st_mtime_ns == time for film, time in times.items()] == [
        film != films[0] for film in films
    ]
    assert main(words.replace("--videos 2", "--videos 1").split()) == 0
    assert not any((tmp_path / film).exists() for film in films)
    capsys.readouterr()
