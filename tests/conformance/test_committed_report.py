"""The committed report is of whole runs on every backend, and its page shows them and names the archive."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from orbit_assets.catalogue import robot_names
from orbit_conformance.jobs import Kind
from orbit_conformance.report.page import page_of, render
from orbit_conformance.report.ranking import rankings
from orbit_conformance.results import Result, load
from orbit_conformance.scenarios import SCENARIOS
from orbit_conformance.tolerances import loose_tolerances

ROBOTS = [name for name in robot_names() if not name.startswith(("maniskill_", "so101"))]
ENGINES = ("bullet", "mujoco", "sapien", "warp")
MATTER_TASKS = (
    "Cloth-Dropping", "Cloth-Folding", "Cloth-Lifting", "Cloth-Spreading", "Flag-Hoisting", "Rope-Reshaping"
)  # fmt: skip
DOCS = Path(__file__).parents[2] / "docs"
FOLDER = DOCS / "conformance"
MOST_BYTES = 5 * 2**18
"""Of the page and its data together: what is larger belongs into the archive."""


@pytest.fixture(scope="module")
def result() -> Result:
    return load(FOLDER)


def test_every_engine_is_judged_and_none_is_other_than_it_declares(result: Result) -> None:
    assert result.header.settings.backends == ENGINES
    assert not result.objections
    assert {record.job.kind for record in result.records} == {*Kind}
    assert not result.header.settings.quick
    assert not result.header.settings.backend_settings
    assert [str(loose) for loose in loose_tolerances(result)] == []


def test_robots_tasks_and_matter_are_there_on_every_engine(result: Result) -> None:
    robots = {(record.job.name, record.job.backend) for record in result.of(Kind.ROBOT)}
    assert robots == {(name, engine) for name in ROBOTS for engine in ENGINES}
    known = {scenario.name for scenario in SCENARIOS if scenario.of_matter}
    matter = {(r.job.name, r.job.backend) for r in result.judged if r.job.matter == "orbit-matter"}
    assert matter == {(name, engine) for name in known for engine in ENGINES}
    assert {r.job.matter for r in result.of(Kind.SCENARIO)} == {"", "orbit-matter", "native"}
    tasks = {(record.job.name, record.job.backend) for record in result.of(Kind.TASK)}
    assert tasks >= {(task, engine) for task in MATTER_TASKS for engine in ENGINES}


def test_the_page_is_that_of_its_data_and_names_the_archive(result: Result) -> None:
    """Else: orbit conformance report docs/conformance."""
    page = (FOLDER / "report.html").read_text()
    assert page == render(page_of(result, FOLDER))
    assert result.archive is not None
    assert result.archive.name in page
    assert result.archive.sha256 in page
    assert all(f"{origin.started} to {origin.finished}" in page for origin in result.header.origins)
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < MOST_BYTES


def test_every_use_has_a_ranking_and_every_link_has_its_place_in_the_page(result: Result) -> None:
    for ranking in rankings(result):
        ranked = [placing.backend for placing in ranking.placings]
        assert {*ranked, *(backend for backend, _ in ranking.unmeasured)} == {*ENGINES}
        assert len(ranked) == (1 if ranking.use.key == "gpu" else len(ENGINES)), ranking.unmeasured
    page = (FOLDER / "report.html").read_text()
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len({*ids})
    assert {*re.findall(r'href="#([^"]+)"', page)} <= {*ids}


def test_rates_on_a_gpu_are_those_of_the_documentation_and_of_the_readme(result: Result) -> None:
    kept = json.loads((DOCS / "figures" / "gpu_rates.json").read_text())
    shown = "".join((DOCS / place / "performance.md").read_text() for place in (".", "measured"))
    assert [rate.env_steps_per_second for rate in result.benchmarks] == [rate["env_steps_per_second"] for rate in kept]
    assert all(f"{rate.env_steps_per_second:,}" in shown for rate in result.benchmarks)
    rows = [line for line in (DOCS.parent / "README.md").read_text().splitlines() if "gpu/bench.py" in line]
    rates = {(rate.hardware, f"{rate.env_steps_per_second:,}", f"`{rate.command}`") for rate in result.benchmarks}
    assert rows
    assert {(hardware, rate, command) for _, _, hardware, rate, _, command, _ in (
        [cell.strip() for cell in row.split("|")] for row in rows
    )} <= rates  # fmt: skip
