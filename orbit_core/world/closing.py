"""What was closed says so, at every later use, and costs nothing while it is open."""

from __future__ import annotations

import functools
import inspect
from typing import Any, NoReturn

from orbit_core.interfaces import ClosedError

_STAY = frozenset({"close", "close_extras", "closed", "unwrapped"})
"""What may be used of a closed thing: closing it again, and what Gymnasium asks to find out whether it is closed."""


_MARK = "_was_closed"


def close_for_good(thing: object, what: str) -> None:
    """From now on every public method and property of ``thing`` raises, but ``close``; plain attributes can be read.

    The object becomes one of a class of its own, so that nothing is asked at each call before.

    Args:
        thing: an object of a class without slots.
        what: it is, as users know it, for the message.
    """
    if not hasattr(thing, _MARK):
        thing.__class__ = _closed_class(type(thing), what)


@functools.cache
def _closed_class(kind: type, what: str) -> Any:
    def refuse(self: object) -> NoReturn:
        raise ClosedError(f"{what} is closed: make another")

    names = [name for name in dir(kind) if not name.startswith("_") and name not in _STAY]
    refusals = {name: property(refuse) for name in names if _is_use(inspect.getattr_static(kind, name))}
    return type(kind.__name__, (kind,), {**refusals, _MARK: True, "__module__": kind.__module__})


def _is_use(member: object) -> bool:
    """Whether a class's member is a method or a property, and no plain value."""
    return inspect.isroutine(member) or isinstance(member, property | functools.cached_property)
