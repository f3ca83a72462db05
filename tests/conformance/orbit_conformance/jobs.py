"""The units in which a run is done, resumed and spread over processes and machines."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum

from orbit_conformance.scenario import Scenario
from orbit_conformance.settings import Part, Settings, scenario
from orbit_conformance.transfer import learned
from orbit_conformance.verdict import lacking
from orbit_core.backends import backend as find_backend
from orbit_core.backends import matter_solver
from orbit_core.interfaces.matter import NATIVE


class Kind(Enum):
    """The kinds of work that a job does."""

    SCENARIO = "scenario"
    """A scenario against its closed form, at one time step."""
    ROBOT = "robot"
    """All checks of a robot."""
    TASK = "task"
    """Episodes of a task's expert."""
    VIDEO = "video"
    """Film of a task's expert."""
    REPLAY = "replay"
    """Actions recorded on one backend, repeated on another."""
    TRANSFER = "transfer"
    """Episodes of a kept policy."""
    THROUGHPUT = "throughput"
    """Stepping rate of a task."""


@dataclass(frozen=True)
class Job:
    """One scenario at one time step, one robot, one task or one learned policy, on one backend."""

    kind: Kind
    """Kind of work."""
    name: str
    """The name of the scenario, the robot, the task or the policy."""
    backend: str
    """Name of the backend, or of the matter solver."""
    time_step: float = 0.0
    """Time step of a scenario in seconds."""
    source: str = ""
    """The backend whose recording a replay plays."""
    renderer: str = ""
    """The renderer that draws for a learned policy; the backend if empty."""
    num_envs: int = 0
    """Number of environments of a measurement of throughput."""
    matter: str = ""
    """What simulates the deformables of a scenario that has some: a matter solver's name, or ``"native"``."""
    substep: float = 0.0
    """Seconds of the matter solver's steps; its own choice if zero."""

    @property
    def key(self) -> str:
        """Unique in a run, and the folder of the job's files."""
        step = f"{self.time_step:g}" if self.time_step else ""
        count = str(self.num_envs) if self.num_envs else ""
        substep = f"substep-{self.substep:g}" if self.substep else ""
        own = (self.source, self.renderer, count, self.matter, substep)
        parts = (self.kind.value, self.name, self.backend, step, *own)
        return "/".join(part for part in parts if part)


@dataclass(frozen=True)
class Phase:
    """Jobs that may run at the same time. A phase begins when the one before it is done."""

    jobs: tuple[Job, ...]
    """Jobs in the order in which they are started."""
    alone: bool = False
    """One job at a time, each in a process of its own, since it measures time and memory."""


def plan(settings: Settings) -> list[Phase]:
    """All jobs of a run. A phase is of one backend, or of one renderer that draws for others, so that a worker never
    holds two engines that have nothing to do with each other.
    """
    phases = [
        Phase(
            (
                *_scenarios(settings, backend),
                *(Job(Kind.ROBOT, robot, backend) for robot in settings.robots),
                *_tasks(settings, backend),
                *_transfers(settings, backend),
            )
        )
        for backend in settings.backends
    ]
    # Replays need the recordings of all backends, which the phases before made.
    phases += [Phase(tuple(_replays(settings, backend))) for backend in settings.backends]
    phases += [Phase(tuple(_drawn_by(settings, renderer))) for renderer in settings.renderers]
    # Last and alone: other jobs would take cores and memory from the measurement.
    phases += [Phase(tuple(_throughput(settings, backend)), alone=True) for backend in settings.backends]
    return [phase for phase in phases if phase.jobs]


def _scenarios(settings: Settings, backend: str) -> Iterable[Job]:
    for described in map(scenario, settings.scenarios):
        for matter in settings.matters if described.of_matter else ("",):
            job = Job(Kind.SCENARIO, described.name, backend, described.time_step, matter=matter)
            yield from (job,) if settings.quick else _sweep(job, described)


def _sweep(job: Job, described: Scenario) -> Iterable[Job]:
    """A scenario's job at the nominal time step, and at those that show accuracy against cost."""
    if job.matter == NATIVE and lacking(find_backend(job.backend), described):
        yield job
    elif job.matter in ("", NATIVE):
        for step in sorted({described.time_step, *described.time_steps}, reverse=True):
            yield replace(job, time_step=step)
    else:
        yield job
        for substep in described.substeps:
            if matter_solver(job.matter).settings_at(substep):
                yield replace(job, substep=substep)


def _tasks(settings: Settings, backend: str) -> Iterable[Job]:
    if Part.TASKS in settings.parts:
        tasks = settings.scripted_tasks
        yield from (Job(Kind.TASK, task, backend) for task in tasks)
        yield from (Job(Kind.VIDEO, task, backend) for task in (tasks[:1] if settings.quick else tasks))


def _transfers(settings: Settings, backend: str) -> Iterable[Job]:
    for policy in settings.policies:
        yield Job(Kind.TRANSFER, policy, backend)


def _drawn_by(settings: Settings, renderer: str) -> Iterable[Job]:
    """Policies that see pictures, each on the backend that it was learned on, or the first if that is not run."""
    for policy in settings.policies:
        home = learned(policy).backend
        backend = home if home in settings.backends else settings.backends[0]
        if learned(policy).sees_pictures and renderer != backend:
            yield Job(Kind.TRANSFER, policy, backend, renderer=renderer)


def _replays(settings: Settings, backend: str) -> Iterable[Job]:
    if Part.TASKS in settings.parts:
        sources = settings.backends[:1] if settings.quick else settings.backends
        tasks = settings.scripted_tasks
        for task in tasks if settings.extent.slow_replays else itertools.filterfalse(settings.is_slow, tasks):
            for source in sources:
                if source != backend:
                    yield Job(Kind.REPLAY, task, backend, source=source)


def _throughput(settings: Settings, backend: str) -> Iterable[Job]:
    if Part.THROUGHPUT in settings.parts:
        for task in settings.tasks:
            for num_envs in settings.throughput_envs_of(backend):
                yield Job(Kind.THROUGHPUT, task, backend, num_envs=num_envs)
