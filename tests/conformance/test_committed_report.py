"""The committed report is of a whole run on every backend, and what its page shows is there."""

from __future__ import annotations

from pathlib import Path

from orbit_conformance.jobs import Kind
from orbit_conformance.results import load
from orbit_conformance.scenarios import SCENARIOS
from orbit_conformance.tolerances import loose_tolerances
from orbit_core.robots import robot_names

ROBOTS = [name for name in robot_names() if not name.startswith("maniskill_")]
ENGINES = ("bullet", "mujoco", "sapien", "warp")
MATTER_TASKS = (
    "Cloth-Dropping", "Cloth-Folding", "Cloth-Lifting", "Cloth-Spreading", "Flag-Hoisting", "Rope-Reshaping"
)  # fmt: skip
FOLDER = Path(__file__).parents[2] / "docs" / "conformance"


def test_every_engine_is_in_the_report_and_its_videos_are_there() -> None:
    """Scenarios, and apart from them tasks, kept policies and throughput, which are run anew less often."""
    assert {*load(FOLDER).header.settings.backends} >= {*ENGINES}
    folder = FOLDER / "tasks"
    result = load(folder)
    assert {*result.header.settings.backends} >= {*ENGINES}
    page = (folder / "report.html").read_text()
    videos = [f"{record.job.key}/{name}" for record in result.records for name in record.files if name.endswith("mp4")]
    assert videos
    assert all(name in page and (folder / name).exists() for name in videos)
    assert all(f"{origin.started} to {origin.finished}" in page for origin in result.header.origins)
    assert not result.objections


def test_robots_have_a_report_of_their_own_with_every_engine() -> None:
    result = load(FOLDER / "robots")
    assert {*result.header.settings.backends} == {"bullet", "mujoco", "sapien", "warp"}
    jobs = {(record.job.name, record.job.backend) for record in result.of(Kind.ROBOT)}
    assert jobs == {(name, engine) for name in ROBOTS for engine in result.header.settings.backends}
    assert not result.objections


def test_matter_has_a_report_of_its_own_with_every_engine() -> None:
    """Scenarios through the solver on every engine; tasks with the courses of their key points."""
    result = load(FOLDER / "matter")
    known = {scenario.name for scenario in SCENARIOS if scenario.of_matter}
    jobs = {(r.job.name, r.job.backend) for r in result.judged if r.job.matter == "orbit-matter"}
    assert jobs == {(name, engine) for name in known for engine in ENGINES}
    assert {r.job.matter for r in result.records} == {"orbit-matter", "native"}
    assert not result.objections
    assert [str(loose) for loose in loose_tolerances(result)] == []
    courses = load(FOLDER / "matter" / "tasks").courses
    assert {(course.task, course.backend) for course in courses} == {
        (task, engine) for task in MATTER_TASKS for engine in ENGINES
    }


def test_all_are_whole_and_no_tolerance_is_loose_without_a_reason() -> None:
    results = [load(FOLDER), load(FOLDER / "robots"), load(FOLDER / "tasks")]
    for result in results:
        assert not result.header.settings.quick
        assert not result.header.settings.backend_settings
    assert {record.job.kind for result in results for record in result.records} == {*Kind}
    assert [str(loose) for loose in loose_tolerances(results[0])] == []
