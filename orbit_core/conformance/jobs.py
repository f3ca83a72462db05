"""The units in which a run is done, resumed and spread over processes and machines."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from orbit_core.conformance.settings import Part, Settings, scenario


class Kind(Enum):
    """What a job does."""

    SCENARIO = "scenario"
    TASK = "task"
    VIDEO = "video"
    REPLAY = "replay"
    THROUGHPUT = "throughput"


@dataclass(frozen=True)
class Job:
    """One scenario at one time step, or one task, on one backend."""

    kind: Kind
    name: str
    """Of the scenario or the task."""
    backend: str
    time_step: float = 0.0
    """Seconds; of a scenario."""
    source: str = ""
    """The backend whose recording a replay plays."""

    @property
    def key(self) -> str:
        """Unique in a run, and the folder of the job's files."""
        detail = f"{self.time_step:g}" if self.kind is Kind.SCENARIO else self.source
        return "/".join(part for part in (self.kind.value, self.name, self.backend, detail) if part)


@dataclass(frozen=True)
class Phase:
    """Jobs that may run at the same time. A phase begins when the one before it is done."""

    jobs: tuple[Job, ...]
    alone: bool = False
    """One job at a time, since it measures time."""


def plan(settings: Settings) -> list[Phase]:
    """All jobs of a run. A phase is of one backend, so that a worker never holds two engines."""
    phases = [Phase((*_scenarios(settings, backend), *_tasks(settings, backend))) for backend in settings.backends]
    phases += [Phase(tuple(_replays(settings, backend))) for backend in settings.backends]
    if Part.THROUGHPUT in settings.parts:
        phases += [
            Phase(tuple(Job(Kind.THROUGHPUT, task, backend) for task in settings.tasks), alone=True)
            for backend in settings.backends
        ]
    return [phase for phase in phases if phase.jobs]


def _scenarios(settings: Settings, backend: str) -> Iterable[Job]:
    for name in settings.scenarios:
        nominal = scenario(name).time_step
        steps = {nominal} if settings.quick else {nominal, *scenario(name).time_steps}
        for step in sorted(steps, reverse=True):
            yield Job(Kind.SCENARIO, name, backend, step)


def _tasks(settings: Settings, backend: str) -> Iterable[Job]:
    if Part.TASKS in settings.parts:
        for kind in (Kind.TASK, Kind.VIDEO):
            for task in settings.tasks:
                yield Job(kind, task, backend)


def _replays(settings: Settings, backend: str) -> Iterable[Job]:
    if Part.TASKS in settings.parts:
        for task in settings.tasks:
            for source in settings.backends:
                if source != backend:
                    yield Job(Kind.REPLAY, task, backend, source=source)
