"""The assignment of a process that simulates some of the environments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from orbit_bullet.buffers import shared_buffers
from orbit_bullet.config import BulletConfig
from orbit_bullet.shard import Shard
from orbit_bullet.stage import SceneFiles
from orbit_core.interfaces import SceneLayout
from orbit_core.plugin_kit.shared_arrays import Shapes


@dataclass(frozen=True)
class Assignment:
    """The environments that one worker simulates, and the memory in which it shares their state."""

    layout: SceneLayout
    """Numbers of the scene's links and joints."""
    files: SceneFiles
    """Files that bodies are loaded from."""
    config: BulletConfig
    """Settings of the backend."""
    start: int
    """First environment."""
    stop: int
    """One past the last environment."""
    shapes: Shapes
    """Shapes of the shared arrays."""
    memory: Path
    """File that is mapped into both processes."""

    def __call__(self, report: Callable[[int], None]) -> Shard:
        """Build the shard in the worker."""
        rows = shared_buffers(self.shapes, self.memory).rows(self.start, self.stop)
        return Shard(self.layout, self.files, rows, self.config, report)
