"""Runs the suite: plans the jobs, leaves out those that are done, keeps each outcome as it comes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from orbit_conformance.courses import Course, course_of
from orbit_conformance.execution import RECORDING, Outcome
from orbit_conformance.hardware import Hardware, versions
from orbit_conformance.jobs import Job, Kind, plan
from orbit_conformance.journal import Journal, now
from orbit_conformance.pools import Pool, Work
from orbit_conformance.recording import Recording
from orbit_conformance.results import BackendInfo, Ending, Header, Parting, PolicyInfo, Record, Result, ScenarioInfo
from orbit_conformance.settings import Settings, scenario
from orbit_conformance.sources import source_digests
from orbit_conformance.tasks import compare_recordings
from orbit_core.backends import backend as find_backend
from orbit_core.backends import matter_solver
from orbit_core.files import as_path
from orbit_core.interfaces import Backend
from orbit_core.interfaces.matter import NATIVE, MatterSolver

Progress = Callable[[Record | None, int, int], None]
"""A callback that takes the record that has arrived, if one has, the number of records so far and the total."""


def run(
    settings: Settings,
    folder: Path | str,
    pool: Pool,
    progress: Progress = lambda record, done, total: None,
    tell: Callable[[str], None] = lambda line: None,
    fresh: bool = False,
) -> Result:
    """Do all jobs of the settings that the folder does not hold yet.

    Args:
        settings: what to run.
        folder: for records and files.
        pool: where to do it; closed in the end.
        progress: called at the beginning and after each job.
        tell: takes a line on what is done again, if anything is.
        fresh: do all anew, whatever the folder holds.

    Raises:
        ConfigurationError: the folder holds an unfinished run of other settings, versions or another core, or another
            process writes into it.
        StorageError: the disk is full, or the folder cannot be written.
    """
    folder = as_path(folder)
    phases = plan(settings)
    total = sum(len(phase.jobs) for phase in phases)
    try:
        journal = Journal(folder, header_of(settings), fresh)
        try:
            if journal.dropped:
                tell(journal.dropped)
            progress(None, len(journal.records), total)
            for phase in phases:
                work = [one for job in phase.jobs if (one := _work(job, settings, journal)) is not None]
                for outcome in pool.run(work, phase.alone) if work else ():
                    journal.add(outcome)
                    progress(outcome.record, len(journal.records), total)
            return journal.finish(_partings(settings, journal), _courses(settings, journal))
        finally:
            journal.close()
    finally:
        pool.close()


def _partings(settings: Settings, journal: Journal) -> Iterator[Parting]:
    """Divergences of every pair of backends on which a task was recorded."""
    for task in settings.scripted_tasks:
        paths = _recordings(task, settings, journal)
        for reference, backend in itertools.combinations(paths, 2):
            yield Parting(task, backend, reference, compare_recordings(paths[backend], paths[reference]))


def _courses(settings: Settings, journal: Journal) -> Iterator[Course]:
    """Of every task with deformables on every backend on which it was recorded."""
    for task in settings.scripted_tasks:
        for path in _recordings(task, settings, journal).values():
            if (course := course_of(Recording.load(path))) is not None:
                yield course


def _recordings(task: str, settings: Settings, journal: Journal) -> dict[str, Path]:
    """The recordings of a task by backend."""
    return {
        backend: journal.folder / key / RECORDING
        for backend in settings.backends
        if RECORDING in getattr(journal.records.get(key := Job(Kind.TASK, task, backend).key), "files", ())
    }


def header_of(settings: Settings) -> Header:
    """The header of a run: its settings, machine, versions and time."""
    return Header(
        settings=settings,
        versions=versions(),
        hardware=Hardware.here(),
        started=now(),
        scenarios=tuple(ScenarioInfo.of(scenario(name)) for name in settings.scenarios),
        backends=tuple(_info(find_backend(name)) for name in settings.backends),
        matters=tuple(_info(matter_solver(name)) for name in settings.matters if name != NATIVE),
        policies=tuple(PolicyInfo.of(name) for name in settings.policies),
        sources=source_digests(settings),
    )


def _info(plugin: Backend | MatterSolver) -> BackendInfo:
    return BackendInfo(plugin.name, plugin.versions(), plugin.gaps())


def _work(job: Job, settings: Settings, journal: Journal) -> Work | None:
    """A job with the files that it needs; None if it is done, or cannot be."""
    if job.key in journal.records:
        return None
    inputs: Mapping[str, bytes] = {}
    if job.kind is Kind.REPLAY:
        source = journal.records[Job(Kind.TASK, job.name, job.source).key]
        if RECORDING not in source.files:
            reason = f"nothing was recorded on backend '{job.source}': {source.reason}"
            journal.add(Outcome(Record(job, Ending.UNSUPPORTED, reason)))
            return None
        inputs = {RECORDING: (journal.folder / source.job.key / RECORDING).read_bytes()}
    return job, settings, inputs
