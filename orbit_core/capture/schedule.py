"""Functions that are captured once for each state of a schedule."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence

from torch import Tensor

from orbit_core.capture.replay import CapturedFunction
from orbit_core.interfaces.capture import Schedule

_Keys = tuple[Hashable, ...]


class ScheduledFunction:
    """Captures operations once for each key of their schedules, and replays what it has captured.

    Args:
        schedules: counters that decide which operations run, and that the operations move on.
        capture: makes a captured function of the operations.
    """

    def __init__(self, schedules: Sequence[Schedule], capture: Callable[[], CapturedFunction]) -> None:
        self._schedules = tuple(schedules)
        self._capture = capture
        self._known: dict[_Keys, tuple[CapturedFunction, _Keys, tuple[int, ...]]] = {}
        """Function of each key, with the key after it and the steps that each schedule counts meanwhile."""
        self.refusal = ""
        """Reason why the operations cannot be repeated without Python; empty as far as they can."""

    @property
    def captured(self) -> int:
        """Number of keys that were captured."""
        return len(self._known)

    @property
    def functions(self) -> tuple[CapturedFunction, ...]:
        """Captured functions, one for each key."""
        return tuple(function for function, _, _ in self._known.values())

    def forget(self) -> None:
        """Capture every key again when it is next met."""
        self._known.clear()

    @property
    def ready(self) -> bool:
        """True if the operations of the present key were captured."""
        return self._key() in self._known

    def __call__(self) -> tuple[Tensor, ...]:
        key = self._key()
        known = self._known.get(key)
        if known is not None:
            function, following, steps = known
            outputs = function()
            for schedule, own, count in zip(self._schedules, following, steps, strict=True):
                schedule.move(own, count)
            return outputs
        before = [schedule.count for schedule in self._schedules]
        function = self._capture()
        outputs = function()
        self.refusal = function.refusal
        if function.replay is not None:
            steps = tuple(schedule.count - old for schedule, old in zip(self._schedules, before, strict=True))
            self._known[key] = function, self._key(), steps
        return outputs

    def _key(self) -> _Keys:
        return tuple([schedule.key for schedule in self._schedules])
