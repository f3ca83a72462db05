"""Errors of parsers and of arithmetic as :class:`AssetError`, with the file and the element that caused them.

An argument of the caller is checked before, for it is no fault of the file.
"""

from __future__ import annotations

import functools
import inspect
import os
import typing
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar

from orbit_core.configuration import TypeChecker
from orbit_core.interfaces.errors import ArgumentError, AssetError, OrbitError

# Most characters of a message; parsers quote whole files.
_LONGEST = 1000

_CHECKER = TypeChecker()

_P = ParamSpec("_P")
_R = TypeVar("_R")


@contextmanager
def naming(place: str) -> Iterator[None]:
    """Turn errors raised within into one :class:`AssetError` of one line that names ``place``.

    An :class:`AssetError` that names the place already passes as it is. Nested uses name the outer place first.

    Raises:
        AssetError: any exception was raised within, except for those that end the process.
    """
    try:
        yield
    except OrbitError as error:
        text = str(error)
        if isinstance(error, AssetError) and place in text and "\n" not in text:
            raise
        said = one_line(text)
        raise AssetError(said if place in said else f"{place}: {said}") from error
    # Parsers and arithmetic raise errors of any class; each is a fault of the file.
    except Exception as error:
        cause = one_line(f"{type(error).__name__}: {error}" if str(error) else type(error).__name__)
        raise AssetError(f"{place} cannot be read ({cause}): correct the file or export it again") from error


def names_file(read: Callable[Concatenate[Path | str, _P], _R]) -> Callable[Concatenate[Path | str, _P], _R]:
    """Make a reader name the file, its first argument, in all errors (:func:`naming`), but for those of arguments.

    The reader raises ArgumentError where an argument is not of the type that it is annotated with.
    """
    signature = inspect.signature(read)

    @functools.wraps(read)
    def named(path: Path | str, *args: _P.args, **kwargs: _P.kwargs) -> _R:
        if not isinstance(path, str | os.PathLike):
            raise ArgumentError(f"path is {path!r}: give the path of a file")
        given = signature.bind(path, *args, **kwargs).arguments
        # Arguments are checked outside of ``naming``: a wrong one is no fault of the file.
        for name, value in given.items():
            _CHECKER.check_value(value, _hints(read)[name], name)
        with naming(str(path)):
            return read(path, *args, **kwargs)

    return named


# Annotations are strings and may name types that are imported later: they are resolved at the first call.
@functools.cache
def _hints(read: Callable[..., object]) -> dict[str, typing.Any]:
    return typing.get_type_hints(read)


def one_line(text: str) -> str:
    """Join a message to one line, cut where it quotes too much."""
    joined = " ".join(text.split())
    return joined if len(joined) <= _LONGEST else f"{joined[:_LONGEST]} ..."
