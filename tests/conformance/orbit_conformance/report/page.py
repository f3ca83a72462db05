"""The report's page: what the template shows, drawn from a result."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import jinja2
from markupsafe import Markup

from orbit_conformance.episodes import TaskResult
from orbit_conformance.execution import VIDEO
from orbit_conformance.jobs import Kind
from orbit_conformance.report import plots
from orbit_conformance.report.plots import courses
from orbit_conformance.report.ranking import RULE, Ranking, machine_of, rankings, slug
from orbit_conformance.report.robots import RobotSection, robot_section
from orbit_conformance.results import REPORT, PolicyInfo, Record, Result, ScenarioInfo, load
from orbit_conformance.throughput import Benchmark
from orbit_conformance.tolerances import loose_tolerances
from orbit_conformance.verdict import Status
from orbit_core.files import as_path, written_whole
from orbit_core.interfaces import Gap
from orbit_core.interfaces.matter import NATIVE
from orbit_core.rollout.estimates import Estimate

# Largest differences between engines in each task and learned policy --------------------------------------------------


@dataclass(frozen=True)
class Difference:
    """Difference between engines in one task, or with one policy."""

    name: str
    """Name of the task or policy."""
    anchor: str
    """Element of the page that shows it."""
    success: str
    """Lowest and highest success rate with the engines that have them."""
    metric: str
    """Lowest and highest mean of the leading metric."""
    trajectories: str
    """Pair of engines and tracked thing that are farthest apart, median over environments."""
    spread: float
    """Difference of the highest and the lowest success rate; a refusal counts as zero."""
    distance: float
    """Metres between the two trajectories that are farthest apart."""


def differences(result: Result) -> tuple[Difference, ...]:
    """Return the differences of all tasks and policies that more than one engine played, the largest first."""
    found = [*_of_tasks(result), *_of_policies(result)]
    return tuple(sorted(found, key=lambda each: (-each.spread, -each.distance, each.name)))


def _of_tasks(result: Result) -> Iterator[Difference]:
    for task in result.tried_tasks:
        records = {record.job.backend: record for record in result.of(Kind.TASK) if record.job.name == task}
        played = {backend: record.task for backend, record in records.items() if record.task}
        refused = [backend for backend, record in records.items() if record.status is Status.UNSUPPORTED]
        if len(played) + len(refused) > 1 and played:
            yield _difference(task, f"task-{task}", played, refused, *_farthest(result, task))


def _of_policies(result: Result) -> Iterator[Difference]:
    for info in result.header.policies:
        records = [r for r in result.of(Kind.TRANSFER) if r.job.name == info.name and not r.job.renderer]
        played = {record.job.backend: record.transfer.result for record in records if record.transfer}
        refused = [record.job.backend for record in records if record.status is Status.UNSUPPORTED]
        if len(played) + len(refused) > 1 and played:
            yield _difference(f"{info.task}, policy {info.name}", "transfers", played, refused, "", 0.0)


def _difference(
    name: str, anchor: str, played: Mapping[str, TaskResult], refused: list[str], trajectories: str, distance: float
) -> Difference:
    success = {backend: round(100 * found.success.value) for backend, found in played.items()}
    text = _extremes({backend: f"{percent} %" for backend, percent in success.items()}, success)
    if refused:
        text += f"; refused by {', '.join(refused)}"
    leading = next(iter(next(iter(played.values())).metrics))
    means = {backend: found.metrics[leading].value for backend, found in played.items()}
    metric = f"{leading}: {_extremes({backend: f'{mean:.2g}' for backend, mean in means.items()}, means)}"
    # A refused task is the largest difference that there can be for its user.
    lowest = 0 if refused else min(success.values())
    return Difference(name, anchor, text, metric, trajectories, float(max(success.values()) - lowest), distance)


def _extremes(texts: Mapping[str, str], values: Mapping[str, float]) -> str:
    """Return the lowest and the highest text with the backends that have them; one text where all read alike."""
    low, high = texts[min(values, key=lambda b: values[b])], texts[max(values, key=lambda b: values[b])]
    if low == high:
        return low
    ends = ((text, ", ".join(backend for backend in texts if texts[backend] == text)) for text in (low, high))
    return " to ".join(f"{text} ({backends})" for text, backends in ends)


def _farthest(result: Result, task: str) -> tuple[str, float]:
    """Return the thing and pair of backends whose median distance is largest at any time, and that distance."""
    peaks = [
        (max(thing.median), thing.thing, pair)
        for pair in result.partings
        if pair.task == task
        for thing in pair.things
        if thing.median
    ]
    if not peaks:
        return "", 0.0
    distance, thing, pair = max(peaks, key=lambda peak: peak[0])
    return f"{distance:.2g} m: {thing}, {pair.backend} from {pair.reference}", distance


_SYMBOLS = {Status.PASS: "✓", Status.GAP: "≈", Status.UNSUPPORTED: "–", Status.FAIL: "✗", Status.STALE: "!"}
_ANCHORS = {Kind.ROBOT: "robots", Kind.TASK: "task-{}", Kind.TRANSFER: "transfers", Kind.THROUGHPUT: "throughput"}


@dataclass(frozen=True)
class Row:
    """One metric of a cell."""

    metric: str
    """Name and unit."""
    error: str
    """Measured error, for readers."""
    tolerance: str
    """Largest error that passes, for readers."""
    within: bool
    """True if the error passes."""


@dataclass(frozen=True)
class Cell:
    """A backend's standing in a scenario, a task or a learned policy."""

    status: Status | None
    """Status of the cell; None where it was not run."""
    label: str
    """Word or figure in the cell."""
    reason: str = ""
    """Reason for anything but a pass."""
    rows: tuple[Row, ...] = ()
    """Metrics behind the status."""

    @property
    def style(self) -> str:
        """The style class of the status's colour."""
        return self.status.name.lower() if self.status else "absent"


@dataclass(frozen=True)
class Line:
    """A row of the matrix."""

    name: str
    """Name of the scenario, task or policy."""
    anchor: str
    """Element of the page that shows it."""
    question: str
    """Question that the line answers."""
    cells: tuple[Cell, ...]
    """Standing of each backend, in the page's order."""


@dataclass(frozen=True)
class ScenarioSection:
    """A scenario with its plots."""

    info: ScenarioInfo
    """Scenario that is shown."""
    accuracy: Markup
    """Plot of error against time step."""
    traces: Markup
    """Plots of curves with their truth."""


@dataclass(frozen=True)
class GapLine:
    """A declared gap with what was measured."""

    scenario: str
    """Name of the scenario or check."""
    metric: str
    """Name and unit."""
    tolerance: str
    """Largest error that passes, for readers."""
    limit: str
    """Largest error that the backend admits to."""
    measured: str
    """Measured error."""


@dataclass(frozen=True)
class GapGroup:
    """Declared gaps of one backend, or one matter solver, that have one reason."""

    backend: str
    """Name of the backend or matter solver."""
    reason: str
    """Reason that the gaps share."""
    gaps: tuple[GapLine, ...]
    """Gaps with their figures."""


@dataclass(frozen=True)
class TaskSection:
    """A task with its films, its numbers and how backends part."""

    name: str
    """Name of the task."""
    videos: tuple[tuple[str, str], ...]
    """Pairs of backend and file."""
    rows: tuple[tuple[str, ...], ...]
    """Numbers of each backend."""
    courses: Markup
    """Key points of deformables on each backend; empty without any."""
    divergence: Markup
    """Plot of distances between backends; empty without any."""
    replays: tuple[tuple[str, tuple[str, ...]], ...]
    """Source backend, and success on each backend."""


@dataclass(frozen=True)
class TransferCell:
    """A learned policy on one backend."""

    standing: Cell
    """Standing of the policy; its label is the success rate."""
    metric: str
    """The leading metric."""
    learned_here: bool
    """True on the backend that the policy was learned on."""


@dataclass(frozen=True)
class TransferLine:
    """A learned policy on all backends, or on the pictures of all renderers, in their order."""

    info: PolicyInfo
    """Policy that is shown."""
    cells: tuple[TransferCell, ...]
    """Standing on each backend or renderer."""
    backend: str = ""
    """The backend that simulates what the renderers draw."""


@dataclass(frozen=True)
class Page:
    """Everything that the template shows."""

    result: Result
    """Result that the page shows."""
    rankings: tuple[Ranking, ...]
    """Engines in order for each use."""
    rule: str
    """Rule that orders the engines of a ranking."""
    differences: tuple[Difference, ...]
    """Tasks and policies by the difference between engines."""
    statuses: tuple[tuple[Status, str], ...]
    """Statuses and their symbols."""
    totals: tuple[tuple[str, tuple[int, ...]], ...]
    """Backend, and the number of scenarios of each status."""
    matrix: tuple[tuple[str, tuple[Line, ...]], ...]
    """Groups of scenarios with their lines."""
    scenarios: tuple[ScenarioSection, ...]
    """Scenarios with plots."""
    robots: RobotSection | None
    """Robots on all backends; None if they were left out."""
    tasks: tuple[TaskSection, ...]
    """Tasks with films and numbers."""
    success: Markup
    """Plot of the success rates."""
    transfers: tuple[TransferLine, ...]
    """Kept policies on all backends."""
    drawn: tuple[TransferLine, ...]
    """Lines of the policies that see pictures, with one cell for each of the run's renderers."""
    throughput: Markup
    """Plot of the stepping rates."""
    rates: tuple[tuple[str, ...], ...]
    """Rows of stepping rates."""
    benchmarks: tuple[tuple[str, ...], ...]
    """Rows of rates measured outside of the run."""
    gaps: tuple[GapGroup, ...]
    """Declared gaps by backend and reason."""
    loose: tuple[str, ...]
    """Sentences on tolerances that are looser than the best engine warrants."""
    broken: tuple[Record, ...]
    """Jobs that crashed, hung or raised, at any time step."""


def write_report(folder: Path | str) -> Path:
    """Make the report of a finished run from its folder; the file.

    Raises:
        AssetError: the folder holds no result.
        StorageError: it cannot be written.
    """
    folder = as_path(folder)
    page = render(page_of(load(folder), folder))
    with written_whole(folder / REPORT) as path:
        path.write_text(page)
    return folder / REPORT


def render(page: Page) -> str:
    """The page's HTML, with style and script in it."""
    files = resources.files("orbit_conformance.report")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["slug"] = slug
    template = environment.from_string((files / "page.html.jinja").read_text())
    style, script = (Markup((files / name).read_text()) for name in ("style.css", "script.js"))
    html = template.render(page=page, style=style, script=script)
    return re.sub(r"\n\s*\n+", "\n", html)  # blocks of the template that are left out leave empty lines


def page_of(result: Result, folder: Path) -> Page:
    """Return what is to be shown of a result; of a condensed one no plots.

    Args:
        result: of a finished run, or a condensed one.
        folder: where traces and videos are looked for.
    """
    settings, plotted = result.header.settings, result.archive is None
    return Page(
        result=result,
        rankings=rankings(result),
        rule=RULE,
        differences=differences(result),
        statuses=tuple(_SYMBOLS.items()),
        totals=tuple(
            (name, tuple(sum(r.status is status for r in result.judged if r.job.backend == name) for status in Status))
            for name in settings.backends
        ),
        matrix=tuple(_matrix(result)),
        scenarios=tuple(
            ScenarioSection(
                info,
                Markup(plots.accuracy(result, info) if plotted else ""),
                Markup(plots.traces(result, info, folder) if plotted else ""),
            )
            for info in result.header.scenarios
        ),
        robots=robot_section(result),
        tasks=tuple(_task_section(result, task, folder) for task in result.tried_tasks),
        success=Markup(plots.success(result) if plotted else ""),
        transfers=tuple(_transfer_line(result, info) for info in result.header.policies),
        drawn=tuple(_drawn_lines(result)),
        throughput=Markup(plots.throughput(result) if plotted else ""),
        rates=tuple(_rates(result)),
        benchmarks=tuple(map(_benchmark_row, result.benchmarks)),
        gaps=tuple(_gaps(result)),
        loose=tuple(map(str, loose_tolerances(result))),
        broken=tuple(record for record in result.records if not record.ending.acceptable),
    )


def _matrix(result: Result) -> Iterator[tuple[str, tuple[Line, ...]]]:
    for group in dict.fromkeys(info.group for info in result.header.scenarios):
        infos = (info for info in result.header.scenarios if info.group == group)
        yield (
            group,
            tuple(_scenario_line(result, info, matter) for info in infos for matter in result.matters(info.name)),
        )
    settings = result.header.settings
    tasks, policies = settings.tasks, settings.policies
    for kind, group, names, question in (
        (Kind.ROBOT, "Robots", settings.robots, "Is it the same robot here as described?"),
        (Kind.TASK, "Tasks", result.tried_tasks, "Does the expert reach the goal?"),
        (Kind.TRANSFER, "Learned policies", policies, "Does what was learned elsewhere do it here?"),
        (Kind.THROUGHPUT, "Throughput", tasks, "How fast does it step?"),
    ):
        if result.of(kind):
            yield group, tuple(_line(result, kind, name, question) for name in names)


def _scenario_line(result: Result, info: ScenarioInfo, matter: str) -> Line:
    backends = result.header.settings.backends
    cells = tuple(_scenario_cell(info, result.nominal(info, backend, matter)) for backend in backends)
    return Line(f"{info.name}, {matter}" if matter else info.name, info.name, info.question, cells)


def _scenario_cell(info: ScenarioInfo, record: Record | None) -> Cell:
    if record is None:
        return Cell(None, "not run")
    errors = record.scenario.errors if record.scenario else {}
    rows = tuple(
        Row(m.name, _number(errors[m.name], m.unit), _number(m.tolerance, m.unit), errors[m.name] <= m.tolerance)
        for m in info.metrics
        if m.name in errors
    )
    return Cell(record.status, _label(record), record.why, rows)


def _line(result: Result, kind: Kind, name: str, question: str) -> Line:
    cells = tuple(_worst_cell(result, kind, name, backend) for backend in result.header.settings.backends)
    return Line(name, _ANCHORS[kind].format(name), question, cells)


def _worst_cell(result: Result, kind: Kind, name: str, backend: str) -> Cell:
    records = [r for r in result.of(kind) if (r.job.name, r.job.backend, r.job.renderer) == (name, backend, "")]
    if not records:
        return Cell(None, "not run")
    # Throughput has several records in a cell, one for each number of environments.
    worst = max(records, key=lambda record: list(_SYMBOLS).index(record.status))
    label = worst.played.success.percent() if worst.played else _label(worst)
    return Cell(worst.status, label, worst.why)


def _transfer_line(result: Result, info: PolicyInfo) -> TransferLine:
    return TransferLine(
        info, tuple(_transfer_cell(result, info, backend) for backend in result.header.settings.backends)
    )


def _drawn_lines(result: Result) -> Iterator[TransferLine]:
    infos = {info.name: info for info in result.header.policies}
    pairs = dict.fromkeys((r.job.name, r.job.backend) for r in result.of(Kind.TRANSFER) if r.job.renderer)
    for policy, backend in pairs:
        cells = (
            _transfer_cell(result, infos[policy], backend, "" if renderer == backend else renderer)
            for renderer in result.header.settings.renderers
        )
        yield TransferLine(infos[policy], tuple(cells), backend)


def _transfer_cell(result: Result, info: PolicyInfo, backend: str, renderer: str = "") -> TransferCell:
    wanted = (info.name, backend, renderer)
    records = (r for r in result.of(Kind.TRANSFER) if (r.job.name, r.job.backend, r.job.renderer) == wanted)
    record = next(records, None)
    home = info.learned_on == backend and not renderer
    if record is None or record.played is None:
        standing = Cell(record.status, _label(record), record.why) if record else Cell(None, "not run")
        return TransferCell(standing, "", home)
    name, metric = next(iter(record.played.metrics.items()))
    standing = Cell(record.status, record.played.success.percent(), record.why)
    return TransferCell(standing, f"{name}: {_estimate(metric)}", home)


def _label(record: Record) -> str:
    words = {Status.GAP: "gap", Status.STALE: "stale", Status.UNSUPPORTED: "no"}
    return words.get(record.status, record.status.value)


def _task_section(result: Result, task: str, folder: Path) -> TaskSection:
    backends = result.header.settings.backends
    videos = [r.job for r in result.of(Kind.VIDEO) if r.job.name == task and (folder / r.job.key / VIDEO).exists()]
    videos.sort(key=lambda job: backends.index(job.backend))
    replays = {(r.job.source, r.job.backend): r for r in result.of(Kind.REPLAY) if r.job.name == task}
    sources = [backend for backend in backends if any(source == backend for source, _ in replays)]
    own = {r.job.backend: r for r in result.of(Kind.TASK) if r.job.name == task}
    return TaskSection(
        name=task,
        videos=tuple((job.backend, f"{job.key}/{VIDEO}") for job in videos),
        rows=tuple(_task_row(backend, own[backend]) for backend in backends if backend in own),
        courses=Markup(courses(result, task)),
        divergence=Markup(plots.divergences(result, task) if result.archive is None else ""),
        replays=tuple(
            (source, tuple(_replay_text(own if source == b else None, replays, source, b) for b in backends))
            for source in sources
        ),
    )


def _task_row(backend: str, record: Record) -> tuple[str, ...]:
    task = record.task
    if task is None:
        return (backend, "-", record.why, "", "", "", "")
    # The first metric is the leading one.
    name, metric = next(iter(task.metrics.items()))
    time = _estimate(task.seconds_to_success) if task.seconds_to_success else "-"
    broken = ", ".join(f"{check.name}: {check.failed} of {check.starts}" for check in task.premises) or "-"
    leading = f"{name}: {_estimate(metric)}"
    returned = _estimate(task.episode_return)
    return (backend, str(task.num_envs), task.success.percent(), leading, returned, time, broken)


def _replay_text(
    own: dict[str, Record] | None, replays: dict[tuple[str, str], Record], source: str, backend: str
) -> str:
    if own is not None:
        task = own[backend].task if backend in own else None
        return f"{task.success.percent()} (recorded)" if task else "-"
    record = replays.get((source, backend))
    if record is None or record.replay is None:
        return record.why if record else "-"
    return record.replay.result.success.percent()


def _rates(result: Result) -> Iterator[tuple[str, ...]]:
    for record in result.of(Kind.THROUGHPUT):
        rate, job = record.throughput, record.job
        if rate is None:
            yield (job.name, job.backend, str(job.num_envs), record.why, *[""] * 8)
            continue
        raw = rate.raw
        shares = (f"{100 * rate.shares[name]:.0f} %" for name in ("engine", "layer", "rendering"))
        yield (
            job.name,
            job.backend,
            f"{rate.num_envs:,}",
            f"{rate.env_steps_per_second:,.0f}",
            f"{raw.env_steps_per_second:,.0f} ({raw.way})" if raw else "-",
            f"{100 * raw.ratio:.0f} %" if raw else "-",
            *shares,
            f"{rate.start_seconds:.1f}",
            f"{rate.memory_mib:,.0f}",
            machine_of(result, record) or "-",
        )


def _benchmark_row(rate: Benchmark) -> tuple[str, ...]:
    return (
        f"{rate.task}, {rate.robot}" if rate.robot else rate.task,
        rate.backend,
        rate.action,
        f"{rate.num_envs:,}",
        f"{rate.env_steps_per_second:,.0f}",
        "-" if rate.ratio is None else f"{100 * rate.ratio:.0f} %",
        rate.hardware,
        rate.command,
    )


def _gaps(result: Result) -> Iterator[GapGroup]:
    known = {info.name for info in result.header.scenarios}
    for owner in (*result.header.backends, *result.header.matters):
        own = (gap for gap in owner.gaps if gap.scenario in known)
        # Gaps of one cause follow each other in declarations, so that the page says it once.
        for reason, gaps in itertools.groupby(own, key=lambda gap: gap.reason):
            yield GapGroup(owner.name, reason, tuple(_gap_line(result, owner.name, gap) for gap in gaps))


def _gap_line(result: Result, owner: str, gap: Gap) -> GapLine:
    info = next(info for info in result.header.scenarios if info.name == gap.scenario)
    metric = next(metric for metric in info.metrics if metric.name == gap.metric)
    measured = _number(_worst(result, info, owner, gap.metric), metric.unit)
    tolerance, limit = (_number(value, metric.unit) for value in (metric.tolerance, gap.limit))
    return GapLine(gap.scenario, gap.metric, tolerance, limit, measured)


def _worst(result: Result, info: ScenarioInfo, owner: str, metric: str) -> float:
    """The error of a backend, or the largest of a matter solver on any; NaN where none was measured."""
    backends = result.header.settings.backends
    matters = [matter for matter in result.matters(info.name) if matter in ("", NATIVE)]
    pairs = [(owner, matter) for matter in matters] if owner in backends else [(each, owner) for each in backends]
    records = (result.nominal(info, backend, matter) for backend, matter in pairs)
    return max((r.scenario.errors[metric] for r in records if r and r.scenario and r.scenario.errors), default=math.nan)


def _number(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}".strip()


def _estimate(estimate: Estimate) -> str:
    return f"{estimate.value:.3g} [{estimate.low:.3g}, {estimate.high:.3g}]"
