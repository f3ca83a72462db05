"""The process that simulates some of the environments."""

from __future__ import annotations

import contextlib
import pickle
import signal
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from orbit_bullet.buffers import Shapes, shared_buffers
from orbit_bullet.config import BulletConfig
from orbit_bullet.shard import Shard
from orbit_bullet.stage import SceneFiles
from orbit_core.interfaces import SceneLayout


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


@dataclass(frozen=True)
class Failure:
    """An exception of the worker's, for the process that asked."""

    error: Exception
    """Exception, raised again in the process that asked."""


def work(connection: Connection) -> None:
    """Take an assignment, build its shard, then do what is asked until the connection closes.

    While it builds, it sends how many environments each world has, and at the end None, or what went wrong.

    A request is a method's name, its arguments and whether a reply is awaited; an error of a call without reply comes
    with the next reply.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupted program closes the connection
    try:
        assignment = connection.recv()
        shard, failure = _build(assignment, connection.send), None
        connection.send(None)
    except Exception as error:
        with contextlib.suppress(OSError):  # the process that started it may have ended
            connection.send(Failure(_portable(error)))
        return
    while True:
        try:
            method, arguments, reply = connection.recv()
        except (EOFError, OSError):
            break
        result: Any = None
        try:
            if method:
                result = getattr(shard, method)(*arguments)
        except Exception as error:
            failure = failure or Failure(_portable(error))
        if reply:
            try:
                connection.send(failure or result)
            except OSError:  # who asked has ended in the meantime
                break
            failure = None
    shard.close()


def _build(assignment: Assignment, built: Callable[[int], None]) -> Shard:
    buffers = shared_buffers(assignment.shapes, assignment.memory)
    rows = buffers.rows(assignment.start, assignment.stop)
    return Shard(assignment.layout, assignment.files, rows, assignment.config, built)


def _portable(error: Exception) -> Exception:
    """An exception that survives the way through a pipe."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error
