"""What a person asks of a running simulation, and the pace at which it runs.

Buttons act in the web server's threads, the simulation in its own: here they meet.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Selection:
    """What is drawn: ``count`` environments from number ``first`` on."""

    first: int = 0
    count: int = 1
    collisions: bool = False
    """Collision shapes in place of visual ones."""
    markers: bool = True
    frames: bool = False
    """Axes at the robots' bases, end effectors, finger tips, feet and wheels."""


class Controls:
    """Wishes of the person at the panel, safe to set from any thread."""

    def __init__(self, num_envs: int, paused: bool = False) -> None:
        self._num_envs = num_envs
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._paused = paused
        self._single_steps = 0
        self._reset_wanted = False
        self._stopped = False
        self._selection = Selection()
        self.speed = 1.0
        """Simulated seconds per second; infinite runs as fast as it can."""

    @property
    def paused(self) -> bool:
        """Whether no step is taken until :meth:`play`, but for single ones."""
        return self._paused

    @property
    def stopped(self) -> bool:
        """Whether the viewer is to end."""
        return self._stopped

    @property
    def selection(self) -> Selection:
        """What people chose to look at."""
        return self._selection

    def play(self) -> None:
        """Run until :meth:`pause`."""
        with self._changed:
            self._paused = False
            self._single_steps = 0
            self._changed.notify_all()

    def pause(self) -> None:
        """Hold before the next step."""
        with self._changed:
            self._paused = True
            self._changed.notify_all()

    def single_step(self) -> None:
        """Pause, and take one step more."""
        with self._changed:
            self._paused = True
            self._single_steps += 1
            self._changed.notify_all()

    def reset(self) -> None:
        """Reset all environments before the next step."""
        with self._changed:
            self._reset_wanted = True
            self._changed.notify_all()

    def stop(self) -> None:
        """End the run."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def select(
        self,
        first: int | None = None,
        count: int | None = None,
        collisions: bool | None = None,
        markers: bool | None = None,
        frames: bool | None = None,
    ) -> None:
        """Change what is drawn; None leaves as it is, and environments that do not fit are moved to fit."""
        with self._changed:
            old = self._selection
            count = min(max(1, old.count if count is None else count), self._num_envs)
            first = min(max(0, old.first if first is None else first), self._num_envs - count)
            self._selection = Selection(
                first,
                count,
                old.collisions if collisions is None else collisions,
                old.markers if markers is None else markers,
                old.frames if frames is None else frames,
            )
            self._changed.notify_all()

    def take_reset(self) -> bool:
        """Whether a reset is due; asking grants it."""
        with self._lock:
            wanted, self._reset_wanted = self._reset_wanted, False
            return wanted

    def take_step(self) -> bool:
        """Whether a step is due; asking grants it."""
        with self._lock:
            if not self._paused:
                return True
            if self._single_steps == 0:
                return False
            self._single_steps -= 1
            return True

    def wait(self, seconds: float) -> None:
        """Sleep until a wish is made, at most that long."""
        with self._changed:
            self._changed.wait(seconds)


class Pacer:
    """Holds a loop to real time; when the loop is late it does not hurry afterwards to make up for it."""

    def __init__(
        self, clock: Callable[[], float] = time.perf_counter, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._clock = clock
        self._sleep = sleep
        self._due = -math.inf

    def wait(self, period: float) -> None:
        """Return ``period`` seconds after the last return, or at once if that has passed."""
        now = self._clock()
        self._due += period
        if self._due <= now:
            self._due = now
        else:
            self._sleep(self._due - now)
