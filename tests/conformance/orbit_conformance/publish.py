"""Publication of a report: a compact page with its data for the repository, everything in an archive for a release."""

from __future__ import annotations

import hashlib
import lzma
import tarfile
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from orbit_conformance.episodes import TaskResult
from orbit_conformance.merge import copy_files, joined
from orbit_conformance.report.page import write_report
from orbit_conformance.results import Archive, Record, Result, decode, load, save, save_sparse
from orbit_conformance.robots.check import RobotResult
from orbit_conformance.throughput import Benchmark
from orbit_conformance.verdict import Divergence
from orbit_core.files import as_path, check_apart, read_bytes, storage_faults, written_whole
from orbit_core.interfaces import AssetError, ConfigurationError


def publish(
    folders: Sequence[Path | str], page: Path | str, archive: Path | str, benchmarks: Path | str | None = None
) -> Result:
    """Write the compact report of several finished runs, and the archive with all of it.

    The same runs give the same archive, byte by byte, so that its digest can be checked against the page's.

    Args:
        folders: of the runs; where two did one job, the later run's counts.
        page: folder for the compact page and its data.
        archive: folder for the archive.
        benchmarks: file of stepping rates measured outside of the runs, a JSON list of ``Benchmark``.

    Returns:
        The condensed result, which names the archive.

    Raises:
        ConfigurationError: a folder holds a condensed result, or runs differ in what a report has once.
        AssetError: a folder holds no result, or the file no benchmarks.
        StorageError: a file cannot be written.
    """
    folders, page, archive = [as_path(folder) for folder in folders], as_path(page), as_path(archive)
    check_apart(page, folders)
    results = {folder: load(folder) for folder in folders}
    for folder, result in results.items():
        if result.archive:
            raise ConfigurationError(f"{folder} holds a condensed result: unpack {result.archive.name} and name that")
    # Runs of different dates need not agree in declarations, as merged ones must.
    whole = joined([*results.values()])
    if benchmarks is not None:
        whole = replace(whole, benchmarks=_benchmarks(as_path(benchmarks)))
    name = f"orbit-conformance-{whole.finished[:10]}"
    with tempfile.TemporaryDirectory() as place, storage_faults(archive):
        report = Path(place) / name
        report.mkdir()
        # Oldest first: the files of a later run replace those of the same job.
        for folder, result in sorted(results.items(), key=lambda item: item[1].finished):
            for record in result.records:
                copy_files(record, folder, report)
        save(whole, report)
        write_report(report)
        archive.mkdir(parents=True, exist_ok=True)
        packed = _pack(report, archive / f"{name}.tar.xz")
    # After the archive, whose digest the page names.
    small = condensed(whole, packed)
    with storage_faults(page):
        page.mkdir(parents=True, exist_ok=True)
    save_sparse(small, page)
    write_report(page)
    return small


def condensed(result: Result, archive: Archive) -> Result:
    """Return what backends are judged by, and no more.

    Kept are nominal time steps, leading metrics, and of trajectories the greatest distance. Reasons of declared gaps,
    which the header has once, are left out of the records.
    """
    owners = (*result.header.backends, *result.header.matters)
    declared = {f": {gap.reason}" for owner in owners for gap in owner.gaps}
    return replace(
        result,
        header=replace(result.header, sources={}),
        records=tuple(_condensed_record(record, declared) for record in result.judged),
        partings=tuple(replace(parting, things=_farthest(parting.things)) for parting in result.partings),
        courses=(),
        archive=archive,
    )


def _condensed_record(record: Record, declared: Iterable[str]) -> Record:
    def short(reason: str) -> str:
        for words in declared:
            reason = reason.replace(words, "")
        return reason

    scenario, robot, replay, transfer = record.scenario, record.robot, record.replay, record.transfer
    return replace(
        record,
        files=(),
        seconds=0.0,
        reason=short(record.reason),
        scenario=scenario and replace(scenario, reason=short(scenario.reason)),
        robot=robot and _condensed_robot(robot, short),
        task=record.task and _leading(record.task),
        replay=replay and replace(replay, result=_leading(replay.result), divergence=_farthest(replay.divergence)),
        transfer=transfer and replace(transfer, result=_leading(transfer.result)),
    )


def _condensed_robot(robot: RobotResult, short: Callable[[str], str]) -> RobotResult:
    checks = (replace(c, reason=short(c.reason), seconds=0.0, figures={}) for c in robot.checks)
    return replace(robot, categories=(), checks=tuple(checks), spared={})


def _leading(result: TaskResult) -> TaskResult:
    """Return the result with its leading metric alone, and of its premises those that did not hold somewhere."""
    name, value = next(iter(result.metrics.items()))
    return replace(result, metrics={name: value}, premises=tuple(each for each in result.premises if each.failed))


def _farthest(things: Sequence[Divergence]) -> list[Divergence]:
    """Return the thing that two runs put farthest apart, at the instant when they do; nothing if none was tracked."""
    peaks = [(value, thing, index) for thing in things for index, value in enumerate(thing.median)]
    if not peaks:
        return []
    _, thing, index = max(peaks, key=lambda peak: peak[0])
    curves = (thing.times, thing.lower_quartile, thing.median, thing.upper_quartile)
    return [Divergence(thing.thing, *([curve[index]] for curve in curves))]


def _benchmarks(path: Path) -> tuple[Benchmark, ...]:
    try:
        return tuple(decode(read_bytes(path), list[Benchmark]))
    except (ValueError, RecursionError) as error:
        raise AssetError(f"{path} is no list of benchmarks: {error}") from error


def _pack(folder: Path, path: Path) -> Archive:
    """Write a folder as an archive whose bytes follow from its files alone: no times, owners or order of the disk."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    with written_whole(path) as part, lzma.open(part, "wb") as stream, tarfile.open(fileobj=stream, mode="w") as packed:
        for file in files:
            entry = tarfile.TarInfo(file.relative_to(folder.parent).as_posix())
            entry.size, entry.mode = file.stat().st_size, 0o644
            with file.open("rb") as content:
                packed.addfile(entry, content)
    content = path.read_bytes()
    return Archive(path.name, hashlib.sha256(content).hexdigest(), round(len(content) / 2**20, 1))
