"""Figures that a case of the benchmark of Newton's deformables finds, and the time that it may take."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

PHYSICS_STEP, G = 0.005, 9.81
"""Seconds of the conformance scenarios' nominal step, and m/s^2."""


@dataclass(frozen=True)
class Figure:
    """One measured figure; its error is relative to what is true, or the figure itself where nothing else is true.

    A figure without a tolerance tells about the case and is not judged.
    """

    name: str
    found: float
    true: float | None = None
    tolerance: float | None = None
    milliseconds: float = 0.0
    note: str = ""

    @property
    def error(self) -> float | None:
        """Relative error of what was found."""
        return None if self.true is None else self.found / self.true - 1.0

    @property
    def passes(self) -> bool:
        """True if the error is within the tolerance."""
        error = self.found if self.error is None else self.error
        return self.tolerance is not None and abs(error) <= self.tolerance


class OutOfTime(Exception):
    """A case reached its limit of time."""


class Budget:
    """Counts the physics steps of a case, and ends it at its limit.

    Args:
        limit: Seconds, without those until the first step is done, in which kernels are compiled.
        gpu: Whether a GPU simulates; else milliseconds are the processor's own, since machines may be shared.
    """

    def __init__(self, limit: float, *, gpu: bool) -> None:
        self._limit, self._begun, self._work, self._steps = limit, 0.0, 0.0, 0
        self._clock = time.perf_counter if gpu else time.process_time

    @property
    def milliseconds(self) -> float:
        """Mean time of a physics step."""
        spent = self._clock() - self._work
        return 1e3 * spent / self._steps if self._steps else 0.0

    def restart(self) -> None:
        """Begin the count of steps anew, of another simulation of the same case, whose first step is done."""
        self._work, self._steps = self._clock(), 0
        self._begun = self._begun or time.perf_counter()

    def step(self) -> None:
        """Count a physics step.

        Raises:
            OutOfTime: The limit is reached.
        """
        self._steps += 1
        if time.perf_counter() - self._begun > self._limit:
            raise OutOfTime(f"ended by its limit of {self._limit:g} s after {self._steps} physics steps")


@dataclass(frozen=True)
class Case:
    """One set-up at one setting; ``large`` ones are too slow for a CPU."""

    name: str
    run: Callable[[str, Budget], Iterator[Figure]]
    large: bool = False
