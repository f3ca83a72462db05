"""Where the shards live: in this process, or in worker processes that share their state through memory."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterator
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from orbit_bullet.buffers import Buffers, private_buffers, shapes_of, shared_buffers
from orbit_bullet.config import BulletConfig
from orbit_bullet.shard import Shard
from orbit_bullet.stage import SceneFiles, split_evenly
from orbit_bullet.worker import Assignment, Failure, work
from orbit_core.interfaces import SceneLayout, SimulationError

FEWEST_PER_WORKER = 8
"""Environments for which a process of its own pays."""
_PATIENCE = 5.0
"""Seconds that a worker has to end by itself."""


class Pool(ABC):
    """Shards and the buffers that they fill."""

    buffers: Buffers
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
    """One shard in this process."""

    def __init__(self, layout: SceneLayout, files: SceneFiles, num_envs: int, config: BulletConfig) -> None:
        self.buffers = private_buffers(shapes_of(layout, num_envs))
        self.ranges = [(0, num_envs)]
        self.shard = Shard(layout, files, 0, self.buffers, config)

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
        self, layout: SceneLayout, files: SceneFiles, num_envs: int, config: BulletConfig, workers: int
    ) -> None:
        self.ranges = split_evenly(num_envs, workers)
        shapes = shapes_of(layout, num_envs)
        folder = "/dev/shm" if Path("/dev/shm").is_dir() else None
        context = multiprocessing.get_context("spawn")
        self._processes: list[Any] = []
        self._connections: list[Any] = []
        self._posted: set[int] = set()
        self._dead = ""
        with tempfile.TemporaryDirectory(prefix=f"orbit-bullet-{os.getpid()}-", dir=folder) as name:
            memory = Path(name) / "state"
            self.buffers = shared_buffers(shapes, memory)
            with _hidden_main():
                for start, stop in self.ranges:
                    ours, theirs = context.Pipe()
                    assignment = Assignment(layout, files, config, start, stop, shapes, memory)
                    process = context.Process(target=work, args=(theirs, assignment), daemon=True)
                    process.start()
                    theirs.close()
                    self._processes.append(process)
                    self._connections.append(ours)
            for number in range(workers):
                self._receive(number)

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
        for process in self._processes:
            process.join(_PATIENCE)
            if process.is_alive():
                process.kill()
                process.join()
        self._connections.clear()


def make_pool(layout: SceneLayout, files: SceneFiles, num_envs: int, config: BulletConfig) -> Pool:
    """As many processes as the settings ask for; of themselves, one per core where each gets enough to do."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    fewest = 1 if layout.scene.deformables else FEWEST_PER_WORKER
    workers = min(config.workers or min(cores, num_envs // fewest), num_envs)
    if workers <= 1:
        return LocalPool(layout, files, num_envs, config)
    return ProcessPool(layout, files, num_envs, config, workers)


def _cause(code: int | None) -> str:
    if code is None:
        return "without a word"
    if code < 0:
        name = signal.Signals(-code).name
        return f"killed by {name}" + (", perhaps for want of memory" if name == "SIGKILL" else "")
    return f"with exit code {code}"


@contextlib.contextmanager
def _hidden_main() -> Iterator[None]:
    """Workers need nothing of the user's script, which may lack the guard that its import would call for."""
    main = sys.modules["__main__"]
    kept = {name: main.__dict__.pop(name) for name in ("__file__", "__spec__") if name in main.__dict__}
    main.__dict__["__spec__"] = None
    try:
        yield
    finally:
        main.__dict__.update(kept)
