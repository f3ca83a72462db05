"""Evaluation of policies: paired statistics against known values, files that go on, and the command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.interfaces import ConfigurationError
from orbit_learn.evaluation.page import page
from orbit_learn.evaluation.results import BASE, Block, BlockKey, Plan, ResultFile, read_results
from orbit_learn.evaluation.statistics import failure_kinds, paired_difference, success_of, variance_shares

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
        {"start": 0.0, "policy": 1.0, "engine": 0.0, "variant": 0.0, "together and chance": 0.0}
    )
    by_start = [block("one", "1010"), block("two", "1010")]
    assert variance_shares(by_start)["start"] == pytest.approx(1.0)
    assert variance_shares([block("one", "1111")]) == {}


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


def test_another_evaluation_in_the_file_is_told(tmp_path: Path) -> None:
    ResultFile(tmp_path / "results.jsonl", PLAN)
    with pytest.raises(ConfigurationError, match="differs in seeds, episodes"):
        ResultFile(tmp_path / "results.jsonl", replace(PLAN, seeds=(0, 1), episodes=5))
    (tmp_path / "other.jsonl").write_text("[]\n")
    with pytest.raises(ConfigurationError, match="no results"):
        ResultFile(tmp_path / "other.jsonl", PLAN)


def test_the_page_needs_nothing_else_and_hides_no_name() -> None:
    text = page(replace(PLAN, policies=("one", "<two>")), [block("one", "1100"), block("<two>", "1111")])
    assert "&lt;two&gt;" in text
    assert "<two>" not in text
    assert "http" not in text


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
    ],
)
def test_bad_calls_are_told(words: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", *words.split(), "--output", str(tmp_path)]) != 0
    assert told in " ".join(capsys.readouterr().err.split())
