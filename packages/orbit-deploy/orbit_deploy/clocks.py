"""Clocks of two computers: a robot's own, its offset as a client estimates it, and statistics of latencies."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class RobotClock:
    """Clock of a robot's computer; ``offset`` and ``drift`` are for simulated ones, whose clock differs from ours."""

    offset: float = 0.0
    """Seconds by which it is ahead."""
    drift: float = 0.0
    """Relative error of its rate, such as 5e-5 (50 parts in a million)."""

    def now(self) -> int:
        """Return its time, ns."""
        return round(time.monotonic_ns() * (1.0 + self.drift) + 1e9 * self.offset)


class ClockOffset:
    """Estimate of how far a remote clock is ahead of ours, from requests and their answers.

    The answer with the least round trip among the last ones counts: its error is at most half of that round trip.
    A window of the last ones lets the estimate follow a drift.

    Args:
        window: number of answers that count.
    """

    def __init__(self, window: int = 40) -> None:
        self._answers: deque[tuple[int, int]] = deque(maxlen=window)

    def add(self, sent: int, remote: int, received: int) -> None:
        """Add an answer.

        Args:
            sent: our time when the request was sent, ns.
            remote: remote time in the answer, ns.
            received: our time when the answer arrived, ns.
        """
        # Both ways are taken for equally long; the error is at most half of the round trip.
        self._answers.append((received - sent, remote - (sent + received) // 2))

    @property
    def known(self) -> bool:
        """True once an answer has arrived."""
        return bool(self._answers)

    @property
    def offset(self) -> int:
        """Remote time minus ours, ns; 0 before the first answer."""
        return min(self._answers)[1] if self._answers else 0

    @property
    def error(self) -> float:
        """Bound of the estimate's error, s; infinite before the first answer."""
        return 0.5e-9 * min(self._answers)[0] if self._answers else float("inf")

    def to_remote(self, ours: int) -> int:
        """Return the remote time of our time, ns."""
        return ours + self.offset

    def to_ours(self, remote: int) -> int:
        """Return our time of a remote time, ns."""
        return remote - self.offset


class StampWatch:
    """Watch for a remote clock that jumps. Delays of messages, which only make stamps older, are no jumps.

    Args:
        most: seconds that a clock may be corrected by.
    """

    def __init__(self, most: float = 0.5) -> None:
        self._most = most
        self._last, self._ahead = -np.inf, np.inf
        self.jump = 0.0
        """Seconds of the first jump; 0 without one."""

    def add(self, stamp: float, arrived: float) -> None:
        """Add a message, in the order of sending.

        Args:
            stamp: its stamp on the remote clock, s; 0 from publishers that leave it out.
            arrived: our time of its arrival, s.
        """
        if not stamp or self.jump:
            return
        # The message with the least delay so far says how far the clock is ahead.
        ahead = stamp - arrived
        if stamp < self._last - self._most:
            self.jump = stamp - self._last
        elif ahead > self._ahead + self._most:
            self.jump = ahead - self._ahead
        self._ahead = ahead if np.isinf(self._ahead) else max(self._ahead, ahead)
        self._last = stamp


class Latencies:
    """The last durations of one kind, for their percentiles.

    Args:
        kept: how many.
    """

    def __init__(self, kept: int = 10_000) -> None:
        self._values: deque[float] = deque(maxlen=kept)

    def add(self, seconds: float) -> None:
        """Add a duration."""
        self._values.append(seconds)

    def __len__(self) -> int:
        return len(self._values)

    def percentiles(self) -> tuple[float, float, float]:
        """Return the 50th, 99th and 99.9th percentile, s; NaN without any."""
        if not self._values:
            return float("nan"), float("nan"), float("nan")
        low, high, highest = np.percentile(np.array(self._values), (50.0, 99.0, 99.9)).tolist()
        return low, high, highest

    @property
    def jitter(self) -> float:
        """Difference between the 99th and the 50th percentile, s."""
        low, high, _ = self.percentiles()
        return high - low

    def __str__(self) -> str:
        return "/".join(f"{1e3 * value:.2f}" for value in self.percentiles()) + " ms"
