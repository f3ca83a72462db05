"""Operations that differ by what is due: captured once for each phase of a schedule."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from orbit_core.capture.replay import CapturedFunction


@dataclass(frozen=True)
class Moment:
    """The place at which a schedule stands. All that Python decides in a step follows from the phase."""

    phase: Hashable
    physics_steps: int
    agent_steps: int


class Schedule(Protocol):
    """Says what is due when, and is moved on where Python did not run."""

    def moment(self) -> Moment:
        """The phase in which the schedule stands now."""
        ...

    def move(self, phase: Hashable, physics_steps: int, agent_steps: int) -> None:
        """Go on by so many steps, into that phase."""
        ...


class PhasedFunction:
    """Captures operations anew in each phase that they are met in, and replays what it knows.

    Args:
        schedule: that the operations follow and move on.
        capture: makes a captured function of them.
    """

    def __init__(self, schedule: Schedule, capture: Callable[[], CapturedFunction]) -> None:
        self._schedule = schedule
        self._capture = capture
        self._known: dict[Hashable, tuple[CapturedFunction, Moment]] = {}
        self.refusal = ""
        """Why the operations cannot be repeated without Python; empty if they can, as far as is known."""

    @property
    def phases(self) -> int:
        """How many were captured."""
        return len(self._known)

    @property
    def functions(self) -> tuple[CapturedFunction, ...]:
        """What was captured, a function for each phase."""
        return tuple(function for function, _ in self._known.values())

    def forget(self) -> None:
        """Capture every phase again when it is next met."""
        self._known.clear()

    @property
    def ready(self) -> bool:
        """Whether the operations are known in the present phase."""
        return self._schedule.moment().phase in self._known

    def __call__(self) -> tuple[Tensor, ...]:
        before = self._schedule.moment()
        known = self._known.get(before.phase)
        if known is not None:
            function, after = known
            outputs = function()
            self._schedule.move(after.phase, after.physics_steps, after.agent_steps)
            return outputs
        function = self._capture()
        outputs = function()
        now = self._schedule.moment()
        steps = now.physics_steps - before.physics_steps, now.agent_steps - before.agent_steps
        self.refusal = function.refusal
        if function.replay is not None:
            self._known[before.phase] = function, Moment(now.phase, *steps)
        return outputs
