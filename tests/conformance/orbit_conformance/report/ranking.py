"""Rankings of engines by use: three figures for each use, computed from a result, and the rule that orders them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from orbit_conformance.jobs import Kind
from orbit_conformance.results import Record, Result, ScenarioInfo
from orbit_conformance.verdict import Status

RULE = (
    "Each of the three figures gives the engines a rank; figures that read alike share one. The sum of the three ranks "
    "orders the engines, and the first figure decides ties. A declared gap and a refused scenario or task count as "
    "misses. Speeds are compared on one machine only: the one with the most engines. An engine without one of the "
    "figures is listed as not measured and gets no place."
)


@dataclass(frozen=True)
class Miss:
    """A scenario, robot or task in which an engine falls short."""

    name: str
    """Name of the scenario, robot or task."""
    anchor: str
    """Element of the page that shows it."""


@dataclass(frozen=True)
class Value:
    """One figure of one engine."""

    text: str
    """The figure as readers see it; equal texts share a rank."""
    score: float
    """Larger is better."""
    anchor: str = ""
    """Element of the page that shows the figure; the list of misses where empty."""
    misses: tuple[Miss, ...] = ()
    """Things behind the figure in which the engine falls short."""
    detail: str = ""
    """Condition of the measurement, such as the machine."""


@dataclass(frozen=True)
class Missing:
    """Reason for which a figure of an engine is not measured."""

    reason: str
    """Reason, for readers."""


@dataclass(frozen=True)
class Figure:
    """A quantity that decides for or against an engine."""

    title: str
    """Heading of the column."""
    meaning: str
    """Quantity in a sentence."""
    read: Callable[[Result, str], Value | Missing]
    """The figure of a backend."""


@dataclass(frozen=True)
class Use:
    """A use that engines are ranked for."""

    key: str
    """Word for anchors."""
    title: str
    """Heading of the ranking."""
    figures: tuple[Figure, Figure, Figure]
    """The three figures that decide, the first one first."""
    note: str = ""
    """Condition under which the figures were taken."""


@dataclass(frozen=True)
class Placing:
    """Place of an engine in a ranking."""

    place: int
    """Place from 1 on; equal engines share one."""
    backend: str
    """Name of the backend."""
    values: tuple[Value, ...]
    """Figures in the use's order."""


@dataclass(frozen=True)
class Ranking:
    """Engines in their order for one use."""

    use: Use
    """Use that engines are ranked for."""
    placings: tuple[Placing, ...]
    """Engines, the best first."""
    unmeasured: tuple[tuple[str, str], ...]
    """Pairs of backend and reason."""


def rankings(result: Result) -> tuple[Ranking, ...]:
    """Return the ranking of the result's backends for every use."""
    return tuple(rank(use, result) for use in USES)


def rank(use: Use, result: Result) -> Ranking:
    """Return the order of the result's backends for one use, by :data:`RULE`."""
    measured: dict[str, tuple[Value, ...]] = {}
    unmeasured: list[tuple[str, str]] = []
    for backend in result.header.settings.backends:
        found = [figure.read(result, backend) for figure in use.figures]
        reasons = dict.fromkeys(value.reason for value in found if isinstance(value, Missing))
        if reasons:
            unmeasured.append((backend, "; ".join(reasons)))
        else:
            measured[backend] = tuple(value for value in found if isinstance(value, Value))
    columns = [_ranks([values[index] for values in measured.values()]) for index in range(len(use.figures))]
    # The first figure breaks ties: it is the one about correctness in most uses.
    keys = {backend: (sum(ranks), ranks[0]) for backend, *ranks in zip(measured, *columns, strict=True)}
    placings = (
        Placing(1 + sum(other < keys[backend] for other in keys.values()), backend, values)
        for backend, values in measured.items()
    )
    return Ranking(use, tuple(sorted(placings, key=lambda placing: placing.place)), tuple(unmeasured))


def _ranks(values: Sequence[Value]) -> list[int]:
    """Return the rank of each value, 1 for the best; values of one text share the rank of the best of them."""
    best: dict[str, float] = {}
    for value in values:
        best[value.text] = max(value.score, best.get(value.text, -math.inf))
    return [1 + sum(best[other.text] > best[value.text] for other in values) for value in values]


def machine_of(result: Result, record: Record) -> str:
    """Return the machine that a record was made on; empty where several of a merged result made records of its kind."""
    if record.throughput and record.throughput.hardware:
        return record.throughput.hardware
    kind = f"{record.job.kind.value} on {record.job.backend}"
    places = [origin.hardware for origin in result.header.origins if kind in origin.jobs]
    if not result.header.origins:
        places = [result.header.hardware]
    return places[0].label if len(places) == 1 else ""


# Figures


def _share(done: Sequence[tuple[str, str, bool]]) -> Value:
    """Return a count of what is done, from names, anchors and outcomes."""
    misses = tuple(Miss(name, anchor) for name, anchor, passed in done if not passed)
    passed = len(done) - len(misses)
    return Value(f"{passed} of {len(done)}", passed / len(done), misses=misses)


def _scenarios(title: str, groups: Iterable[str] = (), names: Iterable[str] = ()) -> Figure:
    """Return the number of scenarios, of these groups or names, whose metrics are all within tolerance."""
    groups, names = tuple(groups), tuple(names)

    def read(result: Result, backend: str) -> Value | Missing:
        infos = [info for info in result.header.scenarios if info.group in groups or info.name in names]
        records = [_best_way(result, info, backend) for info in infos]
        if not infos or None in records:
            return Missing(f"{records.count(None)} of {len(records)} scenarios not run" if infos else "no scenario run")
        pairs = zip(infos, records, strict=True)
        return _share([(i.name, i.name, r is not None and r.status is Status.PASS) for i, r in pairs])

    of = "scenarios of " + ", ".join(groups) if groups else "the scenarios " + ", ".join(names)
    return Figure(title, f"{of} whose metrics are all within tolerance at the nominal time step", read)


def _best_way(result: Result, info: ScenarioInfo, backend: str) -> Record | None:
    """Return the nominal record of a scenario; of those of several matter solvers the best, the faster of equals."""
    found = (result.nominal(info, backend, matter) for matter in result.matters(info.name))
    order = list(Status)
    return min(
        (record for record in found if record),
        key=lambda r: (order.index(r.status), -(r.scenario.speed if r.scenario else 0.0)),
        default=None,
    )


def _scenario_speed(title: str, group: str) -> Figure:
    """Return the geometric mean of simulated over wall seconds, over the scenarios of a group."""

    def read(result: Result, backend: str) -> Value | Missing:
        infos = [info for info in result.header.scenarios if info.group == group]
        records = [record for info in infos if (record := _best_way(result, info, backend))]
        speeds = [record.scenario.speed for record in records if record.scenario]
        if not infos or len(speeds) < len(infos):
            return Missing(
                f"speed of {len(infos) - len(speeds)} scenarios not measured" if infos else "no scenario run"
            )
        # Ratios between engines are alike for slow and fast scenarios, so that a geometric mean weighs all of them.
        speed = math.exp(sum(map(math.log, speeds)) / len(speeds))
        return Value(f"{speed:.2g} s/s", speed, f"group-{slug(group)}")

    meaning = f"simulated seconds per second, geometric mean over the scenarios of {group}, beside the run's other jobs"
    return Figure(title, meaning, read)


def _error(title: str, scenario: str, metric: str) -> Figure:
    """Return the error of one metric; the smaller the better."""

    def read(result: Result, backend: str) -> Value | Missing:
        info = next((info for info in result.header.scenarios if info.name == scenario), None)
        record = _best_way(result, info, backend) if info else None
        error = record.scenario.errors.get(metric, math.nan) if record and record.scenario else math.nan
        return Missing(f"{scenario} not measured") if math.isnan(error) else Value(f"{error:.2g}", -error, scenario)

    return Figure(title, f"{metric} of the scenario {scenario}, in its own units", read)


def _success(title: str, tasks: Sequence[str]) -> Figure:
    """Return the mean success rate of the experts of these tasks; a refused task counts as zero."""

    def read(result: Result, backend: str) -> Value | Missing:
        own = {record.job.name: record for record in result.of(Kind.TASK) if record.job.backend == backend}
        # A mean over fewer tasks would favour the engine that skipped a hard one.
        if absent := [task for task in tasks if task not in own]:
            return Missing(f"{len(absent)} of {len(tasks)} tasks not run")
        rates = {task: played.success.value if (played := own[task].played) else 0.0 for task in tasks}
        mean = sum(rates.values()) / len(rates)
        misses = tuple(Miss(task, f"task-{task}") for task, success in rates.items() if success < 1.0)
        return Value(f"{100 * mean:.0f} %", mean, misses=misses)

    return Figure(
        title, f"mean success of the scripted experts of {', '.join(tasks)}; a refused task counts as 0", read
    )


def _robots(title: str, check: str) -> Figure:
    """Return the number of robots that pass one check."""

    def read(result: Result, backend: str) -> Value | Missing:
        robots = [record for record in result.of(Kind.ROBOT) if record.job.backend == backend and record.robot]
        checks = [(r.job.name, r.robot.check(check)) for r in robots if r.robot]
        done = [(name, f"robots-{backend}", found.status is Status.PASS) for name, found in checks if found]
        return _share(done) if done else Missing(f"{check} not run")

    return Figure(title, f"robots of the catalogue that pass {check}", read)


@dataclass(frozen=True)
class _Rate:
    """A stepping rate of a task on one machine."""

    backend: str
    machine: str
    num_envs: int
    rate: float
    ratio: float | None
    """Share of the engine's own rate."""

    @property
    def conditions(self) -> str:
        """Number of environments and machine, in words."""
        return ", ".join(words for words in (f"{self.num_envs:,} environments", self.machine) if words)


def _rates(result: Result, task: str, gpu: bool) -> Iterator[_Rate]:
    """Yield all rates of a task measured on a GPU, or all on a CPU."""
    for record in result.of(Kind.THROUGHPUT):
        found = record.throughput
        if found and record.job.name == task and (record.device != "cpu") is gpu:
            ratio = found.raw.ratio if found.raw else None
            machine = machine_of(result, record)
            yield _Rate(record.job.backend, machine, found.num_envs, found.env_steps_per_second, ratio)
    for each in result.benchmarks if gpu else ():
        if each.task == task:
            yield _Rate(each.backend, each.hardware, each.num_envs, each.env_steps_per_second, each.ratio)


def _fastest(result: Result, backend: str, task: str, gpu: bool) -> _Rate | Missing:
    """Return the best rate of a backend on the machine where the most backends were measured."""
    rates = list(_rates(result, task, gpu))

    def engines_then_speed(machine: str) -> tuple[int, float]:
        on_it = [rate for rate in rates if rate.machine == machine]
        return len({rate.backend for rate in on_it}), max(rate.rate for rate in on_it)

    # A fast machine must not lift one engine above those measured on a slower one.
    machine = max((rate.machine for rate in rates), key=engines_then_speed, default="")
    own = [rate for rate in rates if rate.backend == backend]
    if not own:
        return Missing(f"{task} not measured on a {'GPU' if gpu else 'CPU'}")
    alike = [rate for rate in own if rate.machine == machine]
    return max(alike, key=lambda rate: rate.rate) if alike else Missing(f"{task} not measured on {machine}")


def _speed(title: str, task: str, gpu: bool = False) -> Figure:
    """Return the most environment steps per second of a task, over all numbers of environments."""

    def read(result: Result, backend: str) -> Value | Missing:
        found = _fastest(result, backend, task, gpu)
        if isinstance(found, Missing):
            return found
        anchor = "benchmarks" if gpu and result.benchmarks else "throughput"
        return Value(f"{found.rate:,.0f}/s", found.rate, anchor, detail=found.conditions)

    where = "a GPU" if gpu else "a CPU"
    return Figure(
        title, f"environment steps per second of {task} on {where}, most of all numbers of environments", read
    )


def _share_of_raw(title: str, task: str) -> Figure:
    """Return the rate of a task on a GPU as a share of the engine's own."""

    def read(result: Result, backend: str) -> Value | Missing:
        found = _fastest(result, backend, task, gpu=True)
        if isinstance(found, Missing):
            return found
        if found.ratio is None:
            return Missing(f"the engine alone was not measured with {task}")
        anchor = "benchmarks" if result.benchmarks else "throughput"
        return Value(f"{100 * found.ratio:.0f} %", found.ratio, anchor, detail=found.conditions)

    return Figure(title, f"rate of {task} as a share of the engine's own captured stepping of the same motions", read)


def _pictures(title: str, task: str) -> Figure:
    """Return colour pictures of 84 x 84 pixels drawn per second on a CPU."""

    def read(result: Result, backend: str) -> Value | Missing:
        records = [
            r for r in result.of(Kind.THROUGHPUT) if (r.job.name, r.job.backend, r.device) == (task, backend, "cpu")
        ]
        times = [r.throughput.picture_milliseconds for r in records if r.throughput]
        rates = [1000.0 / time for time in times if time]
        return Value(f"{max(rates):.0f}/s", max(rates), "throughput") if rates else Missing("no picture was timed")

    return Figure(title, f"colour pictures of 84 x 84 pixels of {task} drawn per second on a CPU", read)


def slug(words: str) -> str:
    """Return words as a part of an element's id."""
    return words.lower().replace(" ", "-")


_CONTACT = ("Friction", "Grasp", "Impact", "Rest", "Contact forces", "Contact")
_CONTACT_TASKS = (
    "Lift", "Stack", "Stack-Pyramid", "Hockey", "Nut-Bolt", "Jenga", "Peg-In-Hole", "Cabinet", "Dishwasher", "Handover"
)  # fmt: skip
_MATTER_TASKS = (
    "Cloth-Lifting", "Rope-Reshaping", "Cloth-Dropping", "Flag-Hoisting", "Cloth-Spreading", "Cloth-Folding"
)  # fmt: skip
_RAYS = (
    "rays_on_primitives", "rays_on_convex_meshes", "rays_in_triangle_meshes", "rays_on_height_fields",
    "rays_on_terrain", "rays_on_terrain_mesh",
)  # fmt: skip

USES: tuple[Use, ...] = (
    Use(
        "contact",
        "Contact-rich manipulation",
        (
            _scenarios("contact scenarios", _CONTACT),
            _success("tasks with contact", _CONTACT_TASKS),
            _speed("Lift, CPU", "Lift"),
        ),
    ),
    Use(
        "legs",
        "Legged locomotion",
        (
            _scenarios("drives, terrain, forces", ("Drives", "Terrain", "Contact forces")),
            _robots("robots that stand", "robot_stand"),
            _speed("Velocity-Flat, CPU", "Velocity-Flat"),
        ),
    ),
    Use(
        "matter",
        "Cloth and rope",
        (
            _scenarios("cloth and rope scenarios", ("Matter",)),
            _success("tasks with cloth or rope", _MATTER_TASKS),
            _scenario_speed("simulated s/s", "Matter"),
        ),
        "Of a matter solver and the engine's own cloth or rope, the one that does better in a scenario counts.",
    ),
    Use(
        "gpu",
        "Many environments on a GPU",
        (
            _speed("Lift, GPU", "Lift", gpu=True),
            _speed("Velocity-Flat, GPU", "Velocity-Flat", gpu=True),
            _share_of_raw("of the engine alone", "Lift"),
        ),
        "Whether an engine simulates on a GPU at all is among its declared capabilities.",
    ),
    Use(
        "cameras",
        "Cameras and lidars",
        (
            _scenarios("image scenarios", ("Images",)),
            _scenarios("ray scenarios", names=_RAYS),
            _pictures("pictures, CPU", "Lift"),
        ),
    ),
    Use(
        "determinism",
        "Determinism",
        (
            _scenarios("repeatability scenarios", ("Repeatability",)),
            _error("alone or among seven", "alone_and_among_seven", "difference"),
            _error("snapshot goes on", "snapshot", "difference"),
        ),
        "Measured on the devices of this run; see the capabilities for what a GPU repeats.",
    ),
)  # fmt: skip
