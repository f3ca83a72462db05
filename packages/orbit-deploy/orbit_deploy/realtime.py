"""Loop at a fixed rate on an ordinary kernel: priority, locked memory, and how exactly its cycles kept their time."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

# Real-time priority: above ordinary processes, below the kernel's own threads
_PRIORITY = 50
_ALL_MEMORY = 3  # MCL_CURRENT | MCL_FUTURE
# A thread that holds Python's lock gives it up after this many seconds; the default of 5 ms is five cycles
_SWITCH = 1e-4
# Cycles that are caught up one after another before the loop gives them up and begins a new time base
_MOST_BEHIND = 50
# Cycles whose lateness is kept: ten minutes at 1000 Hz
_KEPT = 600_000


@contextmanager
def prioritized(inherited: bool = True) -> Iterator[list[str]]:
    """Give this thread real-time priority and lock the process's memory, until the block ends.

    Args:
        inherited: threads and processes that are made within the block get the priority too. A robot's computer enters
            before it makes sockets, as the threads of ZeroMQ's context need it; a process that spins with it takes a
            core from everybody.

    Yields:
        A sentence about each of these that the system does not allow; timing is then as good as an ordinary process's.
    """
    missing: list[str] = []
    before = None
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        policy = os.SCHED_FIFO | (0 if inherited else os.SCHED_RESET_ON_FORK)
        os.sched_setscheduler(0, policy, os.sched_param(_PRIORITY))
    except (AttributeError, OSError) as error:
        before = None
        missing.append(f"no real-time priority: {error}")
    try:
        system = ctypes.CDLL(None, use_errno=True)
        if system.mlockall(_ALL_MEMORY) != 0:
            missing.append(f"memory is not locked: {os.strerror(ctypes.get_errno())}")
    except (AttributeError, OSError) as error:
        system = None
        missing.append(f"memory is not locked: {error}")
    try:
        yield missing
    finally:
        # A program that goes on, such as a session of tests, must not keep the cores from others.
        if before is not None:
            os.sched_setscheduler(0, *before)
        if system is not None:
            system.munlockall()


@dataclass(frozen=True)
class CycleTimes:
    """Lateness of a loop's cycles."""

    cycles: int
    """Number of cycles that were measured."""
    within_half_ms: float
    """Share of cycles that began within 0.5 ms of their time, in [0, 1]."""
    percentiles: tuple[float, float, float]
    """50th, 99th and 99.9th percentile of the lateness, s."""
    worst: float
    """s"""
    work: tuple[float, float]
    """50th and 99.9th percentile of a cycle's work, s."""
    skipped: int
    """Cycles that were given up because the loop was more than 50 of them behind."""

    def __str__(self) -> str:
        late = "/".join(f"{1e6 * value:.0f}" for value in self.percentiles)
        work = "/".join(f"{1e6 * value:.0f}" for value in self.work)
        return (
            f"{self.cycles} cycles, {100.0 * self.within_half_ms:.2f} % within 0.5 ms of their time; lateness {late} "
            f"us (p50/p99/p99.9), at most {1e3 * self.worst:.1f} ms; work {work} us (p50/p99.9); {self.skipped} skipped"
        )


class RealtimeLoop:
    """Calls a function at a fixed rate. Late cycles are caught up, so that the path keeps its samples.

    Args:
        rate: Hz.
    """

    def __init__(self, rate: float) -> None:
        self._period = 1.0 / rate
        self._late = np.zeros(_KEPT, np.float32)
        self._work = np.zeros(_KEPT, np.float32)
        self._cycles = 0
        self.skipped = 0
        """Cycles that were given up."""

    def run(self, cycle: Callable[[], None], going: Callable[[], bool]) -> None:
        """Call ``cycle`` until ``going`` returns False.

        The garbage collector is off meanwhile: a pass over ORBIT's objects takes tens of milliseconds.
        """
        # What is alive now stays alive: a frozen generation is not traversed when collection is on again.
        collecting, switching = gc.isenabled(), sys.getswitchinterval()
        gc.collect()
        gc.freeze()
        gc.disable()
        sys.setswitchinterval(_SWITCH)
        try:
            self._run(cycle, going)
        finally:
            sys.setswitchinterval(switching)
            gc.unfreeze()
            if collecting:
                gc.enable()

    def _run(self, cycle: Callable[[], None], going: Callable[[], bool]) -> None:
        clock, sleep, period = time.perf_counter, time.sleep, self._period
        due = clock() + period
        while going():
            now = clock()
            # Spinning for the last 150 us would be exact to 1 us, and take the core from the client on a small machine.
            if now < due:
                sleep(due - now)
                now = clock()
            if now - due > _MOST_BEHIND * period:
                behind = int((now - due) / period)
                self.skipped += behind
                due += behind * period
            cycle()
            place = self._cycles % _KEPT
            self._late[place], self._work[place] = now - due, clock() - now
            self._cycles += 1
            due += period

    @property
    def times(self) -> CycleTimes:
        """Lateness of the cycles, up to the last ten minutes at 1000 Hz."""
        kept = min(self._cycles, _KEPT)
        if not kept:
            return CycleTimes(0, 1.0, (0.0, 0.0, 0.0), 0.0, (0.0, 0.0), self.skipped)
        late, work = self._late[:kept].astype(np.float64), self._work[:kept].astype(np.float64)
        low, high, highest = np.percentile(late, (50.0, 99.0, 99.9)).tolist()
        busy, busiest = np.percentile(work, (50.0, 99.9)).tolist()
        within = float((late <= 5e-4).mean())
        return CycleTimes(self._cycles, within, (low, high, highest), float(late.max()), (busy, busiest), self.skipped)
