"""A switch that asks functions of a few numbers for each environment to become kernels in a step that is traced."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_wanted: ContextVar[bool] = ContextVar("kernels wanted", default=False)


@contextmanager
def fusing(wanted: bool) -> Iterator[None]:
    """Ask functions that can be one kernel, such as a servo's law, to be one within this context."""
    token = _wanted.set(wanted)
    try:
        yield
    finally:
        _wanted.reset(token)


def kernels_wanted() -> bool:
    """Return whether :func:`fusing` asks for kernels here."""
    return _wanted.get()
