"""Engines are ranked by figures of the result alone, by the rule that the page states."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest

from orbit_conformance.hardware import Hardware
from orbit_conformance.jobs import Job, Kind
from orbit_conformance.report.page import differences
from orbit_conformance.report.ranking import USES, Figure, Missing, Ranking, Use, Value, rank
from orbit_conformance.results import Ending, Header, Record, Result, ScenarioInfo, ScenarioResult
from orbit_conformance.scenario import Metric
from orbit_conformance.settings import Part, Settings
from orbit_conformance.throughput import Benchmark, RawRate, Throughput
from orbit_conformance.verdict import Status

CONTACT, GPU, DETERMINISM = (next(u for u in USES if u.key == key) for key in ("contact", "gpu", "determinism"))
ENGINES = ("one", "two", "three")


def result(*records: Record, groups: tuple[str, ...] = ("Grasp", "Rest"), **changes: Any) -> Result:
    metric = Metric(name="drift", unit="m", tolerance=0.1, meaning="how far")
    infos = tuple(ScenarioInfo(group.lower(), group, "?", "0", "none", 0.005, (metric,)) for group in groups)
    header = Header(
        settings=Settings(backends=ENGINES, scenarios=(), tasks=("Lift",), parts=(Part.SCENARIOS,)),
        versions={},
        hardware=Hardware("a machine", 2, 1.0, (), "system"),
        started="2026-01-01",
        scenarios=infos,
        backends=(),
    )
    return dataclasses.replace(Result(header=header, records=records, finished="2026-01-02"), **changes)


def scenario(name: str, backend: str, status: Status = Status.PASS, error: float = 0.0) -> Record:
    job = Job(Kind.SCENARIO, name, backend, 0.005)
    if status is Status.UNSUPPORTED:
        return Record(job, Ending.UNSUPPORTED, "it has none")
    return Record(job, Ending.DONE, scenario=ScenarioResult(status, "", {"difference": error}, 1.0, 0.5))


def throughput(backend: str, rate: float, hardware: str, device: str = "cpu") -> Record:
    raw = RawRate("alone", 2.0 * rate, 1.0, 0.5, (0.5, 0.5))
    measured = Throughput(64, rate, 1.0, raw, {}, None, 1.0, 1.0, hardware)
    return Record(Job(Kind.THROUGHPUT, "Lift", backend, num_envs=64), Ending.DONE, device=device, throughput=measured)


def column(**scores: float) -> Figure:
    """A figure that some engines have, in words of one digit."""

    def read(_: Result, backend: str) -> Value | Missing:
        return Value(f"{scores[backend]:.0f}", scores[backend]) if backend in scores else Missing("it was not run")

    return Figure("", "", read)


def order(ranking: Ranking) -> list[tuple[int, str]]:
    return [(placing.place, placing.backend) for placing in ranking.placings]


def values_of(figure: Figure, found: Result) -> list[str]:
    """The texts of all engines; of one that is not measured the reason."""
    values = [figure.read(found, backend) for backend in ENGINES]
    return [value.text if isinstance(value, Value) else value.reason for value in values]


@pytest.mark.parametrize(
    ("figures", "places"),
    [
        # Ranks 1 + 3 + 3, 2 + 1 + 1 and 3 + 2 + 2: the best in one figure may come second, before its equal in sum.
        (((9, 1, 1), (5, 9, 9), (4, 5, 5)), [(1, "two"), (2, "one"), (3, "three")]),
        (((9, 1, 5), (5, 9, 5), (1, 1, 5)), [(1, "one"), (2, "two"), (3, "three")]),
        # Figures that read alike share a rank, also where their last digits differ.
        (((9.1, 5, 5), (9.2, 5, 5), (9.3, 5, 5)), [(1, "one"), (1, "two"), (1, "three")]),
    ],
)
def test_the_sum_of_three_ranks_orders_engines_and_the_first_figure_decides_ties(
    figures: tuple[tuple[float, ...], ...], places: list[tuple[int, str]]
) -> None:
    first, second, third = (column(**dict(zip(ENGINES, row, strict=True))) for row in zip(*figures, strict=True))
    assert order(rank(Use("any", "Any", (first, second, third)), result())) == places


def test_an_engine_without_a_figure_is_listed_and_not_ranked() -> None:
    whole = column(one=1, two=2, three=3)
    ranking = rank(Use("any", "Any", (whole, whole, column(one=1, three=1))), result())
    assert order(ranking) == [(1, "three"), (2, "one")]
    assert ranking.unmeasured == (("two", "it was not run"),)


def test_gaps_and_refusals_count_as_misses_and_a_scenario_that_was_not_run_leaves_no_figure() -> None:
    found = result(
        scenario("grasp", "one"),
        scenario("rest", "one", Status.GAP),
        scenario("grasp", "two", Status.UNSUPPORTED),
        scenario("rest", "two"),
        scenario("grasp", "three"),
    )
    assert values_of(CONTACT.figures[0], found) == ["1 of 2", "1 of 2", "1 of 2 scenarios not run"]
    values = [CONTACT.figures[0].read(found, backend) for backend in ENGINES[:2]]
    assert [miss.name for value in values if isinstance(value, Value) for miss in value.misses] == ["rest", "grasp"]


def test_speeds_are_compared_on_the_machine_with_the_most_engines() -> None:
    found = result(
        throughput("one", 10.0, "slow machine"),
        throughput("two", 20.0, "slow machine"),
        throughput("three", 900.0, "fast machine"),
    )
    assert values_of(CONTACT.figures[2], found) == ["10/s", "20/s", "Lift not measured on slow machine"]
    (value,) = (CONTACT.figures[2].read(found, "one"),)
    assert isinstance(value, Value)
    assert value.detail == "64 environments, slow machine"


def test_many_environments_on_a_gpu_are_judged_by_what_was_measured_on_one() -> None:
    rate = Benchmark(
        task="Lift", action="a", backend="one", num_envs=4096, env_steps_per_second=5000, hardware="a GPU", command="x"
    )
    found = result(throughput("two", 9000.0, "a CPU"), benchmarks=(rate,))
    absent = "Lift not measured on a GPU"
    assert values_of(GPU.figures[0], found) == ["5,000/s", absent, absent]
    assert values_of(GPU.figures[2], found)[0] == "the engine alone was not measured with Lift"
    assert values_of(GPU.figures[0], result(throughput("two", 9000.0, "a GPU", "cuda:0"))) == [
        absent,
        "9,000/s",
        absent,
    ]


def test_the_smaller_error_is_the_better_and_one_that_is_no_number_is_not_measured() -> None:
    errors = {"one": 0.5, "two": 0.0, "three": math.nan}
    records = (scenario("snapshot", name, error=error) for name, error in errors.items())
    found = result(*records, groups=("snapshot",))
    values = [DETERMINISM.figures[2].read(found, backend) for backend in ENGINES]
    scores = [value.score for value in values if isinstance(value, Value)]
    assert scores == [-0.5, 0.0]
    assert isinstance(values[2], Missing)


@pytest.mark.parametrize("use", USES, ids=lambda use: use.key)
def test_a_result_of_nothing_ranks_nobody(use: Use) -> None:
    ranking = rank(use, result(groups=()))
    assert not ranking.placings
    assert [backend for backend, _ in ranking.unmeasured] == [*ENGINES]
    assert differences(result(groups=())) == ()
