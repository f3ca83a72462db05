"""Pools that run jobs: in processes of this machine, or of the machines of a Ray cluster.

A worker serves one backend and dies alone: an engine that crashes or hangs costs the job that it was doing.
"""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any, Protocol

from orbit_conformance.execution import Outcome, execute
from orbit_conformance.jobs import Job
from orbit_conformance.results import Ending, Record
from orbit_conformance.settings import Settings
from orbit_learn.sweep.cluster import ClusterWatch, connected

Work = tuple[Job, Settings, Mapping[str, bytes]]
"""The arguments of :func:`execute`."""


class Pool(Protocol):
    """Does work of one backend on several workers."""

    def run(self, work: Sequence[Work], alone: bool) -> Iterator[Outcome]:
        """Outcomes as they come; ``alone`` asks for one job at a time, each in a fresh process."""
        ...

    def close(self) -> None:
        """Free the workers."""
        ...


class LocalPool(Pool):
    """Processes of this machine.

    Args:
        workers: how many.
        time_limit: seconds that a job may take.
        log: a file for what engines print, and for the stack of a process that dies.
    """

    def __init__(self, workers: int, time_limit: float, log: Path) -> None:
        self._workers = workers
        self._time_limit = time_limit
        self._log = log

    def run(self, work: Sequence[Work], alone: bool) -> Iterator[Outcome]:
        from pebble import ProcessExpired, ProcessPool

        workers = 1 if alone else min(self._workers, len(work))
        context: Any = multiprocessing.get_context("spawn")  # engines and torch do not survive a fork
        pool = ProcessPool(
            workers, max_tasks=int(alone), initializer=_begin_worker, initargs=(str(self._log),), context=context
        )
        try:
            jobs: dict[Any, Job] = {pool.schedule(execute, args=one, timeout=self._time_limit): one[0] for one in work}
            for future in as_completed(jobs):
                try:
                    yield future.result()
                except TimeoutError:
                    yield _overdue(jobs[future], self._time_limit)
                except ProcessExpired as error:
                    yield _crashed(jobs[future], f"{_death(error.exitcode)}; its last words are in {self._log.name}")
        finally:
            pool.stop()
            pool.join()

    def close(self) -> None:
        pass


class RayPool(Pool):
    """Workers of a Ray cluster, on which ORBIT and the backends are installed as here.

    Args:
        address: of the cluster, or "local" to start one on this machine.
        time_limit: seconds that a job may take.

    Raises:
        ConfigurationError: Ray is not installed, or no cluster answers.
    """

    def __init__(self, address: str, time_limit: float) -> None:
        self._ray: Any = connected(address)
        self._watch = ClusterWatch(self._ray, address)
        self._time_limit = time_limit

    def run(self, work: Sequence[Work], alone: bool) -> Iterator[Outcome]:
        ray = self._ray
        workers = 1 if alone else max(1, int(ray.cluster_resources().get("CPU", 1)))
        waiting, running = list(reversed(work)), {}
        while waiting or running:
            while waiting and len(running) < workers:
                job = waiting[-1][0]
                # Workers of one environment are shared: the variable keeps those of each backend apart.
                environment = {"env_vars": {"ORBIT_CONFORMANCE_WORKER": job.backend}}
                doing = ray.remote(num_cpus=1, max_retries=0, max_calls=int(alone), runtime_env=environment)(execute)
                running[doing.remote(*waiting.pop())] = (job, time.monotonic())
            for reference in self._watch.wait(list(running)):
                yield self._outcome(reference, running.pop(reference)[0])
            for reference, (job, begin) in list(running.items()):
                if time.monotonic() - begin > self._time_limit:
                    ray.cancel(reference, force=True)
                    del running[reference]
                    yield _overdue(job, self._time_limit)

    def _outcome(self, reference: Any, job: Job) -> Outcome:
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            return _crashed(job, f"its worker died: {str(error).splitlines()[0]}")

    def close(self) -> None:
        self._ray.shutdown()


def _begin_worker(log: str) -> None:
    """Redirect engine output into the log, and write the stack of a process that dies there."""
    sys.stdout.flush()
    # O_NOFOLLOW: a link in the folder must not lead the log to another file.
    stream = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW)
    os.dup2(stream, 1)
    os.dup2(stream, 2)
    # An engine's crash leaves no Python exception; its stack in the log is all that there is.
    faulthandler.enable()
    # Engines may have workers of their own, which a daemon may not; nothing public takes the mark off again.
    multiprocessing.current_process()._config["daemon"] = False  # pyright: ignore[reportAttributeAccessIssue]
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends the workers
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # this way, and not the way it would be ended itself


def _overdue(job: Job, limit: float) -> Outcome:
    return Outcome(Record(job, Ending.TIMEOUT, f"not done within the limit of {limit:g} s", limit))


def _crashed(job: Job, reason: str) -> Outcome:
    return Outcome(Record(job, Ending.CRASH, reason))


def _death(exit_code: int) -> str:
    if exit_code >= 0:
        return f"its process ended with exit code {exit_code}"
    return f"its process died of {signal.Signals(-exit_code).name}"
