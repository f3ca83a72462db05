"""The processes that hold the shards: this one, or workers that share their state through memory."""

from __future__ import annotations

import math
import os
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

from orbit_bullet.buffers import Buffers, private_buffers, shapes_of, shared_buffers
from orbit_bullet.config import MOST_PER_CLIENT, BulletConfig
from orbit_bullet.progress import BuildProgress
from orbit_bullet.shard import Shard
from orbit_bullet.stage import SceneFiles, client_ranges, envs_per_client
from orbit_bullet.worker import Assignment
from orbit_core.interfaces import ConfigurationError, SceneLayout
from orbit_core.plugin_kit.scratch import ScratchFolder
from orbit_core.plugin_kit.shared_arrays import SHARED_FOLDER
from orbit_core.plugin_kit.workers import Workers, split_evenly, worker_count

FEWEST_PER_WORKER = 8
"""Environments for which a process of its own pays."""
CLIENT_MEMORY = 29e6
"""Bytes of a Bullet world, whatever is in it."""
MOST_CLIENTS = 1000
"""Bullet worlds in a process: Bullet has room for 1,024, renderers among them."""


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
        with ScratchFolder(f"orbit-bullet-{os.getpid()}-", SHARED_FOLDER) as folder:
            memory = folder / "state"
            self.buffers = shared_buffers(shapes, memory)
            """State and commands of all environments, in memory that workers share."""
            makers = [Assignment(layout, files, config, *own, shapes, memory) for own in self.ranges]
            self._workers = Workers(self.ranges, makers, progress.add)

    @property
    def pids(self) -> list[int]:
        """Process numbers of the workers."""
        return self._workers.pids

    def call(self, method: str, *arguments: Any, numbers: list[int] | None = None) -> list[Any]:
        return self._workers.call(method, *arguments, numbers=numbers)

    def call_each(self, method: str, arguments: dict[int, tuple[Any, ...]]) -> list[Any]:
        return self._workers.call_each(method, arguments)

    def post(self, number: int, method: str, *arguments: Any) -> None:
        self._workers.post(number, method, *arguments)

    def settle(self) -> None:
        self._workers.settle()

    def close(self) -> None:
        self._workers.close()


def make_pool(layout: SceneLayout, files: SceneFiles, num_envs: int, config: BulletConfig) -> Pool:
    """A pool of as many processes as the settings ask for; by default one per core where each gets enough to do.

    Raises:
        ConfigurationError: more environments than the memory, or Bullet, has room for.
    """
    fewest = 1 if layout.scene.deformables else FEWEST_PER_WORKER
    workers = worker_count(config.workers, num_envs, num_envs // fewest)
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
