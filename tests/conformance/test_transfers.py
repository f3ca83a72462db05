"""Learned policies on backends that they were not learned on: verdicts, refusals, comparisons and the page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from orbit_conformance.episodes import TaskResult
from orbit_conformance.execution import execute
from orbit_conformance.hardware import Hardware
from orbit_conformance.jobs import Job, Kind, plan
from orbit_conformance.merge import compare
from orbit_conformance.report.page import write_report
from orbit_conformance.results import Ending, Header, PolicyInfo, Record, Result, load, save
from orbit_conformance.settings import Part, Settings, choose
from orbit_conformance.sources import source_digests, sources_of
from orbit_conformance.transfer import TransferResult, judge, transfer
from orbit_conformance.verdict import Status
from orbit_core import backends
from orbit_core.backends import default_backend
from orbit_core.interfaces import Capabilities, Capability, unsupported
from orbit_core.rollout.estimates import mean, proportion
from orbit_learn.pretrained import PretrainedPolicy, TransferGap

SLIPS = TransferGap(backend="slippery", least_success=0.6, reason="its bars are oiled")
KEPT = PretrainedPolicy("pull", Path(), "Pulls", least_success=0.9, gaps=(SLIPS,))


@pytest.mark.parametrize(
    ("backend", "successes", "episodes", "status"),
    [
        ("dry", 98, 100, Status.PASS),
        ("dry", 85, 100, Status.PASS),  # chance may be why: the interval reaches 0.907
        ("dry", 80, 100, Status.FAIL),
        ("dry", 6, 8, Status.PASS),
        ("dry", 4, 8, Status.FAIL),
        ("slippery", 76, 100, Status.GAP),
        ("slippery", 6, 8, Status.GAP),
        ("slippery", 48, 100, Status.FAIL),
        ("slippery", 92, 100, Status.PASS),  # not yet surely above
        ("slippery", 99, 100, Status.STALE),
    ],
)
def test_a_miss_counts_beyond_chance_and_against_what_is_declared(
    backend: str, successes: int, episodes: int, status: Status
) -> None:
    found, reason = judge(KEPT, backend, proportion(successes, episodes))
    assert found is status
    assert bool(reason) == (status is not Status.PASS)
    assert (SLIPS.reason in reason) == (status is Status.GAP)


def test_a_backend_that_lacks_what_the_task_needs_is_unsupported(monkeypatch: pytest.MonkeyPatch) -> None:
    backend = backends.backend(default_backend())
    able = {capability: backend.capabilities()[capability] for capability in Capability}
    lacking = Capabilities({**able, Capability.GRAVITY_COMPENSATION: unsupported("it is too heavy")})
    monkeypatch.setattr(type(backend), "capabilities", lambda self: lacking)
    settings = choose(backends=[backend.name], parts=["transfers"], quick=True)
    record = execute(Job(Kind.TRANSFER, "reach", backend.name), settings, {}).record
    assert (record.ending, record.status) == (Ending.UNSUPPORTED, Status.UNSUPPORTED)
    assert "it is too heavy" in record.why
    assert record.played is None


def test_the_part_has_a_job_for_each_policy_on_each_backend() -> None:
    chosen = choose(parts=["transfers"])
    jobs = [job for phase in plan(chosen) for job in phase.jobs if not job.renderer]
    assert {job.kind for job in jobs} == {Kind.TRANSFER}
    assert {(job.name, job.backend) for job in jobs} == {(p, b) for p in chosen.policies for b in chosen.backends}
    assert choose(parts=["transfers"], tasks=["Reach"], quick=True).policies == ("reach",)
    assert not choose(scenarios=["free_fall"]).policies


def test_what_sees_pictures_is_tried_on_those_of_every_renderer_over_one_physics() -> None:
    chosen = choose(parts=["transfers"], tasks=["Reach"])
    assert chosen.policies == ("reach", "reach_pixels")
    drawn = [job for phase in plan(chosen) for job in phase.jobs if job.renderer]
    (backend,) = {job.backend for job in drawn}
    assert {job.name for job in drawn} == {"reach_pixels"}
    assert {job.renderer for job in drawn} == {*chosen.renderers} - {backend}
    assert {*chosen.backends} <= {*chosen.renderers}, "all of them draw"
    assert all(f"renderer '{job.renderer}'" in source_digests(chosen) for job in drawn)
    assert all(f"renderer '{job.renderer}'" in sources_of(job) for job in drawn)


def test_a_gap_may_be_of_a_renderer_whatever_simulates() -> None:
    grey = TransferGap(renderer="grey", least_success=0.3, reason="its cubes are as grey as its benches")
    kept = PretrainedPolicy("pull", Path(), "Pulls", least_success=0.9, gaps=(SLIPS, grey))
    assert judge(kept, "dry", proportion(40, 100), "grey")[0] is Status.GAP
    assert judge(kept, "grey", proportion(40, 100))[0] is Status.GAP, "it draws itself"
    assert judge(kept, "dry", proportion(40, 100))[0] is Status.FAIL
    assert judge(kept, "slippery", proportion(76, 100), "grey")[1].endswith(SLIPS.reason), "the first that holds"


def test_a_policy_that_sees_pictures_acts_on_what_another_renderer_draws() -> None:
    """One episode, on the fastest renderer: whether it does its task is for tests/learning to hold."""
    found = transfer("reach_pixels", "mujoco", num_envs=1, renderer="warp").result
    assert found.metrics["position_error_m"].value < 0.05, "it goes to the goal"
    assert found.fields["observations"] == "pixels"


def result(successes: int, errors: float = 0.01, declared: tuple[TransferGap, ...] = (SLIPS,)) -> Result:
    """Results of one policy: as required where it was learned, and with so many successes of 100 elsewhere."""
    info = PolicyInfo("pull", "Pulls a bar", "Cabinet", "dry", "a library", 250, KEPT.least_success, declared)
    records = tuple(record(backend, *of) for backend, of in (("dry", (100, 0.01)), ("slippery", (successes, errors))))
    settings = Settings(
        backends=("dry", "slippery", "frozen"), scenarios=(), tasks=(), parts=(Part.TRANSFERS,), policies=("pull",)
    )
    frozen = Record(Job(Kind.TRANSFER, "pull", "frozen"), Ending.UNSUPPORTED, "nothing moves")
    header = Header(
        settings=settings,
        versions={},
        hardware=Hardware("a machine", 2, 1.0, (), "system"),
        started="2026-01-01",
        scenarios=(),
        backends=(),
        policies=(info,),
    )
    return Result(header=header, records=(*records, frozen), finished="2026-01-02")


def record(backend: str, successes: int, error: float) -> Record:
    success = proportion(successes, 100)
    metrics = {"distance_m": mean([error * (1.0 + 0.01 * n) for n in range(100)])}
    task = TaskResult("Cabinet", backend, 0, {}, 100, success, metrics, mean([1.0, 2.0]), None)
    found = TransferResult(*judge(KEPT, backend, success), task)
    return Record(Job(Kind.TRANSFER, "pull", backend), Ending.DONE, transfer=found)


def test_a_result_is_read_as_it_was_written(tmp_path: Path) -> None:
    written = result(76)
    save(written, tmp_path)
    read = load(tmp_path)
    assert read.header == written.header
    assert [r.status for r in read.records] == [Status.PASS, Status.GAP, Status.UNSUPPORTED]
    assert read.records[1].played == load(tmp_path).records[1].played
    assert read.records[1].played.success.value == 0.76  # type: ignore[union-attr]
    assert not read.objections
    assert [r.job.backend for r in result(30).objections] == ["slippery"]


def test_a_drop_is_worse_where_the_intervals_lie_apart() -> None:
    def changes(before: Result, after: Result) -> list[tuple[str, str, bool]]:
        return [(c.job.backend, c.what, c.better) for c in compare(before, after).changes]

    assert changes(result(90), result(85)) == [("slippery", "status", False)], "80 and 90 of 100 are within chance"
    assert changes(result(95), result(70)) == [("slippery", "status", False), ("slippery", "success", False)]
    assert changes(result(70), result(60)) == []
    assert changes(result(70, errors=0.1), result(70, errors=0.01)) == [("slippery", "distance_m", True)]
    assert compare(result(95), result(70)).worse_status


def test_the_page_shows_what_comes_of_pictures_that_others_draw(tmp_path: Path) -> None:
    plain = result(76)
    drawn = replace(record("dry", 40, 0.01), job=Job(Kind.TRANSFER, "pull", "dry", renderer="grey"))
    settings = replace(plain.header.settings, renderers=("dry", "grey", "paint"))
    save(replace(plain, header=replace(plain.header, settings=settings), records=(*plain.records, drawn)), tmp_path)
    page = write_report(tmp_path).read_text()
    section = page[page.index("Pictures that other renderers draw") : page.index("Where a policy is known to do worse")]
    assert "physics of dry" in section
    cells = section.split("<td>")[1:]
    assert [cell.split('class="plain ')[1].split('"')[0] for cell in cells] == ["pass", "fail", "absent"]
    assert ["learned here" in cell for cell in cells] == [True, False, False]
    assert "40.0 % [" in cells[1]
    matrix = page[: page.index('<section id="transfers">')]
    assert "40.0 %" not in matrix, "the matrix shows what backends draw themselves"


def test_the_page_shows_who_learned_where_and_why_it_does_worse(tmp_path: Path) -> None:
    save(result(76), tmp_path)
    page = write_report(tmp_path).read_text()
    section = page[page.index('<section id="transfers">') : page.index('<section id="gaps">')]
    assert "learned on dry with a library, iteration 250; held to 90 %" in section
    cells = section.split("<td>")[1:4]
    assert "learned here" in cells[0]
    assert ["learned here" in cell for cell in cells] == [True, False, False]
    assert "76.0 % [66.8, 83.3]" in cells[1]
    assert "distance_m: " in cells[1]
    assert [cell.split('class="plain ')[1].split('"')[0] for cell in cells] == ["pass", "gap", "unsupported"]
    assert "nothing moves" in cells[2]
    assert "its bars are oiled" in section.split("Where a policy is known to do worse")[1]
    matrix = page[: page.index('<section id="transfers">')]
    assert "Learned policies" in matrix
    assert "76.0 % [66.8, 83.3]" in matrix


@pytest.mark.parametrize(("successes", "status"), [(70, Status.FAIL), (74, Status.PASS), (95, Status.PASS)])
def test_an_expert_is_held_to_the_rate_of_its_task(successes: int, status: Status) -> None:
    played = (proportion(successes, 100), {}, mean([1.0, 2.0]), None)
    task = TaskResult("Lift", "dry", 0, {}, 100, *played, expert_success=0.8)
    record = Record(Job(Kind.TASK, "Lift", "dry"), Ending.DONE, task=task)
    assert record.status is status
    assert record.why == ("success is 70.0 % [60.4, 78.1], below 0.8" if status is Status.FAIL else "")
