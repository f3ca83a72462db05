"""Errors of worlds that were closed, or that a forked process found in its memory."""

from __future__ import annotations

import ctypes
import functools
import inspect
import multiprocessing.process
import os
import weakref
from typing import Any, NoReturn, Protocol

from orbit_core.interfaces import ClosedError

# What may be used of a closed thing: closing it again, what Gymnasium asks to find out whether it is closed, and what a
# forked process does with what it finds
_STAY = frozenset({"close", "close_extras", "closed", "mark_forked", "unwrapped"})
_MARK = "_was_closed"


def mark_closed(thing: object, what: str) -> None:
    """Let every public method and property of ``thing`` raise, but ``close``; plain attributes can be read.

    Args:
        thing: an object of a class without slots.
        what: it is, as users know it, for the message.
    """
    if not hasattr(thing, _MARK):
        thing.__class__ = _closed_class(type(thing), f"{what} is closed: make another")


def mark_forked(thing: object, what: str, parent: int) -> None:
    """The same in a process that was forked from process ``parent``, whose thing it is; closing it does nothing here.

    It is kept until the process is gone, for its destructor might wait for threads that are not here.
    """
    if not hasattr(thing, _MARK):
        why = (
            f"{what} was made by process {parent}, from which this one was forked without its threads and workers: "
            "make worlds after forking, or start processes by multiprocessing's method 'spawn'"
        )
        thing.__class__ = _closed_class(type(thing), why, closes=False)
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(thing))


@functools.cache
def _closed_class(kind: type, why: str, closes: bool = True) -> Any:
    def refuse(self: object) -> NoReturn:
        raise ClosedError(why)

    names = [name for name in dir(kind) if not name.startswith("_") and name not in _STAY]
    members: dict[str, Any] = {name: property(refuse) for name in names if _is_use(inspect.getattr_static(kind, name))}
    if not closes and hasattr(kind, "close"):
        members["close"] = lambda self: None
    return type(kind.__name__, (kind,), {**members, _MARK: True, "__module__": kind.__module__})


def _is_use(member: object) -> bool:
    """Return True if a class's member is a method or a property."""
    return inspect.isroutine(member) or isinstance(member, property | functools.cached_property)


class ForkAware(Protocol):
    """Object that must not be used in forked processes."""

    def mark_forked(self, parent: int) -> None:
        """Refuse every later use."""
        ...


_made: weakref.WeakSet[ForkAware] = weakref.WeakSet()


def register_after_fork(thing: ForkAware) -> None:
    """Call the thing's ``mark_forked`` in every process that is forked from now on."""
    _made.add(thing)


def _leave_all() -> None:
    if _made:  # else this process, when it exits, would end workers that engines have in its parent
        multiprocessing.process._children.clear()  # pyright: ignore[reportAttributeAccessIssue] - nothing public does it
    for thing in list(_made):
        thing.mark_forked(os.getppid())


if hasattr(os, "register_at_fork"):  # other systems do not fork
    os.register_at_fork(after_in_child=_leave_all)
