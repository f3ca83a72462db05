"""Python values that a captured step would freeze: found by walking from the task, its terms and its nodes.

A trace repeats operations on tensors. A counter of plain Python, a list or a random generator of NumPy would keep the
value that it had while the step was traced, so such values are compared before and after a trace, and between steps.
"""

from __future__ import annotations

import dis
import functools
import operator
import random
import sys
import types
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from itertools import chain
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from orbit_core.interfaces import World
from orbit_core.interfaces.capture import Traceable

_PARTS: Final = ("core", "assets", "motion", "learn", "data", "viewer", "conformance")
_OWN: Final = frozenset(f"orbit_{part}" for part in _PARTS)
# Packages whose code is not searched: it keeps no state of a task
_OTHERS: Final = (_OWN | {"torch", "numpy", "builtins"} | sys.stdlib_module_names) - {"__main__"}
_LEAVES: Final = (
    bool,
    int,
    float,
    complex,
    str,
    bytes,
    Tensor,
    Enum,
    type,
    types.ModuleType,
    torch.dtype,
    torch.device,
)
_CONTENTS: Final = operator.attrgetter("cell_contents")
_END: Final = (object(),)
_ABSENT: Final = object()
REMEDY: Final = "keep it in a tensor that is written in place, or give capture=False (--no-capture)"
# Functions that set values up, so that they are not the place where a step changes them
_SET_UP: Final = frozenset({"__init__", "__post_init__", "start"})

Change = tuple["Holder", Any]


class Values:
    """Values that are compared by identity in a few microseconds, without a loop of Python.

    Args:
        whole: dictionaries and lists, all of whose values count.
        places: dictionaries with a key each, whose value there counts.
        cells: closure cells.
    """

    def __init__(
        self,
        whole: Iterable[Any],
        places: Iterable[tuple[Any, str]] = (),
        cells: Iterable[types.CellType] = (),
    ) -> None:
        self._views = [holder if isinstance(holder, list) else holder.values() for holder in whole]
        self._mappings, self._keys = [each[0] for each in places], [each[1] for each in places]
        self._cells = list(cells)
        self._known = list(self._now())

    def unchanged(self) -> bool:
        """Return True if every value is the very object that it was."""
        try:
            # Identity, because comparing values would cost more than the step saves.
            return all(map(operator.is_, self._now(), self._known))
        except (KeyError, ValueError):  # a variable was deleted
            return False

    def _now(self) -> Iterator[Any]:
        return chain(
            map(operator.getitem, self._mappings, self._keys),
            map(_CONTENTS, self._cells),
            chain.from_iterable(self._views),
            _END,  # a value that was added or removed moves it, so that lengths need no look of their own
        )


@dataclass(frozen=True, eq=False)
class _Global:
    """A module's variable that a function reads or writes."""

    variables: dict[str, Any]
    name: str


# Holders that :class:`Values` compares
_COMPARED_AT_ONCE: Final = (dict, list, types.MappingProxyType, types.CellType, _Global)


@dataclass(frozen=True, eq=False)
class Holder:
    """A dictionary, list, set, closure cell or array that holds values, and the values when it was looked at."""

    path: str
    """Expression that leads to the holder, for messages."""
    live: Any
    """Holder itself."""
    known: Any
    """Copy of its values at the time of tracing."""
    owner: Any
    """Object whose attributes the dictionary is; None for other holders."""

    def changes(self) -> Iterator[Any]:
        """Yield the keys whose value is another now; ``""`` where the holder has no keys."""
        now = _content(self.live)
        if isinstance(now, dict) and isinstance(self.known, dict):
            for key in {**self.known, **now}:
                if not _same(self.known.get(key, _ABSENT), now.get(key, _ABSENT)):
                    yield key
        elif not _same(self.known, now):
            yield ""

    def name_of(self, key: Any) -> str:
        """Return the name under which code writes the value."""
        return key if isinstance(key, str) and key else self.path.rpartition(".")[2].partition("[")[0]

    def path_of(self, key: Any) -> str:
        """Return the path of the value, for a message."""
        if self.owner is not None:
            return f"{self.path}.{key}"
        return f"{self.path}[{key!r}]" if key != "" else self.path


class PythonState:
    """Python values that can be reached from some objects: attributes, elements, closures, globals that they use.

    Objects of ORBIT's own classes are left out but for configuration, and so are worlds and engines: they report
    their changes to the tracer.

    Args:
        roots: objects by the name that messages give them.
        configuration: classes of ORBIT's own that are walked all the same.
        skipped: attributes of the roots that are left out.
    """

    def __init__(
        self, roots: Mapping[str, object], configuration: tuple[type, ...] = (), skipped: frozenset[str] = frozenset()
    ) -> None:
        self._configuration = configuration
        self._holders: list[Holder] = []
        self._functions: dict[int, types.FunctionType] = {}
        self._seen: dict[int, object] = {}
        self._waiting: deque[tuple[str, object]] = deque(roots.items())
        self._skipped = {id(getattr(root, name)) for root in roots.values() for name in skipped if hasattr(root, name)}
        while self._waiting:
            self._visit(*self._waiting.popleft())
        self._sort()

    def update(self) -> None:
        """Take the values as they are now."""
        self._holders = [replace(holder, known=_content(holder.live)) for holder in self._holders]
        self._sort()

    def _sort(self) -> None:
        live = [holder.live for holder in self._holders]
        variables = [(each.variables, each.name) for each in live if isinstance(each, _Global)]
        of_classes = [(each, name) for each in live if isinstance(each, types.MappingProxyType) for name in _data(each)]
        cells = [each for each in live if isinstance(each, types.CellType) and _is_filled(each)]
        self._plain = Values([each for each in live if isinstance(each, dict | list)], variables + of_classes, cells)
        self._others = [holder for holder in self._holders if not isinstance(holder.live, _COMPARED_AT_ONCE)]

    def unchanged(self) -> bool:
        """Return True if every value is the very object that it was. Cheap enough for each step: some microseconds."""
        return self._plain.unchanged() and not any(any(True for _ in holder.changes()) for holder in self._others)

    def changes(self) -> list[Change]:
        """Return the holders and keys of the values that are others now."""
        return [(holder, key) for holder in self._holders for key in holder.changes()]

    def describe(self, change: Change) -> str:
        """Return the path of a value that changed, with the file and line that write it."""
        holder, key = change
        place = _written_at(holder.name_of(key), self._functions.values())
        return f"{holder.path_of(key)}{place}"

    def _visit(self, path: str, value: object) -> None:
        if value is None or isinstance(value, _LEAVES) or id(value) in self._seen:
            return
        self._seen[id(value)] = value
        if isinstance(value, types.FunctionType):
            self._visit_function(path, value)
        elif isinstance(value, types.MethodType):
            self._wait((path, value.__self__), (path, value.__func__))
        elif isinstance(value, types.BuiltinMethodType):
            self._wait((path, value.__self__))
        elif isinstance(value, functools.partial):
            self._wait((path, value.func), *_elements(path, value.args), *_elements(path, value.keywords))
        elif isinstance(value, tuple | frozenset):
            self._wait(*_elements(path, value))
        elif isinstance(value, dict | list | set | deque):
            self._hold(path, value)
            self._wait(*_elements(path, value))
        elif isinstance(value, np.ndarray | np.random.Generator | np.random.RandomState | random.Random):
            self._hold(path, value)
        elif self._is_walked(value):
            self._visit_object(path, value)

    def _is_walked(self, value: object) -> bool:
        # Worlds and engines report their changes to the tracer.
        if isinstance(value, World | Traceable):
            return False
        return isinstance(value, self._configuration) or _package(type(value)) not in _OTHERS

    def _visit_object(self, path: str, value: object) -> None:
        own = getattr(value, "__dict__", None)
        if isinstance(own, dict):
            self._hold(path, own, value)
            self._wait(*((f"{path}.{name}", each) for name, each in own.items() if id(each) not in self._skipped))
        for kind in type(value).__mro__:
            if _package(kind) not in _OTHERS and id(kind) not in self._seen:
                self._seen[id(kind)] = kind
                self._hold(kind.__name__, vars(kind), kind)
                for name, each in vars(kind).items():
                    if not (_is_special(name) or isinstance(each, self._configuration)):  # a default is never written
                        self._wait((f"{kind.__name__}.{name}", _plain(each)))

    def _visit_function(self, path: str, function: types.FunctionType) -> None:
        """Hold what a function closes over, its attributes, and the globals that it names."""
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            where = f"{path}, variable '{name}'"
            if _package(function) not in _OTHERS and name != "__class__":
                self._hold(f"{path}.{name}", cell)
            self._wait((where, _content(cell)))
        defaults = function.__defaults__ or ()
        arguments = function.__code__.co_varnames[: function.__code__.co_argcount]
        named = dict(zip(arguments[len(arguments) - len(defaults) :], defaults, strict=True))
        named |= function.__kwdefaults__ or {}
        self._wait(*((f"{path}.{name}", value) for name, value in named.items()))
        if _package(function) in _OTHERS:
            return
        self._hold(path, function.__dict__, function)
        self._wait(*_elements(path, function.__dict__))
        self._functions[id(function)] = function
        names = [name for code in _codes(function.__code__) for name in code.co_names if name in function.__globals__]
        for name in dict.fromkeys(names):
            value = function.__globals__[name]
            where = f"{function.__module__}.{name}"
            if not isinstance(value, types.ModuleType | type | types.FunctionType):
                self._hold(where, _Global(function.__globals__, name))
            elif value is random:
                self._hold(where, value)
            elif value is np.random or (value is np and "random" in names):
                self._hold(where, np.random)
            self._wait((where, value))

    def _hold(self, path: str, live: Any, owner: object = None) -> None:
        self._holders.append(Holder(path, live, _content(live), owner))

    def _wait(self, *objects: tuple[str, object]) -> None:
        self._waiting.extend(objects)


def frozen_by_trace(before: PythonState) -> tuple[str, bool]:
    """Compare the values after a traced step with those before.

    Returns:
        the value that the step changed, with file, line and remedy, empty if none that was set before; and True if a
        value was set for the first time, which a next trace will find.
    """
    changes = before.changes()
    for holder, key in changes:
        known = holder.known.get(key) if isinstance(holder.known, dict) else holder.known
        if known is not None:
            what = before.describe((holder, key))
            if isinstance(known, Tensor):
                return f"{what} is another tensor after each step: write it in place", False
            return f"{what} changes in Python, which a captured step would freeze: {REMEDY}", False
    return "", bool(changes)


def _content(live: Any) -> Any:
    """Return a copy of what a holder holds now."""
    if isinstance(live, dict):
        return dict(live)
    if isinstance(live, types.MappingProxyType):
        return _data(live)
    if isinstance(live, types.CellType):
        return live.cell_contents if _is_filled(live) else None
    if isinstance(live, _Global):
        return live.variables.get(live.name)
    if isinstance(live, np.random.Generator):
        return live.bit_generator.state
    if isinstance(live, np.random.RandomState) or live is np.random:
        return live.get_state(legacy=False)
    if isinstance(live, random.Random) or live is random:
        return live.getstate()
    return live.copy()


def _is_filled(cell: types.CellType) -> bool:
    try:
        cell.cell_contents  # noqa: B018 - an empty cell raises
    except ValueError:
        return False
    return True


def _same(known: Any, now: Any) -> bool:
    """Return True if two values are one object, or equal as plain Python values. A tensor equals itself only."""
    if known is now:
        return True
    if type(known) is not type(now) or isinstance(known, Tensor):
        return False
    if isinstance(known, np.ndarray):
        return np.array_equal(known, now)
    if isinstance(known, list | tuple | deque):
        return len(known) == len(now) and all(map(_same, known, now))
    if isinstance(known, dict):
        return known.keys() == now.keys() and all(_same(value, now[key]) for key, value in known.items())
    return isinstance(known, int | float | str | bytes | complex | set | frozenset) and known == now


def _data(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a class's attributes without its methods."""
    return {n: v for n, v in attributes.items() if not (_is_special(n) or callable(v) or hasattr(v, "__get__"))}


def _is_special(name: str) -> bool:
    """Return True for what Python or dataclasses write into a class."""
    return name.startswith("_abc_") or (name.startswith("__") and name.endswith("__") and name != "__call__")


def _elements(path: str, collection: Any) -> Iterable[tuple[str, object]]:
    if isinstance(collection, dict):
        return [(f"{path}[{key!r}]", value) for key, value in collection.items()]
    return [(f"{path}[{index}]", value) for index, value in enumerate(collection)]


def _plain(member: Any) -> Any:
    """Return the function that a class's attribute wraps, or the attribute."""
    if isinstance(member, staticmethod | classmethod):
        return member.__func__
    return member.fget if isinstance(member, property) else member


def _package(thing: Any) -> str:
    """Return the name of the package that a class or function was written in."""
    code = isinstance(thing, types.FunctionType)  # a wrapper bears the module of what it wraps
    module = thing.__globals__.get("__name__") if code else getattr(thing, "__module__", None)
    return (module or "builtins").partition(".")[0]


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """Yield a function's code and that of the functions within it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _codes(constant)


def _written_at(name: str, functions: Iterable[types.FunctionType]) -> str:
    """Return the file and line that write an attribute or variable, or else name it; empty if no function does."""
    found = [place for function in functions for place in _places(name, function)]
    if not found:
        return ""
    _, file, line = min(found)
    return f" ({file}:{line})"


def _places(name: str, function: types.FunctionType) -> Iterator[tuple[int, str, int]]:
    """Yield rank, file and line of each instruction that names a value; those that write it rank first."""
    for code in _codes(function.__code__):
        line = code.co_firstlineno
        for instruction in dis.get_instructions(code):
            line = instruction.positions.lineno or line if instruction.positions else line
            if instruction.argval == name and isinstance(instruction.argval, str):
                writes = instruction.opname.startswith("STORE")
                rank = (0 if writes else 1) + (2 if function.__name__ in _SET_UP else 0)
                yield rank, code.co_filename, line
