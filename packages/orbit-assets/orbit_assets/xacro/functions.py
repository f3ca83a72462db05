"""Functions, constants and methods that expressions of xacro files may use: those of xacro that compute values."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

from orbit_assets.xacro.values import (
    DATA,
    LARGEST,
    METHODS,
    NUMBERS,
    ExpressionError,
    Function,
    Namespace,
    check_integer,
    format_text,
    items_of,
)

# Functions of ``math`` whose results are no larger than their arguments; factorials and products are not.
# Listed one by one, for a version of Python may add functions with larger results.
_MATH = (
    "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "ceil", "copysign", "cos", "cosh", "degrees",
    "dist", "erf", "erfc", "exp", "exp2", "expm1", "fabs", "floor", "fmod", "frexp", "fsum", "gamma", "gcd", "hypot",
    "isclose", "isfinite", "isinf", "isnan", "isqrt", "ldexp", "lgamma", "log", "log10", "log1p", "log2", "modf",
    "nextafter", "pow", "radians", "remainder", "sin", "sinh", "sqrt", "tan", "tanh", "trunc", "ulp",
)  # fmt: skip
_CONSTANTS = ("e", "inf", "nan", "pi", "tau")
# Functions of the namespace ``python`` that xacro has without the namespace too, in addition to ``_GLOBAL``.
_DEPRECATED = ("sorted", "range")
_GLOBAL = ("list", "dict", "map", "len", "str", "float", "int", "bool", "True", "False", "min", "max", "round")
# Most digits to round to: a float has no more.
_DIGITS = 400


def global_symbols(xacro: Namespace) -> Namespace:
    """Return the names that every xacro file sees.

    Args:
        xacro: the namespace ``xacro``, whose functions know the file.
    """
    return Namespace(
        {name: _PYTHON[name] for name in (*_GLOBAL, *_DEPRECATED)}
        | _NUMERIC
        | {name: xacro[name] for name in ("load_yaml", "abs_filename", "dotify")}
        | {"python": _PYTHON, "math": _NUMERIC, "xacro": xacro}
    )


def launch_symbols() -> Namespace:
    """Return the names of ``$(eval ...)``, which has those of roslaunch."""
    names = {name: _PYTHON[name] for name in ("list", "dict", "map", "str", "float", "int", "True", "False")}
    return Namespace(names | _NUMERIC | {"true": True, "false": False})


def tokenize(text: Any, sep: Any = ",; ", skip_empty: Any = True) -> list[str]:
    """Return the parts of text between separators, each of which is one character."""
    parts = re.split(f"[{re.escape(_text(sep))}]", _text(text))
    return [part for part in parts if part or not skip_empty]


def _checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a function of numbers, or of lists of numbers, so that it rejects all other arguments."""

    def call(*arguments: Any, **options: Any) -> Any:
        for value in (*arguments, *options.values()):
            if any(type(each) not in NUMBERS for each in (value if type(value) in (list, tuple) else [value])):
                raise TypeError("a number is expected")
        return function(*arguments, **options)

    return call


def _text(value: Any) -> str:
    if type(value) is not str:
        raise TypeError(f"text is expected, not {type(value).__name__}")
    return value


def _called(function: Any) -> Callable[..., Any]:
    if not isinstance(function, Function):
        raise TypeError(f"a function is expected, not {type(function).__name__}")
    return function


def _key(options: dict[str, Any]) -> dict[str, Any]:
    """Check options of functions that compare: ``key`` must be a function of expressions."""
    if options.get("key") is not None:
        _called(options["key"])
    return options


def _range(*ends: int) -> list[int]:
    for end in ends:
        if type(end) not in (int, bool):
            raise TypeError("range takes integers")
    # Slicing a range allocates nothing.
    numbers = range(*ends)
    if numbers[LARGEST:]:
        raise ExpressionError(f"range makes more than {LARGEST} numbers")
    return list(numbers)


def _round(number: Any, digits: Any = None) -> Any:
    if type(number) not in NUMBERS:
        raise TypeError("round takes a number")
    if digits is not None and abs(digits) > _DIGITS:
        raise ExpressionError(f"round is given {digits} digits: give at most {_DIGITS}")
    return round(number, digits)


def _sum(values: Any, start: Any = 0) -> Any:
    total = start
    for value in items_of(values):
        if type(value) not in NUMBERS or type(total) not in NUMBERS:
            raise TypeError("sum takes numbers")
        total = check_integer(total + value)
    return total


def _dict(pairs: Any = (), **options: Any) -> dict[Any, Any]:
    return dict(pairs if type(pairs) is dict else [tuple(items_of(pair)) for pair in items_of(pairs)], **options)


# Types are passed as functions of expressions, never as Python's classes.
def _isinstance(value: Any, kinds: Any) -> bool:
    accepted = [each.kind for each in (kinds if type(kinds) is tuple else (kinds,)) if isinstance(each, Function)]
    if not accepted or None in accepted:
        raise TypeError("isinstance takes types such as python.str")
    return isinstance(value, tuple(each for each in accepted if each is not None))


def _type(value: Any) -> Any:
    return next((each for each in _KINDS if each.kind is type(value)), type(value).__name__)


def _replace(text: str, old: Any, new: Any, count: Any = -1) -> str:
    times = text.count(_text(old))
    if len(text) + times * len(_text(new)) > LARGEST:
        raise ExpressionError(f"replace makes more than {LARGEST} characters")
    return text.replace(old, new, count)


def _join(text: str, parts: Any) -> str:
    listed = [_text(part) for part in items_of(parts)]
    if sum(map(len, listed)) + len(text) * len(listed) > LARGEST:
        raise ExpressionError(f"join makes more than {LARGEST} characters")
    return text.join(listed)


def _padded(method: Callable[..., str]) -> Callable[..., str]:
    def call(text: str, width: Any, *fill: Any) -> str:
        if width > LARGEST:
            raise ExpressionError(f"{method.__name__} is given the width {width}: give at most {LARGEST}")
        return method(text, width, *fill)

    return call


def _made(kind: type, make: Callable[..., Any] | None = None) -> Function:
    return Function(kind.__name__, make or (lambda *values: kind(*map(_datum, values))), kind)


def _datum(value: Any) -> Any:
    if type(value) not in DATA:
        raise TypeError(f"a value is expected, not {value!r}")
    return value


def _listed(kind: type) -> Function:
    return _made(kind, lambda values=(): kind(items_of(values)))


def _mapped(function: Any, *values: Any) -> list[Any]:
    called = _called(function)
    return [called(*each) for each in zip(*map(items_of, values), strict=False)]


def _filtered(function: Any, values: Any) -> list[Any]:
    return [each for each in items_of(values) if (each if function is None else _called(function)(each))]


_KINDS = (
    _made(bool), _made(int), _made(float), _made(str), _listed(list), _listed(tuple), _listed(set), _made(dict, _dict),
)  # fmt: skip
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "abs": _checked(abs),
    "all": lambda values: all(items_of(values)),
    "any": lambda values: any(items_of(values)),
    "divmod": _checked(divmod),
    "enumerate": lambda values, start=0: [(start + index, each) for index, each in enumerate(items_of(values))],
    "filter": _filtered,
    "frozenset": lambda values=(): set(items_of(values)),
    "isinstance": _isinstance,
    "len": lambda values: len(items_of(values)),
    "map": _mapped,
    "max": lambda *values, **options: max(*values, **_key(options)),
    "min": lambda *values, **options: min(*values, **_key(options)),
    "ord": lambda text: ord(_text(text)),
    "range": _range,
    "repr": lambda value: repr(_datum(value)),
    "reversed": lambda values: items_of(values)[::-1],
    "round": _round,
    "sorted": lambda values, **options: sorted(items_of(values), **_key(options)),
    "sum": _sum,
    "type": _type,
    "zip": lambda *values: list(zip(*map(items_of, values), strict=False)),
}
_PYTHON = Namespace(
    {kind.name: kind for kind in _KINDS}
    | {name: Function(name, function) for name, function in _FUNCTIONS.items()}
    | {"True": True, "False": False}
)
_NUMERIC = Namespace(
    {name: Function(name, _checked(getattr(math, name))) for name in _MATH if hasattr(math, name)}
    | {name: getattr(math, name) for name in _CONSTANTS}
)
# Methods of text whose results are no larger than their arguments.
_PLAIN = (
    "capitalize", "count", "endswith", "find", "index", "isalnum", "isalpha", "isdecimal", "isdigit", "islower",
    "isnumeric", "isspace", "isupper", "lower", "lstrip", "partition", "removeprefix", "removesuffix", "rfind",
    "rindex", "rpartition", "rsplit", "rstrip", "split", "splitlines", "startswith", "strip", "swapcase", "title",
    "upper",
)  # fmt: skip
_TEXT: dict[str, Callable[..., Any]] = {name: getattr(str, name) for name in _PLAIN} | {
    name: _padded(getattr(str, name)) for name in ("center", "ljust", "rjust", "zfill")
}
METHODS |= {
    str: {
        name: Function(name, method)
        for name, method in (
            _TEXT
            | {
                "format": lambda text, *values, **options: format_text(text, values, options),
                "join": _join,
                "replace": _replace,
            }
        ).items()
    },
    list: {name: Function(name, getattr(list, name)) for name in ("count", "index")},
    tuple: {name: Function(name, getattr(tuple, name)) for name in ("count", "index")},
    dict: {
        "get": Function("get", lambda owner, key, default=None: owner.get(key, default)),
        "items": Function("items", lambda owner: list(owner.items())),
        "keys": Function("keys", lambda owner: list(owner)),
        "values": Function("values", lambda owner: list(owner.values())),
    },
}
