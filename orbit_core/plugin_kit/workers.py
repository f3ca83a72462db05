"""Worker processes that each hold some of the environments: started, called, and ended with the program.

A worker is this interpreter, spawned, and imports what the object that it holds needs and nothing of the user's script.
A call is a few hundred bytes through a pipe; large arrays belong into memory that the processes share
(:mod:`orbit_core.plugin_kit.shared_arrays`).
"""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import os
import pickle
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol

from orbit_core.interfaces import SimulationError

# Seconds that workers have to end by themselves, all together.
_PATIENCE = 5.0
# Seconds between two looks of a worker whether the program is still there.
_WATCH = 1.0

Range = tuple[int, int]
"""First environment, and one past the last."""


class Maker(Protocol):
    """Builder of the object that a worker holds, which is sent to the worker by pickle."""

    def __call__(self, report: Callable[[int], None], /) -> Any:
        """Build the object; ``report`` tells the program that some more environments are built."""
        ...


def worker_count(asked: int, most: int, paying: int) -> int:
    """Return the number of processes for a setting ``workers``.

    Args:
        asked: the setting; 0 for one per core where it pays.
        most: number of parts that the environments can be divided into.
        paying: number of processes beyond which each would have too little to do.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(asked or min(cores, paying), most))


def split_evenly(count: int, parts: int, unit: int = 1) -> list[Range]:
    """Return ranges of nearly equal length, each but the last a multiple of ``unit`` long."""
    units = -(-count // unit)
    bounds = [min(count, unit * round(units * part / parts)) for part in range(parts + 1)]
    return list(itertools.pairwise(bounds))


@dataclass(frozen=True)
class Failure:
    """An exception of a worker's, for the process that asked."""

    error: Exception
    """Exception, raised again in the process that asked."""


class Workers:
    """Processes that each hold one object, and call its methods as they are told.

    A worker that dies is one error, which names it, its environments and the cause; the others are ended. They end too
    when the program closes them, forgets them, or is killed.
    """

    def __init__(self, ranges: Sequence[Range], makers: Sequence[Maker], built: Callable[[int], None]) -> None:
        """Start a process for each maker and wait for all objects.

        Args:
            ranges: the environments of each process, for messages.
            makers: builders of their objects.
            built: called with a number of environments whenever a worker has built some more.

        Raises:
            Exception: whatever the first maker that failed raised.
        """
        self._ranges = tuple(ranges)
        self._processes: list[Any] = []
        self._connections: list[Any] = []
        self._polls: list[select.poll] = []
        self._posted: set[int] = set()
        # Replies that are not read yet: more than none at a new call where an interrupt cut the last one short.
        self._due = [0] * len(ranges)
        self._dead = ""
        try:
            # In a separate thread: an exception that a signal raises here would cut a start short, and the
            # worker would complain of half a message.
            with ThreadPoolExecutor(1) as starter:
                starter.submit(self._start).result()
            for number, maker in enumerate(makers):
                self._send(number, pickle.dumps(maker))
            self._await_build(built)
        except BaseException:
            self.close()
            raise

    def _start(self) -> None:
        """Start all of them; each then waits for its maker, which is too long for the pipe that starts it."""
        context = multiprocessing.get_context("spawn")
        with _hidden_main(), _interrupts_held():
            for _ in self._ranges:
                ours, theirs = context.Pipe()
                process = context.Process(target=_work, args=(theirs, os.getpid()), daemon=True)
                process.start()
                theirs.close()
                self._processes.append(process)
                self._connections.append(ours)
                poll = select.poll()
                for source in (ours.fileno(), process.sentinel):
                    poll.register(source, select.POLLIN)
                self._polls.append(poll)

    def _await_build(self, built: Callable[[int], None]) -> None:
        """Count what the workers build until all of them are done."""
        building = dict(zip(self._connections, range(len(self._connections)), strict=True))
        while building:
            for connection in wait(list(building)):
                message = self._receive(building[connection])
                if isinstance(message, Failure):
                    raise message.error
                if message is None:
                    del building[connection]
                else:
                    built(message)

    @property
    def pids(self) -> list[int]:
        """Process numbers of the workers."""
        return [process.pid for process in self._processes]

    def call(self, method: str, *arguments: Any, numbers: Sequence[int] | None = None) -> list[Any]:
        """Call a method in some processes, all of them if None, and wait for the results."""
        return _raised(self.gather(method, *arguments, numbers=numbers))

    def gather(self, method: str, *arguments: Any, numbers: Sequence[int] | None = None) -> list[Any]:
        """Call a method as :meth:`call` does; where it raised, the result is a :class:`Failure`."""
        numbers = range(len(self._ranges)) if numbers is None else numbers
        request = pickle.dumps((method, arguments, True))
        for number in numbers:
            self._ask(number, request)
        return self._results(numbers)

    def call_each(self, method: str, arguments: Mapping[int, tuple[Any, ...]]) -> list[Any]:
        """Call a method in processes by number, each with its own arguments, and wait for the results."""
        for number, own in arguments.items():
            self._ask(number, pickle.dumps((method, own, True)))
        return _raised(self._results(list(arguments)))

    def post(self, number: int, method: str, *arguments: Any) -> None:
        """Call a method in one process, ahead of later calls, without waiting; an error comes with the next result."""
        self._send(number, pickle.dumps((method, arguments, False)))
        self._posted.add(number)

    def settle(self) -> None:
        """Wait for what was posted."""
        if self._posted:
            self.call("", numbers=sorted(self._posted))

    def _ask(self, number: int, request: bytes) -> None:
        while self._due[number]:
            self._reply(number)
        self._send(number, request)
        self._due[number] += 1

    def _reply(self, number: int) -> Any:
        reply = self._receive(number)
        self._due[number] -= 1
        return reply

    def _results(self, numbers: Sequence[int]) -> list[Any]:
        self._posted.difference_update(numbers)
        # All of them ahead of the first error: a reply that is left in a pipe would be taken for the next one.
        return [self._reply(number) for number in numbers]

    def _send(self, number: int, message: bytes) -> None:
        if self._dead:
            raise SimulationError(self._dead)
        try:
            self._connections[number].send_bytes(message)
        except (BrokenPipeError, ConnectionResetError):
            self._mourn(number)

    def _receive(self, number: int) -> Any:
        connection = self._connections[number]
        # The process is watched as well as the pipe: one that was forked from the worker could hold the pipe open.
        # A poll that is made once takes 2 microseconds, where multiprocessing's own ``wait`` takes 40.
        ready = [source for source, _ in self._polls[number].poll()]
        if connection.fileno() in ready:
            with contextlib.suppress(EOFError, ConnectionResetError):
                return pickle.loads(connection.recv_bytes())
        return self._mourn(number)

    def _mourn(self, number: int) -> Any:
        process = self._processes[number]
        process.join(_PATIENCE)
        start, stop = self._ranges[number]
        self._dead = (
            f"the worker process {process.pid} of environments {start} to {stop - 1} died, {_cause(process.exitcode)}: "
            "the world is closed, make another"
        )
        self.close()
        raise SimulationError(self._dead)

    def close(self) -> None:
        """End all processes; idempotent."""
        self._dead = self._dead or "the world is closed: make another"
        for connection in self._connections:
            connection.close()
        end = time.monotonic() + _PATIENCE
        for process in self._processes:
            process.join(max(0.0, end - time.monotonic()))
            if process.is_alive():
                process.kill()
                process.join()
        self._connections.clear()
        self._polls.clear()


def _raised(results: list[Any]) -> list[Any]:
    """Return the results, or raise the first failure."""
    for result in results:
        if isinstance(result, Failure):
            raise result.error
    return results


# In the worker --------------------------------------------------------------------------------------------------------


def _work(connection: Connection, owner: int) -> None:
    """Build an object, then call its methods until the connection closes or the program ``owner`` is gone.

    While it builds, it sends how many environments are built, and at the end None, or what went wrong. A request is a
    method's name, its arguments and whether a reply is awaited; an error of a call without reply comes with the next
    reply.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupted program closes the connection
    threading.Thread(target=_watch, args=(owner,), daemon=True).start()
    try:
        maker: Maker = pickle.loads(connection.recv_bytes())
        held, failure = maker(lambda count: connection.send_bytes(pickle.dumps(count))), None
        connection.send_bytes(pickle.dumps(None))
    except Exception as error:
        with contextlib.suppress(OSError):  # the process that started it may have ended
            connection.send_bytes(pickle.dumps(Failure(_portable(error))))
        return
    while True:
        try:
            method, arguments, reply = pickle.loads(connection.recv_bytes())
        except (EOFError, OSError):
            break
        result: Any = None
        try:
            if method:
                result = getattr(held, method)(*arguments)
        except Exception as error:
            failure = failure or Failure(_portable(error))
        if reply:
            try:
                connection.send_bytes(pickle.dumps(failure or result))
            except OSError:  # who asked has ended in the meantime
                break
            failure = None
    held.close()


def _watch(owner: int) -> None:
    """End this process, whatever it is in the midst of, soon after the program was killed.

    The pipe alone does not tell: it is not looked at within a long step, and a process that was forked from the program
    holds its other end. Linux's signal on a parent's death comes when the parent's *thread* ends that started this.
    """
    while os.getppid() == owner:
        time.sleep(_WATCH)
    os._exit(1)


def _portable(error: Exception) -> Exception:
    """Return an exception that survives the way through a pipe."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def _cause(code: int | None) -> str:
    if code is None:
        return "without a word"
    if code < 0:
        name = signal.Signals(-code).name
        return f"killed by {name}" + (", perhaps for want of memory" if name == "SIGKILL" else "")
    return f"with exit code {code}"


# Held while the user's script is hidden, so that each thread puts back what it found.
_hiding = threading.Lock()


@contextlib.contextmanager
def _hidden_main() -> Iterator[None]:
    """Workers need nothing of the user's script, which may lack the guard that its import would call for."""
    main = sys.modules["__main__"]
    with _hiding:
        kept = {name: main.__dict__.pop(name) for name in ("__file__", "__spec__") if name in main.__dict__}
        main.__dict__["__spec__"] = None
        try:
            yield
        finally:
            main.__dict__.update(kept)


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Have workers that start in this thread never get the interrupt key, even while they import."""
    resource_tracker.ensure_running()  # which lets the key through again where it has to be started
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
