"""``orbit conformance``: how right and how fast each backend is, as a report."""

from __future__ import annotations

import functools
import importlib.util
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.table import Table
from tyro.conf import Positional, arg

from orbit_core.cli.output import console, new_table, progress_bar
from orbit_core.cli.settings import KeyValues, check_positive, parse_words
from orbit_core.configuration import assignments, configured
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import ConfigurationError

if TYPE_CHECKING:
    from orbit_conformance.pools import Pool
    from orbit_conformance.results import Record, Result

PROGRAM = "orbit conformance"
Names = Annotated[tuple[str, ...], arg(metavar="NAME...")]


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """Hold backends against physics with known answers and whole tasks; write JSON and an HTML report.

    A run that was interrupted goes on when the same command is given again. The exit code is 1 if a backend is not as
    it declares. Other uses: 'orbit conformance compare A B', 'orbit conformance merge A B --output DIR', 'orbit
    conformance publish DIR --output DIR' and 'orbit conformance report DIR'.
    """

    backend: Names = ()
    """Backends; all that are installed if left out."""
    part: Names = ()
    """Parts of the suite; all if left out, or those that --scenario, --robot and --task name."""
    scenario: Names = ()
    """Scenarios; all if left out."""
    robot: Names = ()
    """Robots, or compositions of their parts such as ur10+robotiq_2f85; all of the catalogue if left out."""
    task: Names = ()
    """Tasks; all if left out."""
    matter: Names = ()
    """Matter solvers of the scenarios of matter, or 'native' for the engines' own; all if left out."""
    quick: bool = False
    """Nominal time steps only, few episodes, few numbers of environments."""
    episodes: int | None = None
    """The most episodes of a task or a policy; those of the run if left out."""
    output: Annotated[Path, arg(metavar="DIR")] = Path("out/conformance")
    """Folder for the result, the report and the videos."""
    jobs: int | None = None
    """Worker processes; as many as there are cores if left out."""
    time_limit: float = 900.0
    """Seconds that a job may take before it is ended and counts as failed."""
    ray: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Spread over the machines of the Ray cluster at that address; 'local' starts one here."""
    device: Annotated[str, arg(metavar="NAME")] = "cpu"
    """Torch device of the backends that simulate on a GPU; the others take the CPU."""
    seed: int = 0
    """Seed of every random stream."""
    setting: KeyValues = ()
    """A setting of a backend, as BACKEND.KEY=VALUE, or KEY=VALUE where one --backend is named; repeatable."""
    fresh: bool = False
    """Start again instead of resuming an unfinished run."""


@dataclass(frozen=True)
class CompareSettings:
    """Report changes between two results that exceed noise. The exit code is 1 if a status got worse."""

    before: Annotated[Positional[Path], arg(metavar="A")]
    """A result's JSON file, or its folder."""
    after: Annotated[Positional[Path], arg(metavar="B")]
    """The same of the later one."""


@dataclass(frozen=True)
class MergeSettings:
    """Make one result of those of several runs: of other parts, tasks or backends, on other machines. The exit code is
    that of a run."""

    folders: Annotated[Positional[tuple[Path, ...]], arg(metavar="DIR...")]
    """The folders of finished runs."""
    output: Annotated[Path, arg(metavar="DIR")] = Path("out/conformance")
    """Folder for the result, the report and the videos."""
    overwrite: bool = False
    """Replace a result that is there already, once the new one is whole."""


@dataclass(frozen=True)
class PublishSettings:
    """Write a compact page with its data, and an archive with the whole report of several finished runs.

    Where two runs did one job, the later counts. The page names the archive and its sha256.
    """

    folders: Annotated[Positional[tuple[Path, ...]], arg(metavar="DIR...")]
    """The folders of finished runs."""
    output: Annotated[Path, arg(metavar="DIR")]
    """Folder for the compact page and its data."""
    archive: Annotated[Path, arg(metavar="DIR")] = Path("out/release")
    """Folder for the archive."""
    benchmarks: Annotated[Path | None, arg(metavar="FILE")] = None
    """Stepping rates measured outside of the runs, as docs/figures/gpu_rates.json has them."""


@dataclass(frozen=True)
class ReportSettings:
    """Make a result's HTML report again."""

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """The folder of a finished run."""


def main(words: Sequence[str]) -> int:
    """Run, compare or report; the exit code."""
    _require_extra()
    if words and words[0] in _COMMANDS:
        return _COMMANDS[words[0]](words[1:])
    return _run(words)


def _run(words: Sequence[str]) -> int:
    settings = parse_words(RunSettings, words, PROGRAM)
    from orbit_conformance.runner import run
    from orbit_conformance.settings import choose

    if settings.episodes is not None:
        check_positive("episodes", settings.episodes)
    chosen = choose(
        backends=settings.backend,
        scenarios=settings.scenario,
        tasks=settings.task,
        robots=settings.robot,
        parts=settings.part,
        matters=settings.matter,
        quick=settings.quick,
        episodes=settings.episodes,
        device=settings.device,
        seed=settings.seed,
        backend_settings=_backend_settings(settings.setting, settings.backend),
    )
    with progress_bar() as bar:
        task = bar.add_task("jobs", total=None)

        def progress(record: Record | None, done: int, total: int) -> None:
            description = "jobs" if record is None else f"{record.job.name} on {record.job.backend}"
            bar.update(task, description=description, completed=done, total=total)
            if record is not None and not record.ending.acceptable:
                bar.console.print(f"{record.job.key}: {record.ending.value}: {record.reason}", markup=False)

        notify = functools.partial(bar.console.print, markup=False)
        result = run(chosen, settings.output, _pool(settings), progress, notify, settings.fresh)
    return _conclude(result, settings.output)


def _backend_settings(pairs: Sequence[str], backends: Sequence[str]) -> dict[str, dict[str, Any]]:
    """``backend.key=value`` by backend; ``key=value`` is that of the only one."""
    grouped: dict[str, list[str]] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        name, dot, field = key.rpartition(".")
        if not dot and len(backends) != 1:
            raise ConfigurationError(f"say of which backend the setting '{pair}' is: BACKEND.{pair}, or one --backend")
        grouped.setdefault(name if dot else backends[0], []).append(f"{field}{equals}{value}")
    return {name: _typed_settings(name, own) for name, own in grouped.items()}


def _typed_settings(name: str, pairs: Sequence[str]) -> dict[str, Any]:
    from orbit_core.backends import backend

    owner = f"backend '{name}'"
    values = assignments(pairs, owner, "setting")
    config = configured(backend(name).config_type(), values, owner, "setting")
    return {key: getattr(config, key) for key in values}


def _pool(settings: RunSettings) -> Pool:
    from orbit_conformance.hardware import cores
    from orbit_conformance.journal import LOG
    from orbit_conformance.pools import LocalPool, RayPool

    workers = cores() if settings.jobs is None else settings.jobs
    check_positive("jobs", workers)
    if not 0.0 < settings.time_limit < math.inf:
        raise ConfigurationError(f"time_limit must be positive and finite, not {settings.time_limit:g}")
    if settings.ray is not None:
        return RayPool(settings.ray, settings.time_limit)
    return LocalPool(workers, settings.time_limit, settings.output / LOG)


def _conclude(result: Result, folder: Path) -> int:
    """Print the summary, each objection and where the page is; the exit code."""
    from orbit_conformance.report.page import write_report
    from orbit_conformance.tolerances import loose_tolerances

    # Before the summary: an interrupted terminal still leaves the page.
    report = write_report(folder)
    console().print(_summary(result))
    for record in result.objections:
        console().print(f"{record.job.key}: {record.status.value}: {record.why}", markup=False)
    if loose := loose_tolerances(result):
        console().print(f"{len(loose)} tolerances are looser than these backends warrant: see the report")
    print(report)
    return 1 if result.objections else 0


def _summary(result: Result) -> Table:
    from orbit_conformance.verdict import Status

    table = new_table("backend", *(status.value for status in Status), title="Jobs by status")
    for backend in result.header.settings.backends:
        mine = [record.status for record in result.judged if record.job.backend == backend]
        table.add_row(backend, *(str(mine.count(status)) for status in Status))
    return table


def _compare(words: Sequence[str]) -> int:
    settings = parse_words(CompareSettings, words, f"{PROGRAM} compare")
    from orbit_conformance.merge import compare
    from orbit_conformance.results import load

    comparison = compare(load(settings.before), load(settings.after))
    for better, title in ((False, "Worse"), (True, "Better")):
        changes = [change for change in comparison.changes if change.better is better]
        if changes:
            table = new_table("job", "what", "before", "after", title=title)
            for change in changes:
                table.add_row(change.job.key, change.what, change.before, change.after)
            console().print(table)
    if not comparison.changes:
        console().print("nothing changed beyond noise")
    for note in comparison.notes:
        console().print(note, markup=False)
    return 1 if comparison.worse_status else 0


def _merge(words: Sequence[str]) -> int:
    settings = parse_words(MergeSettings, words, f"{PROGRAM} merge")
    if not settings.folders:
        raise ConfigurationError("name the folders of the runs to be merged")
    from orbit_conformance.merge import merge

    return _conclude(merge(settings.folders, settings.output, settings.overwrite), settings.output)


def _publish(words: Sequence[str]) -> int:
    settings = parse_words(PublishSettings, words, f"{PROGRAM} publish")
    if not settings.folders:
        raise ConfigurationError("name the folders of the runs to be published")
    from orbit_conformance.publish import publish

    result = publish(settings.folders, settings.output, settings.archive, settings.benchmarks)
    assert result.archive is not None
    print(settings.archive / result.archive.name, result.archive.sha256)
    return 0


def _report(words: Sequence[str]) -> int:
    from orbit_conformance.report.page import write_report

    print(write_report(parse_words(ReportSettings, words, f"{PROGRAM} report").folder))
    return 0


def _require_extra() -> None:
    if any(importlib.util.find_spec(name) is None for name in ("jinja2", "matplotlib", "msgspec", "pebble")):
        raise ConfigurationError(f"the conformance suite needs its extra: {install_extra('conformance')}")


_COMMANDS: dict[str, Callable[[Sequence[str]], int]] = {
    "run": _run, "compare": _compare, "merge": _merge, "publish": _publish, "report": _report
}  # fmt: skip
