"""Worker processes of the plugin kit: calls, errors, and an end with the program whatever ends it."""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orbit_core.interfaces import ConfigurationError, SimulationError
from orbit_core.plugin_kit.scratch import ScratchFolder
from orbit_core.plugin_kit.shared_arrays import shared_arrays
from orbit_core.plugin_kit.workers import Failure, Workers, split_evenly, worker_count

SHAPES = {"given": (4, 2), "found": (4, 2)}


class Doubler:
    """Two rows of arrays: what a worker holds."""

    def __init__(self, memory: Path | None, start: int, report: Callable[[int], None]) -> None:
        report(1)
        if start == 99:
            raise ConfigurationError("no such rows")
        if memory is not None:
            self._arrays = {name: array[start : start + 2] for name, array in shared_arrays(SHAPES, memory).items()}
        report(1)

    def double(self, factor: float = 2.0) -> float:
        """Return the sum of what it found."""
        self._arrays["found"][:] = factor * self._arrays["given"]
        return float(self._arrays["found"].sum())

    def refuse(self, who: str) -> None:
        raise ConfigurationError(f"not {who}")

    def wait(self, seconds: float) -> float:
        time.sleep(seconds)
        return seconds

    def close(self) -> None:
        pass


@contextmanager
def two(memory: Path | None = None, starts: tuple[int, int] = (0, 2)) -> Iterator[Workers]:
    makers: list[Any] = [functools.partial(Doubler, memory, start) for start in starts]
    workers = Workers([(0, 2), (2, 4)], makers, lambda count: None)
    try:
        yield workers
    finally:
        workers.close()


def is_running(pid: int) -> bool:
    """Return True if the process exists, be it a zombie."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def ends(pid: int) -> bool:
    """Return True if a process that is no child of this one ends in time."""
    end = time.monotonic() + 20.0
    while is_running(pid) and time.monotonic() < end:
        time.sleep(0.02)
    return not is_running(pid)


def test_ranges_are_whole_units() -> None:
    assert split_evenly(7, 3) == [(0, 2), (2, 5), (5, 7)]
    assert split_evenly(20, 2, unit=8) == [(0, 16), (16, 20)]
    assert split_evenly(5, 1, unit=8) == [(0, 5)]


def test_the_number_of_processes_is_what_is_asked_up_to_the_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(4), raising=False)
    assert [worker_count(asked, 3, 64) for asked in (1, 2, 5)] == [1, 2, 3]
    assert [worker_count(0, 64, paying) for paying in (0, 1, 2, 8)] == [1, 1, 2, 4]


def test_calls_arrays_and_errors() -> None:
    built: list[int] = []
    with ScratchFolder("orbit-test-") as folder:
        arrays = shared_arrays(SHAPES, folder / "state")
        makers: list[Any] = [functools.partial(Doubler, folder / "state", start) for start in (0, 2)]
        workers = Workers([(0, 2), (2, 4)], makers, built.append)
    assert built == [1, 1, 1, 1]
    arrays["given"][:] = np.arange(8.0).reshape(4, 2)
    assert workers.call("double") == [12.0, 44.0]
    np.testing.assert_array_equal(arrays["found"], 2.0 * arrays["given"])
    assert workers.call_each("double", {1: (1.0,)}) == [22.0]
    assert [isinstance(reply, Failure) for reply in workers.gather("refuse", "you")] == [True, True]
    with pytest.raises(ConfigurationError, match="not me"):
        workers.call("refuse", "me", numbers=[1])
    workers.post(0, "refuse", "late")
    with pytest.raises(ConfigurationError, match="not late"):
        workers.settle()
    assert workers.call("double", 0.0) == [0.0, 0.0]
    pids = workers.pids
    workers.close()
    workers.close()
    assert not any(is_running(pid) for pid in pids)
    with pytest.raises(SimulationError, match="closed"):
        workers.call("double")


def test_an_error_while_building_ends_all() -> None:
    with pytest.raises(ConfigurationError, match="no such rows"), two(starts=(0, 99)):
        pass


def test_an_interrupted_call_leaves_no_reply_for_the_next() -> None:
    with two() as workers:
        timer = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT))
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            workers.call("wait", 0.5)
        assert workers.call("wait", 0.0) == [0.0, 0.0]


def test_a_worker_that_dies_within_a_call_is_named() -> None:
    with two() as workers:
        pids = workers.pids
        timer = threading.Timer(0.1, os.kill, (pids[1], signal.SIGKILL))
        timer.start()
        with pytest.raises(SimulationError, match=rf"process {pids[1]} of environments 2 to 3 died, killed by SIGKILL"):
            workers.call("wait", 0.5)
        assert not any(is_running(pid) for pid in pids)


PROGRAM = """
import os, sys, time
sys.path.insert(0, {folder!r})
from test_workers import two
with two() as workers:
    print(*workers.pids, flush=True)
    {end}
"""


@pytest.mark.parametrize(
    "end",
    [
        "workers.call('wait', 60.0)",
        "os.fork() or sys.stdout.close(); time.sleep(30)",  # the forked one holds the pipes open
        "raise RuntimeError('enough')",
    ],
)
def test_workers_end_with_a_program_that_is_killed_or_fails(end: str) -> None:
    code = PROGRAM.format(folder=str(Path(__file__).parent), end=end)
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True
    ) as program:
        assert program.stdout is not None
        pids = [int(word) for word in program.stdout.readline().split()]
        assert len(pids) == 2
        if "raise" not in end:
            time.sleep(0.1)
            program.kill()
        assert all(ends(pid) for pid in pids)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(program.pid, signal.SIGKILL)  # the forked one
