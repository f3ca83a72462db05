"""The processes that hold the shards: this one, or workers that share their state through memory."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import signal
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import resource_tracker
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from orbit_bullet.buffers import Buffers, private_buffers, shapes_of, shared_buffers
from orbit_bullet.config import MOST_PER_CLIENT, BulletConfig
from orbit_bullet.progress import BuildProgress
from orbit_bullet.shard import Shard
from orbit_bullet.stage import SceneFiles, client_ranges, envs_per_client, split_evenly
from orbit_bullet.worker import Assignment, Failure, work
from orbit_core.interfaces import ConfigurationError, SceneLayout, SimulationError
from orbit_core.plugin_kit.scratch import ScratchFolder

FEWEST_PER_WORKER = 8
"""Environments for which a process of its own pays."""
CLIENT_MEMORY = 29e6
"""Bytes of a Bullet world, whatever is in it."""
MOST_CLIENTS = 1000
"""Bullet worlds in a process: Bullet has room for 1,024, renderers among them."""
# Seconds that workers have to end by themselves, all together.
_PATIENCE = 5.0


class Pool(ABC):
    """Shards and the buffers that they fill."""

    buffers: Buffers
    """State and commands of all environments."""
    ranges: list[tuple[int, int]]
    """The environments of each shard."""

    @abstractmethod
    def call(self, method: str, *arguments: Any, numbers: list[int] | None = None) -> list[Any]:
        """Do a method on some shards, all of them if None, and await what each gives."""

    @abstractmethod
    def call_each(self, method: str, arguments: dict[int, tuple[Any, ...]]) -> list[Any]:
        """Do a method on shards by number, each with its own arguments, and await what each gives."""

    @abstractmethod
    def post(self, number: int, method: str, *arguments: Any) -> None:
        """Do a method on one shard, before anything that is asked of it later."""

    @abstractmethod
    def settle(self) -> None:
        """Await what was posted."""

    @abstractmethod
    def close(self) -> None:
        """Free everything; idempotent."""


class LocalPool(Pool):
    """A pool of one shard in this process."""

    def __init__(
        self, layout: SceneLayout, files: SceneFiles, num_envs: int, config: BulletConfig, progress: BuildProgress
    ) -> None:
        self.buffers = private_buffers(shapes_of(layout, num_envs))
        """State and commands of all environments, in this process."""
        self.ranges = [(0, num_envs)]
        self.shard = Shard(layout, files, self.buffers, config, progress.add)
        """Shard of all environments."""

    def call(self, method: str, *arguments: Any, numbers: list[int] | None = None) -> list[Any]:
        return [getattr(self.shard, method)(*arguments)]

    def call_each(self, method: str, arguments: dict[int, tuple[Any, ...]]) -> list[Any]:
        return [getattr(self.shard, method)(*own) for own in arguments.values()]

    def post(self, number: int, method: str, *arguments: Any) -> None:
        getattr(self.shard, method)(*arguments)

    def settle(self) -> None:
        pass

    def close(self) -> None:
        self.shard.close()


class ProcessPool(Pool):
    """A shard per worker process."""

    def __init__(
        self,
        layout: SceneLayout,
        files: SceneFiles,
        num_envs: int,
        config: BulletConfig,
        progress: BuildProgress,
        workers: int,
    ) -> None:
        self.ranges = split_evenly(num_envs, workers)
        shapes = shapes_of(layout, num_envs)
        # In memory where the system has it: a file on a disk would be written back again and again.
        parent = Path("/dev/shm") if Path("/dev/shm").is_dir() else None
        self._processes: list[Any] = []
        self._connections: list[Any] = []
        self._posted: set[int] = set()
        self._dead = ""
        try:
            with ScratchFolder(f"orbit-bullet-{os.getpid()}-", parent) as folder:
                memory = folder / "state"
                self.buffers = shared_buffers(shapes, memory)
                """State and commands of all environments, in memory that workers share."""
                # In a separate thread: an exception that a signal raises here would cut a start short, and the
                # worker would complain of half a message.
                with ThreadPoolExecutor(1) as starter:
                    starter.submit(self._start_workers).result()
                for number, (start, stop) in enumerate(self.ranges):
                    self._send(number, Assignment(layout, files, config, start, stop, shapes, memory))
                self._await_build(progress)
        except BaseException:
            self.close()
            raise

    def _start_workers(self) -> None:
        """Start all of them; each then waits for its assignment, which is too long for the pipe that starts it."""
        context = multiprocessing.get_context("spawn")
        with _hidden_main(), _interrupts_held():
            for _ in self.ranges:
                ours, theirs = context.Pipe()
                process = context.Process(target=work, args=(theirs,), daemon=True)
                process.start()
                theirs.close()
                self._processes.append(process)
                self._connections.append(ours)

    def _await_build(self, progress: BuildProgress) -> None:
        """Count what the workers build until all of them are done."""
        building = set(range(len(self._processes)))
        while building:
            wait([self._connections[number] for number in building])
            for number in [number for number in building if self._connections[number].poll()]:
                built = self._receive(number)
                if isinstance(built, Failure):
                    raise built.error
                if built is None:
                    building.remove(number)
                else:
                    progress.add(built)

    @property
    def pids(self) -> list[int]:
        """Process numbers of the workers."""
        return [process.pid for process in self._processes]

    def call(self, method: str, *arguments: Any, numbers: list[int] | None = None) -> list[Any]:
        numbers = list(range(len(self.ranges))) if numbers is None else numbers
        return self.call_each(method, dict.fromkeys(numbers, arguments))

    def call_each(self, method: str, arguments: dict[int, tuple[Any, ...]]) -> list[Any]:
        for number, own in arguments.items():
            self._send(number, (method, own, True))
        self._posted -= set(arguments)
        results = [self._receive(number) for number in arguments]
        for result in results:
            if isinstance(result, Failure):
                raise result.error
        return results

    def post(self, number: int, method: str, *arguments: Any) -> None:
        self._send(number, (method, arguments, False))
        self._posted.add(number)

    def settle(self) -> None:
        if self._posted:
            self.call("", numbers=sorted(self._posted))

    def _send(self, number: int, message: Any) -> None:
        if self._dead:
            raise SimulationError(self._dead)
        try:
            self._connections[number].send(message)
        except (BrokenPipeError, ConnectionResetError):
            self._mourn(number)

    def _receive(self, number: int) -> Any:
        connection, process = self._connections[number], self._processes[number]
        while True:
            ready = wait([connection, process.sentinel])
            if connection in ready:
                try:
                    return connection.recv()
                except (EOFError, ConnectionResetError):
                    self._mourn(number)
            self._mourn(number)

    def _mourn(self, number: int) -> None:
        process = self._processes[number]
        process.join(_PATIENCE)
        start, stop = self.ranges[number]
        cause = _cause(process.exitcode)
        self._dead = (
            f"the worker process {process.pid} of environments {start} to {stop - 1} died, {cause}: "
            "the world is closed, make another"
        )
        self.close()
        raise SimulationError(self._dead)

    def close(self) -> None:
        self._dead = self._dead or "the world is closed: make another"
        for connection in self._connections:
            connection.close()
        end = time.monotonic() + _PATIENCE
        for process in self._processes:
            process.join(max(0.0, end - time.monotonic()))
            if process.is_alive():
                process.kill()
                process.join()
        self._connections.clear()


def make_pool(layout: SceneLayout, files: SceneFiles, num_envs: int, config: BulletConfig) -> Pool:
    """A pool of as many processes as the settings ask for; by default one per core where each gets enough to do.

    Raises:
        ConfigurationError: more environments than the memory, or Bullet, has room for.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    fewest = 1 if layout.scene.deformables else FEWEST_PER_WORKER
    workers = min(config.workers or min(cores, num_envs // fewest), num_envs)
    workers = max(workers, 1)
    clients = sum(
        len(client_ranges(stop - start, envs_per_client(layout, config)))
        for start, stop in split_evenly(num_envs, workers)
    )
    _refuse_too_many(clients, workers, num_envs, config)
    progress = BuildProgress(num_envs, clients * CLIENT_MEMORY)
    if workers == 1:
        return LocalPool(layout, files, num_envs, config, progress)
    return ProcessPool(layout, files, num_envs, config, progress, workers)


def _refuse_too_many(clients: int, workers: int, num_envs: int, config: BulletConfig) -> None:
    """Raise a ConfigurationError where Bullet's worlds would be more than a process or the memory holds."""
    remedy = (
        f"envs_per_client={MOST_PER_CLIENT} puts {MOST_PER_CLIENT} environments into a world, and then what one does "
        "depends, in the last digits, on how many there are"
        if config.envs_per_client < MOST_PER_CLIENT
        else "simulate fewer environments"
    )
    asked = f"{num_envs} environments need {clients} Bullet worlds"
    if clients > MOST_CLIENTS * workers:
        raise ConfigurationError(f"{asked}, and a process holds {MOST_CLIENTS}: {remedy}; or have more workers")
    available = _available_memory()
    if clients * CLIENT_MEMORY > available:
        raise ConfigurationError(
            f"{asked} of {CLIENT_MEMORY / 1e6:.0f} MB each, {clients * CLIENT_MEMORY / 1e9:.1f} GB, and "
            f"{available / 1e9:.1f} GB are available, enough for {int(available // CLIENT_MEMORY)} worlds: {remedy}"
        )


def _available_memory() -> float:
    """Bytes that the machine can give; infinite where it does not report it."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return math.inf
    return next((1024.0 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")), math.inf)


def _cause(code: int | None) -> str:
    if code is None:
        return "without a word"
    if code < 0:
        name = signal.Signals(-code).name
        return f"killed by {name}" + (", perhaps for want of memory" if name == "SIGKILL" else "")
    return f"with exit code {code}"


# Held while the user's script is hidden, so that each thread puts back what it found.
_hiding = threading.Lock()


@contextlib.contextmanager
def _hidden_main() -> Iterator[None]:
    """Workers need nothing of the user's script, which may lack the guard that its import would call for."""
    main = sys.modules["__main__"]
    with _hiding:
        kept = {name: main.__dict__.pop(name) for name in ("__file__", "__spec__") if name in main.__dict__}
        main.__dict__["__spec__"] = None
        try:
            yield
        finally:
            main.__dict__.update(kept)


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Have workers that start in this thread never get the interrupt key, even while they import."""
    resource_tracker.ensure_running()  # which lets the key through again where it has to be started
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
