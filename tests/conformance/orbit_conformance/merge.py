"""Results of several runs as one: of other parts, tasks or backends, on other machines."""

from __future__ import annotations

import itertools
import math
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from orbit_conformance.courses import Course, course_of
from orbit_conformance.execution import RECORDING
from orbit_conformance.jobs import Job, Kind
from orbit_conformance.journal import DROPPED, LOG, PREVIOUS, now
from orbit_conformance.recording import Recording
from orbit_conformance.results import (
    REPORT,
    RESULT_FILE,
    BackendInfo,
    Header,
    Origin,
    Parting,
    Record,
    Result,
    ScenarioInfo,
    load,
    save,
)
from orbit_conformance.settings import Part, Settings
from orbit_conformance.sources import CORE
from orbit_conformance.tasks import compare_recordings
from orbit_conformance.verdict import Status
from orbit_core.envs.registry import task_entries
from orbit_core.files import as_path, check_apart, storage_faults, sweep, written_whole
from orbit_core.interfaces import ConfigurationError
from orbit_core.rollout.estimates import Estimate
from orbit_data.folder_lock import LOCK

# Comparison of two results: changes for better or worse that exceed noise ---------------------------------------------

# Smaller changes of an error, as a share of it or of its tolerance, are the noise of other processors and threads.
ERROR_NOISE = 0.1
# Relative change of a speed that the other work of a machine may cause.
SPEED_NOISE = 0.2
_RANKS = (Status.PASS, Status.GAP, Status.UNSUPPORTED, Status.STALE, Status.FAIL)


@dataclass(frozen=True)
class Change:
    """One difference between two results."""

    job: Job
    """Job whose results differ."""
    what: str
    """A status, a metric with its unit, or a speed."""
    before: str
    """Value in the first result, for readers."""
    after: str
    """Value in the second result."""
    better: bool
    """True if the second is better."""
    of_status: bool = False
    """True if a status changed, and not a number alone."""


@dataclass(frozen=True)
class Comparison:
    """All changes, and what could not be compared."""

    changes: tuple[Change, ...]
    """Differences beyond noise."""
    notes: tuple[str, ...]
    """Sentences on what could not be compared."""

    @property
    def worse_status(self) -> bool:
        """Return True if the status of any backend got worse."""
        return any(change.of_status and not change.better for change in self.changes)


def compare(before: Result, after: Result) -> Comparison:
    """Hold the later result against the earlier one, job by job; what only one of them has is noted."""
    old = {record.job: record for record in before.judged}
    new = {record.job: record for record in after.judged}
    # Speeds of two machines say nothing about the code.
    same_machine = before.header.hardware == after.header.hardware
    metrics = {info.name: info for info in after.header.scenarios}
    changes = [
        change
        for job in new
        if job in old
        for change in _changes(old[job], new[job], metrics.get(job.name), same_machine)
    ]
    return Comparison(tuple(changes), tuple(_notes({*old}, {*new}, same_machine)))


def _notes(old: set[Job], new: set[Job], same_machine: bool) -> Iterator[str]:
    for jobs, where in ((old - new, "earlier"), (new - old, "later")):
        if jobs:
            keys = sorted(job.key for job in jobs)
            yield f"{len(keys)} only in the {where} result: {', '.join(keys[:5])}{' ...' if len(keys) > 5 else ''}"
    if not same_machine:
        yield "the machines differ: speeds are not compared"


def _changes(old: Record, new: Record, info: ScenarioInfo | None, same_machine: bool) -> Iterator[Change]:
    if old.status is not new.status:
        better = _RANKS.index(new.status) < _RANKS.index(old.status)
        yield Change(new.job, "status", old.status.value, f"{new.status.value} {new.why}".strip(), better, True)
    if old.scenario and new.scenario and info:
        yield from _errors(old, new, info)
    before, after = old.played, new.played
    if before and after:
        yield from _estimates(new.job, "success", before.success, after.success, higher_is_better=True)
        name = next(iter(after.metrics), "")
        if name in before.metrics:
            yield from _estimates(new.job, name, before.metrics[name], after.metrics[name], higher_is_better=False)
    if same_machine:
        yield from _speed(old, new)


def _errors(old: Record, new: Record, info: ScenarioInfo) -> Iterator[Change]:
    assert old.scenario is not None
    assert new.scenario is not None
    for metric in info.metrics:
        before = old.scenario.errors.get(metric.name, math.nan)
        after = new.scenario.errors.get(metric.name, math.nan)
        # Relative to the tolerance as well: a tenth of an error near zero is no change.
        noise = ERROR_NOISE * max(abs(before), metric.tolerance)
        if math.isfinite(before) != math.isfinite(after) or abs(after - before) > noise:
            texts = (f"{value:.3g} {metric.unit}".strip() for value in (before, after))
            yield Change(new.job, metric.name, *texts, better=not math.isfinite(before) or after < before)


def _estimates(job: Job, what: str, before: Estimate, after: Estimate, *, higher_is_better: bool) -> Iterator[Change]:
    """The change of an estimate, if the confidence intervals lie apart."""
    if after.low > before.high or after.high < before.low:
        texts = (f"{e.value:.3g} [{e.low:.3g}, {e.high:.3g}]" for e in (before, after))
        yield Change(job, what, *texts, better=(after.value > before.value) == higher_is_better)


def _speed(old: Record, new: Record) -> Iterator[Change]:
    """Yield the change of a speed; only of throughput, the one speed that is measured on an idle machine."""
    if new.job.kind is Kind.THROUGHPUT and old.throughput and new.throughput:
        before, after = old.throughput.env_steps_per_second, new.throughput.env_steps_per_second
        if abs(after - before) > SPEED_NOISE * before:
            texts = (f"{value:,.0f} env. steps/s" for value in (before, after))
            yield Change(new.job, "throughput", *texts, better=after > before)


# Takes the kind and the information of all runs; returns one of each name.
_Reconcile = Callable[[str, Iterable[Any]], tuple[Any, ...]]


def merge(folders: Sequence[Path | str], output: Path | str, overwrite: bool = False) -> Result:
    """Write the result of several finished runs, with their files, into a folder, which appears as a whole.

    Machines, versions and numbers of episodes may differ, and the result names each (``Header.origins``). Where two
    backends did a task in different runs, distances are computed from the recordings, if these are still there.

    Args:
        folders: of the runs.
        output: the folder of the merged result; none of the runs' own, and none around or within them.
        overwrite: whether to replace a finished result that is there already, once the new one is whole.

    Raises:
        ConfigurationError: two runs did one job, or differ in what a result has once: the seed, ``--quick``, what a
            scenario or a policy is held to, what a backend declares. Or the output is there, and not to be replaced or
            not only a result.
        AssetError: a folder holds no result.
        StorageError: the output cannot be written.
    """
    folders, output = [as_path(folder) for folder in folders], as_path(output)
    results = [load(folder) for folder in folders]
    check_apart(output, folders)
    _check_output(output, overwrite)
    output = output.resolve()
    with storage_faults(output):
        output.parent.mkdir(parents=True, exist_ok=True)
    # A merge that was killed left its half-written folder there.
    sweep(output.parent)
    with written_whole(output) as written:
        merged = _merge(folders, results, written)
        _check_output(output, overwrite)  # again, for a person may have put something there meanwhile
    return merged


def joined(results: Sequence[Result]) -> Result:
    """Return the results of several runs as one to be shown.

    Unlike :func:`merge`, runs of different dates may share jobs and differ in their declarations: the latest counts.

    Raises:
        ConfigurationError: two runs differ in the seed, in ``--quick`` or in settings of backends.
    """
    # The newest declarations and settings describe the engines of today.
    latest_first = sorted(results, key=lambda result: result.finished, reverse=True)
    records = {record.job.key: record for result in reversed(latest_first) for record in result.records}
    partings = {(p.task, p.backend, p.reference): p for result in reversed(latest_first) for p in result.partings}
    courses = {(c.task, c.backend): c for result in reversed(latest_first) for c in result.courses}
    return Result(
        header=_header([result.header for result in latest_first], latest_first, _first),
        records=tuple(records.values()),
        partings=tuple(partings.values()),
        courses=tuple(courses.values()),
        finished=latest_first[0].finished,
        benchmarks=next((result.benchmarks for result in latest_first if result.benchmarks), ()),
    )


def _check_output(output: Path, overwrite: bool) -> None:
    """Reject a folder that is there and not to be replaced, or that holds more than a finished run."""
    if not output.exists() or (output.is_dir() and not any(output.iterdir())):
        return
    if not overwrite:
        raise ConfigurationError(f"{output} is there already: give another --output, or --overwrite")
    files = {RESULT_FILE, REPORT, PREVIOUS, DROPPED, LOG, LOCK}
    if (output / RESULT_FILE).is_file():
        files |= {f"{record.job.key}/{name}" for record in load(output).records for name in record.files}
        found = (
            path.relative_to(output).as_posix() for path in output.rglob("*") if path.is_symlink() or path.is_file()
        )
        foreign = next((name for name in found if name not in files), None)
    else:
        foreign = f"no {RESULT_FILE}"
    if foreign is not None:
        raise ConfigurationError(
            f"{output} is not, or not only, a result of the suite: it holds {foreign}. It is not replaced: give "
            "another --output, or move it away first"
        )


def _merge(folders: Sequence[Path], results: Sequence[Result], output: Path) -> Result:
    """Copy the runs' files and write their result into a new folder."""
    with storage_faults(output):
        output.mkdir()
    records: dict[str, Record] = {}
    for folder, result in zip(folders, results, strict=True):
        for record in result.records:
            # Which of two results of one job is right cannot be known here.
            if record.job.key in records:
                raise ConfigurationError(f"two results to be merged hold {record.job.key}: leave one out")
            records[record.job.key] = record
            # Files that git or a release left behind are not missed.
            copy_files(record, folder, output)
    merged = Result(
        header=_header([result.header for result in results], results, _same),
        records=tuple(records.values()),
        partings=tuple(parting for result in results for parting in result.partings),
        courses=tuple(course for result in results for course in result.courses),
        finished=now(),
        benchmarks=tuple(dict.fromkeys(each for result in results for each in result.benchmarks)),
    )
    # Two backends of different runs have never been compared: do so now.
    tracks = {task: _recordings(task, merged, output) for task in merged.tried_tasks}
    partings = (*merged.partings, *_partings(merged, tracks))
    merged = replace(merged, partings=partings, courses=(*merged.courses, *_courses(merged, tracks)))
    save(merged, output)
    return merged


def copy_files(record: Record, folder: Path, output: Path) -> None:
    """Copy those of a record's files that are still there: recordings and traces are often left behind."""
    for name in record.files:
        source, target = folder / record.job.key / name, output / record.job.key / name
        if source.exists():
            with storage_faults(target):
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(source, target)


def _recordings(task: str, result: Result, folder: Path) -> dict[str, Path]:
    """The recordings of a task by backend."""
    backends = result.header.settings.backends
    paths = {backend: folder / Job(Kind.TASK, task, backend).key / RECORDING for backend in backends}
    return {backend: path for backend, path in paths.items() if path.exists()}


def _partings(result: Result, tracks: dict[str, dict[str, Path]]) -> Iterator[Parting]:
    """Yield the partings of pairs of backends that no run had both of."""
    known = {(each.task, frozenset((each.backend, each.reference))) for each in result.partings}
    for task, paths in tracks.items():
        for reference, backend in itertools.combinations(paths, 2):
            if (task, frozenset((backend, reference))) not in known:
                yield Parting(task, backend, reference, compare_recordings(paths[backend], paths[reference]))


def _courses(result: Result, tracks: dict[str, dict[str, Path]]) -> Iterator[Course]:
    known = {(each.task, each.backend) for each in result.courses}
    for task, paths in tracks.items():
        for backend, path in paths.items():
            if (task, backend) not in known and (course := course_of(Recording.load(path))) is not None:
                yield course


def _header(headers: Sequence[Header], results: Sequence[Result], once: _Reconcile) -> Header:
    first = headers[0]
    return replace(
        first,
        settings=_settings([header.settings for header in headers]),
        started=min(header.started for header in headers),
        scenarios=once("scenario", (each for header in headers for each in header.scenarios)),
        backends=once("backend", (each for header in headers for each in header.backends)),
        matters=once("matter solver", (each for header in headers for each in header.matters)),
        policies=once("policy", (each for header in headers for each in header.policies)),
        sources={name: digest for header in reversed(headers) for name, digest in header.sources.items()},
        origins=_origins(results),
    )


def _settings(each: Sequence[Settings]) -> Settings:
    """Return settings that cover all runs together."""
    first = each[0]
    for name in ("seed", "quick"):
        if len({getattr(own, name) for own in each}) > 1:
            raise ConfigurationError(f"the results to be merged differ in {name}: merge those of the same")
    if any(own.backend_settings != first.backend_settings for own in each):
        raise ConfigurationError("the results to be merged differ in backends' settings: merge those of the same")

    def all_of(name: str) -> tuple[Any, ...]:
        return tuple(dict.fromkeys(value for own in each for value in getattr(own, name)))

    order = [*task_entries()]
    tasks = all_of("tasks")
    names = ("scenarios", "robots", "policies", "renderers", "matters")
    return replace(
        first,
        backends=tuple(sorted(all_of("backends"))),
        tasks=tuple(sorted(tasks, key=lambda task: order.index(task) if task in order else len(order))),
        parts=tuple(part for part in Part if part in all_of("parts")),
        episodes=first.episodes if len({own.episodes for own in each}) == 1 else None,
        **{name: all_of(name) for name in names},
    )


def _declared(info: Any) -> object:
    """Return the part of an information that runs to be merged must share; versions of backends may differ."""
    return info.gaps if isinstance(info, BackendInfo) else info


def _first(kind: str, infos: Iterable[Any]) -> tuple[Any, ...]:
    """Return the first information of each name."""
    found: dict[str, Any] = {}
    for info in infos:
        found.setdefault(info.name, info)
    return tuple(found.values())


def _same(kind: str, infos: Iterable[Any]) -> tuple[Any, ...]:
    """Return one information of each name.

    Raises:
        ConfigurationError: two of one name are not the same.
    """
    found: dict[str, Any] = {}
    for info in infos:
        if _declared(found.setdefault(info.name, info)) != _declared(info):
            raise ConfigurationError(
                f"the results to be merged know {kind} '{info.name}' differently: run one again with the other's code"
            )
    return tuple(found.values())


def _origins(results: Sequence[Result]) -> tuple[Origin, ...]:
    """Return the origins of jobs; runs of the same machine, versions and core share one."""
    found: list[Origin] = []
    for result in results:
        header = result.header
        jobs: dict[str, int] = {}
        for record in result.records:
            kind = f"{record.job.kind.value} on {record.job.backend}"
            jobs[kind] = jobs.get(kind, 0) + 1
        own = Origin(
            jobs, header.hardware, header.versions, header.sources.get(CORE, ""), header.started, result.finished
        )
        for each in header.origins or (own,):
            twin = next((other for other in found if _place(other) == _place(each)), None)
            if twin is not None:
                found.remove(twin)
            found.append(each if twin is None else _joined(twin, each))
    return tuple(found)


def _place(origin: Origin) -> tuple[object, ...]:
    return origin.hardware, origin.versions, origin.core


def _joined(one: Origin, other: Origin) -> Origin:
    jobs = {kind: one.jobs.get(kind, 0) + other.jobs.get(kind, 0) for kind in {**one.jobs, **other.jobs}}
    times = min(one.started, other.started), max(one.finished, other.finished)
    return replace(one, jobs=jobs, started=times[0], finished=times[1])
