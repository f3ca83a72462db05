"""Results of a run as typed data and as JSON. Numbers that are not finite are written as text, such as "nan"."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from orbit_conformance.courses import Course
from orbit_conformance.episodes import TaskResult
from orbit_conformance.hardware import Hardware
from orbit_conformance.jobs import Job, Kind
from orbit_conformance.replay import ReplayResult
from orbit_conformance.robots.check import RobotResult
from orbit_conformance.scenario import Metric, Scenario
from orbit_conformance.settings import Settings
from orbit_conformance.throughput import Benchmark, Throughput
from orbit_conformance.transfer import TransferResult, learned
from orbit_conformance.verdict import Divergence, Status
from orbit_core.files import as_path, read_bytes, written_whole
from orbit_core.interfaces import AssetError, ConfigurationError, Gap
from orbit_core.interfaces.matter import NATIVE
from orbit_data.tensor_file import parse_json
from orbit_learn.pretrained import TransferGap, pretrained_policy

SCHEMA = 1
RESULT_FILE, REPORT = "result.json", "report.html"
_Type = TypeVar("_Type")


class Ending(Enum):
    """Ways in which a job ends."""

    DONE = "done"
    """It has a result."""
    UNSUPPORTED = "unsupported"
    """The backend declares that it lacks what is needed."""
    ERROR = "error"
    """It raised an exception."""
    CRASH = "crash"
    """Its process died."""
    TIMEOUT = "timeout"
    """It took longer than the limit and was ended."""

    @property
    def acceptable(self) -> bool:
        """True if the job ended without an error, crash or timeout."""
        return self in (Ending.DONE, Ending.UNSUPPORTED)


@dataclass(frozen=True)
class ScenarioResult:
    """The outcome of a scenario at one time step on one backend."""

    status: Status | None
    """Status at the nominal time step; None at the others, where no tolerance holds."""
    reason: str
    """Reason for anything but a pass."""
    errors: dict[str, float]
    """Errors by metric."""
    simulated_seconds: float
    """Simulated time, summed over all environments."""
    wall_seconds: float
    """Wall time spent in stepping."""

    @property
    def speed(self) -> float:
        """Simulated seconds per second; NaN if nothing was stepped."""
        return self.simulated_seconds / self.wall_seconds if self.wall_seconds else math.nan


@dataclass(frozen=True)
class Record:
    """A job with its ending and its results."""

    job: Job
    """Job of the run."""
    ending: Ending
    """Way in which it ended."""
    reason: str = ""
    """The reason for any ending but a good one."""
    seconds: float = 0.0
    """Wall time of the job, building included."""
    device: str = "cpu"
    """Torch device of the backend."""
    files: tuple[str, ...] = ()
    """Paths of the files below the job's folder in the result's."""
    scenario: ScenarioResult | None = None
    """Result of a scenario; None for other jobs."""
    robot: RobotResult | None = None
    """Result of a robot; None for other jobs."""
    task: TaskResult | None = None
    """Result of a task; None for other jobs."""
    replay: ReplayResult | None = None
    """Result of a replay; None for other jobs."""
    transfer: TransferResult | None = None
    """Result of a policy; None for other jobs."""
    throughput: Throughput | None = None
    """Result of a measurement of speed; None for other jobs."""

    @property
    def played(self) -> TaskResult | None:
        """The results of the episodes of a task's expert or of a learned policy."""
        return self.transfer.result if self.transfer else self.task

    @property
    def status(self) -> Status:
        """Status of the backend; a job that broke counts as failed."""
        # The order matters: a refusal is no failure, a crash is one whatever was measured before.
        if self.ending is Ending.UNSUPPORTED:
            return Status.UNSUPPORTED
        if not self.ending.acceptable or (self.task and self.task.shortfall):
            return Status.FAIL
        judged = self.scenario or self.robot or self.transfer
        return (judged.status if judged else None) or Status.PASS

    @property
    def why(self) -> str:
        """The reason for anything but a pass."""
        judged = self.scenario or self.robot or self.transfer
        return self.reason or (judged.reason if judged else "") or (self.task.shortfall if self.task else "")


@dataclass(frozen=True)
class ScenarioInfo:
    """A scenario as reports show it."""

    name: str
    """Name in snake case."""
    group: str
    """Heading under which reports show it."""
    question: str
    """Question to an engine, in one sentence."""
    truth: str
    """Closed form or converged reference."""
    source: str
    """Origin of the truth: a textbook or a paper."""
    time_step: float
    """Nominal time step, s."""
    metrics: tuple[Metric, ...]
    """Errors with their tolerances."""

    @staticmethod
    def of(scenario: Scenario) -> ScenarioInfo:
        """The information that reports show of a scenario."""
        return ScenarioInfo(*(getattr(scenario, name) for name in ScenarioInfo.__dataclass_fields__))


@dataclass(frozen=True)
class BackendInfo:
    """A backend, or a matter solver, as it declared itself when the run began."""

    name: str
    """Name in commands."""
    versions: dict[str, str]
    """Versions of the distributions that it depends on."""
    gaps: tuple[Gap, ...]
    """Declared misses."""


@dataclass(frozen=True)
class PolicyInfo:
    """A kept policy as it was when the run began."""

    name: str
    """Name of the kept policy."""
    description: str
    """One line."""
    task: str
    """Name of the task that it was learned on."""
    learned_on: str
    """The backend that the policy was learned on."""
    library: str
    """Library that learned it."""
    iteration: int
    """Iterations of training."""
    least_success: float
    """The success rate required of the policy where no gap declares less."""
    gaps: tuple[TransferGap, ...]
    """Backends and renderers on which it is known to succeed less often."""

    @staticmethod
    def of(name: str) -> PolicyInfo:
        """The information that reports show of a pretrained policy."""
        kept, about = pretrained_policy(name), learned(name)
        where = (about.task, about.backend, about.library, about.iteration)
        return PolicyInfo(name, kept.description, *where, kept.least_success, kept.gaps)


@dataclass(frozen=True)
class Origin:
    """Machine, versions and dates of some of the jobs of a merged result."""

    jobs: dict[str, int]
    """Numbers of jobs by their kind and backend, as in ``"task on <backend>"``."""
    hardware: Hardware
    """Machine of these jobs."""
    versions: dict[str, str]
    """Versions of ORBIT, engines, torch and Python."""
    core: str
    """The digest of the core's source."""
    started: str
    """Time in UTC (ISO 8601)."""
    finished: str
    """Time in UTC (ISO 8601)."""


@dataclass(frozen=True, kw_only=True)
class Header:
    """Head of a run's result, written before its first record."""

    settings: Settings
    """Settings of the run."""
    versions: dict[str, str]
    """Versions of ORBIT, engines, torch and Python."""
    hardware: Hardware
    """Machine of the run."""
    started: str
    """Time in UTC (ISO 8601)."""
    scenarios: tuple[ScenarioInfo, ...]
    """Scenarios that were run."""
    backends: tuple[BackendInfo, ...]
    """Backends that were measured."""
    matters: tuple[BackendInfo, ...] = ()
    """The matter solvers."""
    policies: tuple[PolicyInfo, ...] = ()
    """Kept policies that were run."""
    sources: dict[str, str] = field(default_factory=dict)
    """Digests of the code that the records come from, as :func:`sources.source_digests` names it."""
    origins: tuple[Origin, ...] = ()
    """Of a merged result, whose own machine and versions are those of the first run."""
    schema: int = SCHEMA
    """Version of the result's layout; other versions are not read."""


@dataclass(frozen=True)
class Parting:
    """Distance over time between one task's trajectories on two backends."""

    task: str
    """Name of the task."""
    backend: str
    """Name of the backend."""
    reference: str
    """Backend that it is compared with."""
    things: list[Divergence]
    """Distance over time of each tracked thing."""


@dataclass(frozen=True)
class Archive:
    """File that holds the whole of a condensed result: all time steps, curves, plots and videos."""

    name: str
    """Name of the file in a release."""
    sha256: str
    """Digest of the file."""
    mebibytes: float
    """Size of the file."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """A finished run."""

    header: Header
    """Settings, versions and machine."""
    records: tuple[Record, ...]
    """Records of all jobs."""
    partings: tuple[Parting, ...] = ()
    """Distances between trajectories of tasks on different backends."""
    courses: tuple[Course, ...] = ()
    """Of tasks with deformables."""
    finished: str = ""
    """Time in UTC (ISO 8601)."""
    benchmarks: tuple[Benchmark, ...] = ()
    """Stepping rates measured outside of the run, as on GPUs that a run's machine lacks."""
    archive: Archive | None = None
    """Set in a condensed result only."""

    def of(self, kind: Kind) -> list[Record]:
        """The records of one kind."""
        return [record for record in self.records if record.job.kind is kind]

    @property
    def tried_tasks(self) -> tuple[str, ...]:
        """The tasks that an expert was tried at, in the settings' order."""
        tried = {record.job.name for record in self.of(Kind.TASK)}
        return tuple(task for task in self.header.settings.tasks if task in tried)

    def matters(self, name: str) -> list[str]:
        """Return the matter solvers of one scenario, the engine's own last; a single empty name without any."""
        found = dict.fromkeys(matter for of, _, matter in self._scenarios if of == name)
        return sorted(found, key=lambda matter: (matter == NATIVE, matter)) or [""]

    def scenario_records(self, name: str, backend: str, matter: str = "") -> list[Record]:
        """The records of one scenario on one backend, the longest time step first."""
        return self._scenarios.get((name, backend, matter), [])

    @cached_property
    def _scenarios(self) -> dict[tuple[str, str, str], list[Record]]:
        """Records of scenarios by name, backend and matter, the longest time step first."""
        # A page asks for some thousand cells; a search through all records for each of them takes seconds.
        found: dict[tuple[str, str, str], list[Record]] = {}
        for record in self.of(Kind.SCENARIO):
            found.setdefault((record.job.name, record.job.backend, record.job.matter), []).append(record)
        for records in found.values():
            records.sort(key=lambda record: (-record.job.time_step, -record.job.substep))
        return found

    def nominal(self, scenario: ScenarioInfo, backend: str, matter: str = "") -> Record | None:
        """The record on which a backend, or the matter on it, is judged; None if it was not run."""
        records = self.scenario_records(scenario.name, backend, matter)
        return next((r for r in records if r.job.time_step == scenario.time_step and not r.job.substep), None)

    @property
    def judged(self) -> list[Record]:
        """The records that backends are judged by: scenarios at nominal time steps, and all of tasks and policies."""
        nominal = {info.name: info.time_step for info in self.header.scenarios}

        def is_nominal(job: Job) -> bool:
            return job.time_step == nominal[job.name] and not job.substep

        return [record for record in self.records if record.job.kind is not Kind.SCENARIO or is_nominal(record.job)]

    @property
    def objections(self) -> list[Record]:
        """The records in which a backend is not as it declares."""
        return [record for record in self.judged if not record.status.acceptable]


def encode(value: Any) -> str:
    """The value as one line of JSON."""
    return json.dumps(_plain(msgspec.to_builtins(value)), allow_nan=False)


def encode_sparse(value: Any) -> str:
    """Return the value as one line of JSON without the fields that have their defaults, rounded to four digits
    below 1000 and to integers above."""
    return json.dumps(_sparse(value), allow_nan=False, separators=(",", ":"))


def decode(text: str | bytes, kind: type[_Type]) -> _Type:
    """The value of that type, decoded from JSON.

    Raises:
        ValueError: it is none; says where.
    """
    return msgspec.convert(json.loads(text), kind, strict=False)


def load(path: Path | str) -> Result:
    """The result of a finished run, from its file or its folder.

    Raises:
        AssetError: it cannot be read, or is of another schema.
    """
    path = as_path(path)
    path = path / RESULT_FILE if path.is_dir() else path
    try:
        text = read_bytes(path)
        schema = parse_json(text)["header"]["schema"]
    except ConfigurationError as error:
        raise AssetError(f"cannot read {path}: {error}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise AssetError(f"{path} is no result of orbit conformance") from error
    if schema != SCHEMA:
        raise AssetError(f"{path} is of schema {schema}, and this version reads {SCHEMA}: make it anew")
    try:
        return decode(text, Result)
    except (ValueError, RecursionError) as error:
        raise AssetError(f"{path} is no result of orbit conformance: {error}") from error


def save(result: Result, folder: Path | str) -> None:
    """Write the result's file.

    Raises:
        StorageError: it cannot be written.
    """
    with written_whole(as_path(folder) / RESULT_FILE) as path:
        path.write_text(f"{encode(result)}\n")


def save_sparse(result: Result, folder: Path | str) -> None:
    """Write the result's file without defaults and with a line for each record, so that changes of it are legible.

    Raises:
        StorageError: it cannot be written.
    """
    head = encode_sparse(replace(result, records=()))
    lines = ",\n".join(map(encode_sparse, result.records))
    with written_whole(as_path(folder) / RESULT_FILE) as path:
        path.write_text(f'{head[:-1]},"records":[\n{lines}\n]}}\n')


def _sparse(value: Any) -> Any:
    """Return the value as plain data without defaults; a field without a default is always there."""
    if is_dataclass(value):
        pairs = ((each, getattr(value, each.name)) for each in fields(value))
        kept = ((each.name, own) for each, own in pairs if each.name == "schema" or own != _default(each))
        return {name: _sparse(own) for name, own in kept}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, float):
        if not math.isfinite(value):
            return repr(value)
        return float(f"{value:.4g}") if abs(value) < 1000.0 else round(value)
    if isinstance(value, Mapping):
        return {key: _sparse(item) for key, item in value.items()}
    # Curves are rounded to what a plot can show, which halves the file.
    if isinstance(value, list | tuple):
        return [_sparse(item) for item in value]
    return value


def _default(each: Field[Any]) -> Any:
    return each.default_factory() if each.default_factory is not MISSING else each.default


def _plain(value: Any) -> Any:
    """The value as plain data: numbers that are not finite as text, curves rounded to what a plot could show."""
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(float(f"{item:.5g}") if isinstance(item, float) else item) for item in value]
    return value
