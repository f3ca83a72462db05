"""A small run in this process: all kinds of jobs, what they leave in the folder, and the page that is made of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from orbit_conformance.episodes import TaskResult
from orbit_conformance.execution import RECORDING, TRACES, VIDEO, execute
from orbit_conformance.jobs import Job, Kind, plan
from orbit_conformance.report.page import write_report
from orbit_conformance.results import Ending, Result, load
from orbit_conformance.runner import run
from orbit_conformance.scenarios import SCENARIOS
from orbit_conformance.settings import Part, choose
from orbit_conformance.verdict import Status
from orbit_core.interfaces import UnknownNameError
from orbit_core.rollout.estimates import Estimate

from .conftest import PAIR, Here


@pytest.fixture(scope="module")
def result(finished_run: Path) -> Result:
    return load(finished_run)


def test_every_kind_of_job_is_done(result: Result, finished_run: Path) -> None:
    assert {(r.job.kind, r.job.backend) for r in result.records if r.job.kind is not Kind.REPLAY} == {
        (kind, backend) for kind in Kind for backend in PAIR if kind is not Kind.REPLAY
    }
    assert [r.reason for r in result.records if r.ending is not Ending.DONE] == []
    files = {Kind.SCENARIO: TRACES, Kind.TASK: RECORDING, Kind.VIDEO: VIDEO}
    for record in result.records:
        expected = files.get(record.job.kind)
        assert record.files == ((expected,) if expected else ())
        assert all((finished_run / record.job.key / name).stat().st_size > 0 for name in record.files)


def test_what_was_recorded_on_one_backend_is_replayed_on_the_other(result: Result) -> None:
    (replayed,) = result.of(Kind.REPLAY)
    assert replayed.replay is not None
    assert (replayed.replay.recorded_on, replayed.job.backend) == tuple(PAIR)
    (parting,) = result.partings
    assert {parting.reference, parting.backend} == {*PAIR}
    assert parting.things
    assert parting.things[0].median[0] < 1e-3, "both begin in the same state"


def test_a_policy_acts_on_backends_that_it_was_not_learned_on(result: Result) -> None:
    (info,) = result.header.policies
    for record in result.of(Kind.TRANSFER):
        assert record.played is not None
        assert (record.job.name, record.played.task, record.played.num_envs) == (info.name, "Reach", 2)
        assert record.played.success.high >= info.least_success
        assert record.played.metrics["position_error_m"].value < 0.05, "it goes to the goal"


def test_the_page_shows_all_of_it(finished_run: Path) -> None:
    page = write_report(finished_run).read_text()
    for words in (
        "Does the expert reach the goal?",
        "Free motion",
        "Distance over time",
        "Environment steps per second",
    ):
        assert words in page
    for backend in PAIR:
        assert f'src="video/Reach/{backend}/{VIDEO}"' in page
    assert page.count("<svg") == 5
    assert "http://" not in page
    assert "https://" not in page


def test_an_exception_is_the_jobs_own(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object) -> None:
        raise ZeroDivisionError("no time")

    monkeypatch.setattr("orbit_conformance.execution.run_scenario", fail)
    settings = choose(backends=PAIR, scenarios=["free_fall"])
    record = execute(Job(Kind.SCENARIO, "free_fall", PAIR[0], 0.005), settings, {}).record
    assert (record.ending, record.reason, record.status) == (Ending.ERROR, "ZeroDivisionError: no time", Status.FAIL)


@pytest.mark.parametrize(("rate", "counts"), [(1.0, [1]), (0.0, [1, 2])])
def test_one_episode_that_misses_is_looked_at_again(
    rate: float, counts: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def run_task(task: str, backend: str, *, num_envs: int, seed: int, **_: object) -> TaskResult:
        asked.append(num_envs)
        success = Estimate(rate, 0.0, 1.0)
        return TaskResult(task, backend, seed, {}, num_envs, success, {}, success, None, expert_success=0.8)

    monkeypatch.setattr("orbit_conformance.execution.run_task", run_task)
    settings = choose(backends=PAIR, tasks=["Nut-Bolt"], quick=True)
    record = execute(Job(Kind.TASK, "Nut-Bolt", PAIR[0]), settings, {}).record
    assert asked == counts
    assert record.task is not None
    assert record.task.num_envs == counts[-1]


def test_naming_scenarios_leaves_the_tasks_out() -> None:
    assert choose(scenarios=["free_fall"]).parts == (Part.SCENARIOS,)
    assert choose(tasks=["Lift"]).parts == (Part.TASKS, Part.TRANSFERS, Part.THROUGHPUT)
    assert choose().parts == tuple(Part)
    assert choose().scenarios == tuple(scenario.name for scenario in SCENARIOS)


def test_a_full_run_sweeps_time_steps_and_a_quick_one_does_not() -> None:
    def steps(quick: bool) -> list[float]:
        (phase,) = plan(choose(backends=PAIR[:1], scenarios=["free_fall"], quick=quick))
        return [job.time_step for job in phase.jobs]

    assert steps(quick=True) == [0.005]
    assert steps(quick=False) == [0.01, 0.005, 0.0025, 0.00125]


def test_scenarios_of_matter_are_run_with_every_solver_and_natively() -> None:
    """A solver is swept over its own steps; an engine without matter of its own is asked once, for its reason."""
    (phase,) = plan(choose(backends=["sapien"], scenarios=["rope_tow"]))
    runs = [(job.matter, job.time_step, job.substep) for job in phase.jobs]
    swept = [("orbit-matter", 0.005, substep) for substep in (0.0, 0.0025, 0.00125, 0.000625, 0.0003125)]
    assert runs == [*swept, ("native", 0.005, 0.0)]
    (quick,) = plan(choose(backends=["sapien"], scenarios=["rope_tow"], matters=["orbit-matter"], quick=True))
    assert [job.key for job in quick.jobs] == ["scenario/rope_tow/sapien/0.005/orbit-matter"]
    with pytest.raises(UnknownNameError, match="did you mean 'orbit-matter'"):
        choose(matters=["orbit-mater"])


def test_the_page_shows_matter_by_solver_and_the_engines_own(tmp_path: Path) -> None:
    settings = choose(backends=["mujoco", "sapien"], scenarios=["rope_tow"], quick=True)
    result = run(settings, tmp_path, Here())
    standing = {(r.job.backend, r.job.matter): r.status for r in result.records}
    assert standing[("mujoco", "orbit-matter")] is standing[("sapien", "orbit-matter")] is Status.PASS
    assert standing[("sapien", "native")] is Status.UNSUPPORTED
    page = write_report(tmp_path).read_text()
    assert "rope_tow, orbit-matter" in page
    assert "rope_tow, native" in page
    assert "mujoco, orbit-matter" in page


def test_keys_are_unique() -> None:
    keys = [job.key for phase in plan(choose()) for job in phase.jobs]
    assert len(keys) == len(set(keys))
