"""History of what was drawn, to look at again."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque

from orbit_viewer.scene_view import Frame

SECONDS = 60.0
"""Simulated seconds that are kept."""


class History:
    """Frames of the last seconds, by the time at which each was drawn."""

    def __init__(self) -> None:
        self._frames: deque[tuple[float, Frame]] = deque()

    def add(self, seconds: float, frame: Frame) -> None:
        """Keep a frame of a simulated time; frames that are too old are forgotten."""
        # A choice of other environments, or a reset, begins another history.
        if self._frames and (seconds < self._frames[-1][0] or not _alike(frame, self._frames[-1][1])):
            self._frames.clear()
        # Copied: engines write poses in place.
        particles = tuple(positions.copy() for positions in frame.particles)
        kept = Frame(frame.link_poses.copy(), frame.marker_poses.copy(), particles, frame.first)
        self._frames.append((seconds, kept))
        while seconds - self._frames[0][0] > SECONDS:
            self._frames.popleft()

    def clear(self) -> None:
        """Forget all frames."""
        self._frames.clear()

    def before(self, seconds: float) -> Frame | None:
        """Return the frame of so many simulated seconds before the last one, or the oldest one; None without any."""
        if not self._frames:
            return None
        wanted = self._frames[-1][0] - seconds
        index = bisect_left([time for time, _ in self._frames], wanted)
        return self._frames[min(index, len(self._frames) - 1)][1]


def _alike(one: Frame, other: Frame) -> bool:
    return one.first == other.first and len(one.link_poses) == len(other.link_poses)
