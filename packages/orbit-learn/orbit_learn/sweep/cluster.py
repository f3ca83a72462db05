"""Trainings on the machines of a Ray cluster, each in its own process, so that one that dies leaves the others."""

from __future__ import annotations

import contextlib
import logging
import shutil
import signal
import socket
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError, OrbitError
from orbit_learn.cli.train import TrainSettings

LOCAL = "local"
# How often a training is begun again whose process died, as of a machine that went away.
_RETRIES = 3
# How often a cluster is started here, which Ray gives up after 30 s: a machine whose cores are taken needs longer.
_STARTS = 3
# Seconds in which a cluster must answer.
_PATIENCE = 5.0
# Seconds without an answer after which a cluster is gone. Ray ends the program after a minute, without an exception.
_SILENT_FOR = 20.0


def connected(address: str) -> Any:
    """Connect to a Ray cluster, and return the module ``ray``.

    Args:
        address: ``host:port`` or ``ray://host:port`` of a running cluster, ``auto`` for this machine's, or ``local`` to
            start one.

    Raises:
        ConfigurationError: Ray is not installed, no cluster answers, or none can be started.
    """
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ConfigurationError(f"a Ray cluster needs Ray: {install_extra('sweep')}") from error
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    try:
        if colon:
            # Ray itself tries for minutes.
            socket.create_connection((host.strip("[]"), int(port)), timeout=_PATIENCE).close()
        with warnings.catch_warnings(), _signals_kept():
            warnings.simplefilter("ignore")  # of Ray's own coming changes
            # What trainings print would mix line by line with the report of the sweep.
            quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
            if address == LOCAL:
                _start(ray, quiet)
            else:
                ray.init(address, **quiet)
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"no Ray cluster answers at '{address}': {error}") from error
    return ray


@contextlib.contextmanager
def _signals_kept() -> Iterator[None]:
    """Put back the handler of SIGTERM: Ray's prints a stack and ends the program, and leaves the page unwritten."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)


def _start(ray: Any, quiet: dict[str, Any]) -> None:
    """Start a cluster on this machine."""
    failure = ""
    for _ in range(_STARTS):
        try:
            ray.init(LOCAL, include_dashboard=False, **quiet)
            return
        except Exception as error:
            # Ray has no class for a start that took too long.
            if type(error) is not Exception:
                raise
            failure = _last_line(error)
            ray.shutdown()
    raise ConfigurationError(
        f"Ray did not start on this machine in {_STARTS} attempts ({failure}): end other programs that take its cores, "
        "or give --ray the address of a cluster that runs"
    )


class ClusterWatch:
    """Waits for results of a cluster, and notices when it is gone.

    Args:
        ray: the module, connected.
        address: address that it is connected to.
    """

    def __init__(self, ray: Any, address: str) -> None:
        self._ray = ray
        # Ray's own client, for which its server watches the cluster, raises errors by itself.
        self._control = "" if address.startswith("ray://") else ray.get_runtime_context().gcs_address
        self._silent_since: float | None = None

    def wait(self, references: list[Any]) -> list[Any]:
        """Wait a second at most, and return the references whose results are there.

        Raises:
            ConfigurationError: the cluster is gone.
        """
        try:
            # Not for good: Python hears Ctrl-C between two calls.
            done, _ = self._ray.wait(references, timeout=1.0)
        except (ConnectionError, self._ray.exceptions.RayError) as error:
            raise self._gone(_last_line(error)) from error
        if not done and self._control:
            self._check()
        return done

    def _check(self) -> None:
        host, _, port = self._control.rpartition(":")
        try:
            socket.create_connection((host.strip("[]"), int(port)), timeout=_PATIENCE).close()
            self._silent_since = None
        except OSError as error:
            now = time.monotonic()
            # A control process that is restarted by its machine comes back within seconds.
            self._silent_since = self._silent_since or now
            if now - self._silent_since > _SILENT_FOR:
                raise self._gone(f"{self._control}: {error}") from error

    def _gone(self, why: str) -> ConfigurationError:
        return ConfigurationError(f"the Ray cluster is gone ({why}): start it, and repeat the command, which goes on")


@dataclass(frozen=True)
class Part:
    """Training up to an iteration."""

    trial: int
    """Number of the combination."""
    settings: TrainSettings
    """Settings, but for folder and number of iterations."""
    folder: Path
    """Folder of the training; one that holds a checkpoint goes on."""
    until: int
    """Number of iterations that the training has in the end."""


class Cluster:
    """Ray cluster, on whose machines ORBIT is installed as here, and which share the sweep's folder.

    Args:
        address: address of a running cluster, or ``local`` to start one on this machine, which ends with the sweep.
        cpus: cores that a training takes.
        gpus: GPUs that a training takes.

    Raises:
        ConfigurationError: Ray is not installed, no cluster answers, or it is too small for a training.
    """

    def __init__(self, address: str, cpus: float, gpus: float) -> None:
        ray = connected(address)
        self._ray: Any = ray
        self._watch = ClusterWatch(ray, address)
        resources = ray.cluster_resources()
        self._resources = {"num_cpus": cpus, "num_gpus": gpus}
        has = {"cores": resources.get("CPU", 0.0), "GPUs": resources.get("GPU", 0.0)}
        self.slots = min(int(has[name] / taken) for name, taken in (("cores", cpus), ("GPUs", gpus)) if taken)
        """Trainings that run side by side."""
        if not self.slots:
            self.close()
            raise ConfigurationError(
                f"a training takes {cpus:g} cores and {gpus:g} GPUs, and the cluster at '{address}' has "
                f"{has['cores']:g} and {has['GPUs']:g}: set cpus and gpus of the sweep lower"
            )
        self._running: dict[Any, Part] = {}
        # A fresh process each time: engines and torch leave memory behind.
        self._train = ray.remote(max_calls=1, max_retries=_RETRIES, **self._resources)(_train_part)

    @property
    def free(self) -> int:
        """Number of further trainings that would run at once."""
        return self.slots - len(self._running)

    def start(self, part: Part) -> None:
        """Begin or continue a training."""
        self._running[self._train.remote(part)] = part

    def finished(self) -> Iterator[tuple[Part, str]]:
        """Wait for a training to end, and yield those that did, with what failed; empty where nothing did.

        Raises:
            ConfigurationError: the cluster is gone.
        """
        ray = self._ray
        for reference in self._watch.wait(list(self._running)):
            part = self._running.pop(reference)
            try:
                yield part, ray.get(reference)
            except ray.exceptions.WorkerCrashedError:
                yield part, f"its process died {_RETRIES + 1} times"
            except ray.exceptions.RayError as error:
                yield part, _last_line(error)

    def close(self) -> None:
        """Leave the cluster, and end one that was started here."""
        self._ray.shutdown()


def run_all(cluster: Cluster, parts: Sequence[Part]) -> Iterator[tuple[Part, str]]:
    """Run trainings side by side, and yield each as it ends, with what failed."""
    waiting = list(reversed(parts))
    left = len(waiting)
    while left:
        while waiting and cluster.free > 0:
            cluster.start(waiting.pop())
        for ended in cluster.finished():
            left -= 1
            yield ended


def _train_part(part: Part) -> str:
    """Train in a process of Ray's, and return what failed; empty where nothing did."""
    from orbit_learn.cli.train import train
    from orbit_learn.policy_file import newest_file
    from orbit_learn.training import CHECKPOINT

    folder, settings = part.folder, replace(part.settings, iterations=part.until)
    begun = newest_file(folder, CHECKPOINT) if folder.is_dir() else None
    if begun is None and folder.is_dir():
        # A process that died before its first checkpoint left nothing to go on from.
        shutil.rmtree(folder)
    try:
        train(replace(settings, resume=folder) if begun else replace(settings, output=folder))
    except OrbitError as error:
        return " ".join(str(error).split())
    return ""


def _last_line(error: BaseException) -> str:
    lines = [line for line in str(error).splitlines() if line.strip()]
    return lines[-1].strip() if lines else type(error).__name__
