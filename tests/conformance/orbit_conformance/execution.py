"""Execution of one job, in a worker process on this machine or another."""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch

from orbit_conformance.episodes import TaskResult
from orbit_conformance.jobs import Job, Kind
from orbit_conformance.replay import replay
from orbit_conformance.results import Ending, Record, ScenarioResult
from orbit_conformance.robots.check import TIME_STEP
from orbit_conformance.robots.checks import check_robot
from orbit_conformance.scenario import Trial
from orbit_conformance.settings import Settings, scenario
from orbit_conformance.tasks import run_task
from orbit_conformance.throughput import measure_once
from orbit_conformance.transfer import learned, transfer
from orbit_conformance.verdict import Status, run_scenario
from orbit_core.backends import backend, backend_names
from orbit_core.backends import backend as find_backend
from orbit_core.envs import make
from orbit_core.envs.actors import ExpertActor
from orbit_core.files import DISK_FULL
from orbit_core.interfaces import Backend, Capability, Level, StorageError, UnsupportedCapabilityError
from orbit_core.interfaces.matter import NATIVE
from orbit_core.plugin_kit.scratch import OWNER, ScratchFolder
from orbit_core.rollout.pictures import video_recorder
from orbit_core.rollout.stepping import roll_out

RECORDING = "recording.npz"
TRACES = "traces.json"
VIDEO = "video.mp4"
# Significant digits to which a trace is rounded: more than a plot shows.
_DIGITS = 6


@dataclass(frozen=True)
class Outcome:
    """A job's record and its files: all that comes back from a worker."""

    record: Record
    """Record of the job."""
    files: Mapping[str, bytes] = field(default_factory=dict)
    """Contents of the files by name."""


def execute(job: Job, settings: Settings, inputs: Mapping[str, bytes]) -> Outcome:
    """Run one job.

    Args:
        job: what to do.
        settings: of the run.
        inputs: files by name that earlier jobs made and this one needs.

    Returns:
        The outcome; an exception becomes a record.

    Raises:
        StorageError: the disk is full, which is no fault of the backend.
    """
    torch.set_num_threads(1)  # other jobs run on the other cores
    begin = time.perf_counter()
    record = Record(job, Ending.DONE, device=settings.device_of(job.backend))
    with ScratchFolder("orbit-conformance-") as folder:
        try:
            for file, content in inputs.items():
                (folder / file).write_bytes(content)
            record = _DOINGS[job.kind](record, settings, folder)
        # A refusal is a result: the backend declares the gap itself.
        except UnsupportedCapabilityError as error:
            record = replace(record, ending=Ending.UNSUPPORTED, reason=str(error))
        except StorageError:
            raise
        except Exception as error:
            # A full disk would fail every later job as well, and blame the backend for each.
            if isinstance(error, OSError) and error.errno in DISK_FULL:
                raise StorageError(f"cannot write into folder {folder.parent}: {error.strerror}") from error
            traceback.print_exc()
            record = replace(record, ending=Ending.ERROR, reason=f"{type(error).__name__}: {error}")
        # Inputs are files of another job, which has them already.
        own = [path for path in sorted(folder.iterdir()) if path.name not in inputs and path.name != OWNER]
        made = {path.name: path.read_bytes() for path in own}
    return Outcome(replace(record, seconds=time.perf_counter() - begin, files=tuple(made)), made)


def _scenario(record: Record, settings: Settings, folder: Path) -> Record:
    job, described = record.job, scenario(record.job.name)
    # Tolerances hold at the nominal time step only; a sweep shows errors without a verdict.
    nominal = job.time_step == described.time_step and not job.substep
    own, matter = settings.settings_of(job.backend), job.matter or NATIVE
    trial = Trial(job.backend, job.time_step, record.device, own, settings.seed, matter, job.substep)
    verdict = run_scenario(described, find_backend(job.backend), trial)
    if nominal and trial.traces:
        _write_traces(trial, folder / TRACES)
    ending = Ending.UNSUPPORTED if verdict.status is Status.UNSUPPORTED else Ending.DONE
    result = ScenarioResult(
        status=verdict.status if nominal else None,
        reason=verdict.reason if nominal else "",
        errors=dict(verdict.errors),
        simulated_seconds=trial.simulated_seconds,
        wall_seconds=trial.wall_seconds,
    )
    return replace(record, ending=ending, reason="" if ending is Ending.DONE else verdict.reason, scenario=result)


def _robot(record: Record, settings: Settings, folder: Path) -> Record:
    job = record.job
    trial = Trial(job.backend, TIME_STEP, record.device, settings.settings_of(job.backend), settings.seed)
    return replace(record, robot=check_robot(job.name, find_backend(job.backend), trial))


def _write_traces(trial: Trial, path: Path) -> None:
    def rounded(values: list[float]) -> list[float]:
        return [float(f"{value:.{_DIGITS}g}") for value in values]

    columns = ("times", "measured", "truth")
    path.write_text(
        json.dumps(
            [
                {"name": trace.name, "unit": trace.unit, **{c: rounded(getattr(trace, c)) for c in columns}}
                for trace in trial.traces
            ]
        )
    )


def _task(record: Record, settings: Settings, folder: Path) -> Record:
    extent, job = settings.extent, record.job

    def run(num_envs: int) -> TaskResult:
        return run_task(
            job.name,
            job.backend,
            num_envs=num_envs,
            seed=settings.seed,
            recording=folder / RECORDING,
            device=record.device,
            settings=settings.settings_of(job.backend),
        )

    result = run(extent.slow_episodes if settings.is_slow(job.name) else extent.episodes)
    if result.num_envs == 1 < extent.episodes and result.success.value < result.expert_success:
        result = run(2)  # one miss says little
    return replace(record, task=result)


def _replay(record: Record, settings: Settings, folder: Path) -> Record:
    backend = record.job.backend
    own = settings.settings_of(backend)
    return replace(record, replay=replay(folder / RECORDING, backend, device=record.device, settings=own))


def _transfer(record: Record, settings: Settings, folder: Path) -> Record:
    job = record.job
    extent = settings.extent
    result = transfer(
        job.name,
        job.backend,
        num_envs=extent.pixel_episodes if learned(job.name).sees_pictures else extent.episodes,
        seed=settings.seed,
        device=record.device,
        settings=settings.settings_of(job.backend),
        renderer=job.renderer or None,
    )
    return replace(record, transfer=result)


def _throughput(record: Record, settings: Settings, folder: Path) -> Record:
    extent, job = settings.extent, record.job
    measured = measure_once(
        job.name,
        job.backend,
        job.num_envs,
        extent.blocks,
        extent.block_steps,
        settings.seed,
        device=record.device,
        settings=settings.settings_of(job.backend),
    )
    return replace(record, throughput=measured)


def _video(record: Record, settings: Settings, folder: Path) -> Record:
    film(
        record.job.name,
        record.job.backend,
        folder / VIDEO,
        seconds=settings.extent.video_seconds,
        seed=settings.seed,
        device=record.device,
        settings=settings.settings_of(record.job.backend),
    )
    return record


_DOINGS: dict[Kind, Callable[[Record, Settings, Path], Record]] = {
    Kind.SCENARIO: _scenario,
    Kind.ROBOT: _robot,
    Kind.TASK: _task,
    Kind.REPLAY: _replay,
    Kind.TRANSFER: _transfer,
    Kind.VIDEO: _video,
    Kind.THROUGHPUT: _throughput,
}


WIDTH, HEIGHT = 256, 192


def film(
    task: str, backend_name: str, path: Path, *, seconds: float, seed: int, device: str, settings: Mapping[str, Any]
) -> None:
    """Film the first environment of a task for some seconds, its expert acting, from the task's own view.

    A backend that draws nothing is drawn by another one, the same for all such.

    Raises:
        UnsupportedCapabilityError: nothing that is installed draws, or the backend lacks what the task needs.
    """
    environment = make(task, 1, backend_name, device, seed, renderer_for(backend(backend_name)), settings)
    try:
        expert = ExpertActor(environment, seed)
        environment.reset()
        steps = min(environment.max_episode_steps, round(seconds / environment.step_dt))
        with video_recorder(environment, path, 1, WIDTH, HEIGHT) as recorder:
            roll_out(environment, expert, (recorder,), max_steps=steps)
    finally:
        environment.close()


def renderer_for(simulating: Backend) -> str:
    """The backend itself if it draws, else the one that draws most exactly."""
    if simulating.capabilities().has(Capability.RGB):
        return simulating.name
    drawing = [name for name in backend_names() if backend(name).capabilities().has(Capability.RGB)]
    if not drawing:
        raise UnsupportedCapabilityError(
            f"backend '{simulating.name}' does not draw, and no other is installed that does"
        )
    images = (Capability.RGB, Capability.DEPTH, Capability.NORMALS, Capability.ALBEDO, Capability.SEGMENTATION)

    def exactness(name: str) -> int:
        return sum(backend(name).capabilities()[image].level is Level.EXACT for image in images)

    # A picture of the report should look alike for all engines that cannot draw.
    return max(drawing, key=exactness)
