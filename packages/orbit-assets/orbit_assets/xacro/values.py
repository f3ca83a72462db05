"""Values of xacro expressions, the limits on their size, and text formatted from them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from string import Formatter
from typing import Any

from orbit_assets.options import ReadLimits, ReadOptions

# Messages between the reader of a xacro file and the process that expands it ------------------------------------------


@dataclass(frozen=True)
class Order:
    """One file to expand, and what it may use."""

    path: str
    """File to expand."""
    packages: Mapping[str, str]
    """Folders of packages by name."""
    outside: tuple[str, ...]
    """Folders that the caller allows; "/" for any."""
    environment: Mapping[str, str]
    """Variables that ``$(env NAME)`` may read."""
    limits: ReadLimits
    """Largest sizes and counts that a file may have."""
    characters: int
    """Most characters of the URDF."""
    memory: int
    """Bytes of address space of the process."""
    seconds: int
    """Processor time of the process."""

    def encoded(self) -> str:
        """Return the order as JSON."""
        return json.dumps(asdict(self))

    @staticmethod
    def decoded(text: str) -> Order:
        """Return the order that JSON from :meth:`encoded` holds."""
        fields = json.loads(text)
        return Order(**fields | {"outside": tuple(fields["outside"]), "limits": ReadLimits(**fields["limits"])})

    def options(self) -> ReadOptions:
        """Return the options by which files that the model names are found and opened."""
        return ReadOptions(
            packages={name: Path(folder) for name, folder in self.packages.items()},
            allow_outside=True if "/" in self.outside else tuple(map(Path, self.outside)),
            limits=self.limits,
        )


@dataclass(frozen=True)
class Expansion:
    """Result of an order.

    ``unnamed`` lists the variables for which ``$(optenv NAME default)`` gave its default.
    """

    document: str
    """URDF without macros."""
    unnamed: tuple[str, ...]

    def encoded(self) -> str:
        """Return the result as JSON."""
        return json.dumps(asdict(self), ensure_ascii=False)

    @staticmethod
    def decoded(text: str) -> Expansion:
        """Return the result that JSON from :meth:`encoded` holds."""
        fields = json.loads(text)
        return Expansion(fields["document"], tuple(fields["unnamed"]))


LARGEST = 1_000_000
"""Characters and items of one value, those of its parts included."""
# Most bits of an integer: larger ones take long to multiply and print.
_BITS = 4096
NUMBERS = (int, float, bool)
_CONTAINERS = (list, tuple, set, dict)
DATA = (*NUMBERS, str, type(None), *_CONTAINERS)
"""Types of values. They are compared exactly: a subclass could bring code of its own."""


class ExpressionError(Exception):
    """Raised where an expression uses what is not allowed, or asks for a value that is too large."""


class Namespace(dict[str, Any]):
    """Named functions and constants, such as ``math``."""


@dataclass(frozen=True, repr=False)
class Function:
    """Callable of expressions.

    Args:
        name: for messages.
        call: checks its arguments itself, for they may be of any type in :data:`DATA`.
        kind: the type of the values that it makes, if it makes one type, for ``isinstance``.
    """

    name: str
    call: Callable[..., Any]
    kind: type | None = None

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Return the result, which is a value in bounds."""
        return check_value(self.call(*arguments, **options))

    def bound(self, owner: Any) -> Function:
        """Return the method of a value, whose first argument is the value."""
        return Function(self.name, lambda *arguments, **options: self.call(owner, *arguments, **options))

    def __repr__(self) -> str:
        return f"<function {self.name}>"


METHODS: dict[type, Mapping[str, Function]] = {}
"""Methods of values by type; :mod:`orbit_assets.xacro.functions` lists them."""


def methods_of(value: Any) -> Mapping[str, Function]:
    """Return the methods that expressions may call on a value."""
    return METHODS.get(type(value), {})


def is_namespace(value: Any) -> bool:
    """Return True for named functions or properties: a subclass of dict, as xacro's tables are."""
    return isinstance(value, dict) and type(value) is not dict


def known(value: Any, name: str) -> Any:
    """Return the value of a name, if it is a value, a function or a namespace.

    Raises:
        ExpressionError: it is something else, such as an XML element.
    """
    if type(value) in DATA or isinstance(value, Function) or is_namespace(value):
        return value
    raise ExpressionError(f"'{name}' is no value that an expression may use")


def items_of(value: Any) -> list[Any]:
    """Return the items of a container or the characters of text.

    Raises:
        TypeError: the value has none.
    """
    if type(value) not in (str, *_CONTAINERS):
        raise TypeError(f"{type(value).__name__} has no items")
    return list(value)


def check_integer(number: Any) -> Any:
    """Return a number, if it is real and no larger than integers may be.

    Raises:
        ExpressionError: it is complex or too large.
    """
    if type(number) not in NUMBERS:
        raise ExpressionError(f"{type(number).__name__} numbers are not allowed in expressions")
    if type(number) is int and number.bit_length() > _BITS:
        raise ExpressionError(f"an integer has {number.bit_length()} bits: give at most {_BITS}")
    return number


def check_power(base: Any, exponent: Any, *, shift: bool) -> None:
    """Check that a power or a shift to the left stays within :func:`check_integer`, before it is computed.

    Raises:
        ExpressionError: it does not.
    """
    if type(base) is float or type(exponent) is float or exponent <= 0:
        return  # arithmetic of floats has bounds, and shifts to the other side are errors of their own
    bits = exponent + base.bit_length() if shift else exponent * (abs(base) - 1).bit_length()
    if base and bits > _BITS:
        raise ExpressionError(f"a power has some {bits} bits: give at most {_BITS}")


def check_value(value: Any) -> Any:
    """Return a value, if all of it is of known types and it is no larger than values may be.

    Raises:
        ExpressionError: it is not.
    """
    size = 0
    waiting = [value]
    while waiting:
        each = waiting.pop()
        size += 1
        if type(each) in NUMBERS:
            check_integer(each)
        elif type(each) is str:
            size += len(each)
        elif type(each) in _CONTAINERS:
            waiting.extend(each)
            if type(each) is dict:
                waiting.extend(each.values())
        elif each is not None and not isinstance(each, Function):
            raise ExpressionError(f"a value of type {type(each).__name__} is not allowed in expressions")
        if size > LARGEST:
            raise ExpressionError(f"a value has more than {LARGEST} characters and items")
    return value


# Most characters of width and precision of one formatted value.
_WIDEST = 1000
_COUNT = re.compile(r"\d+")
_PERCENT = re.compile(r"%(?:\((?P<name>[^()]*)\))?[#0\- +]*(?P<width>\*|\d*)(?:\.(?P<precision>\*|\d*))?")
_CONVERSIONS = {"r": repr, "s": str, "a": ascii}


def format_value(value: Any, spec: str, conversion: str | None = None) -> str:
    """Return a value as text, as an f-string does.

    Raises:
        ExpressionError: the width or precision is too large.
    """
    _check_widths(_COUNT.findall(spec))
    if conversion:
        value = _CONVERSIONS[conversion](value)
    return format(value, spec)


def format_text(template: str, arguments: tuple[Any, ...], options: dict[str, Any], depth: int = 2) -> str:
    """Return a template filled in as ``str.format`` does, by fields that are plain names or numbers.

    Raises:
        ExpressionError: a field asks for an attribute or an item, or the text is too long.
    """
    if depth == 0:
        raise ExpressionError("a format nests fields too deeply")
    made: list[str] = []
    size = automatic = 0
    for literal, field, spec, conversion in Formatter().parse(template):
        made.append(literal)
        size += len(literal)
        if field is None:
            continue
        if field == "":
            field, automatic = str(automatic), automatic + 1
        if not (field.isdecimal() or field.isidentifier()):
            raise ExpressionError(f"a format has the field '{field}': give plain names and numbers")
        value = arguments[int(field)] if field.isdecimal() else options[field]
        if spec and "{" in spec:
            spec = format_text(spec, arguments, options, depth - 1)
        made.append(format_value(value, spec or "", conversion))
        size += len(made[-1])
        if size > LARGEST:
            raise ExpressionError(f"a formatted text has more than {LARGEST} characters")
    return "".join(made)


def percent_text(template: str, values: Any) -> str:
    """Return a template filled in as ``%`` does.

    Raises:
        ExpressionError: a width or the text is too large.
    """
    fields = list(_PERCENT.finditer(template))
    widths = [width for field in fields for width in field.group("width", "precision") if width]
    if "*" in widths:
        raise ExpressionError("a format takes its width from an argument: write the width out")
    _check_widths(widths)
    check_value(values)
    if type(values) is dict and len(fields) * max(len(str(each)) for each in (*values.values(), "")) > LARGEST:
        raise ExpressionError(f"a formatted text has more than {LARGEST} characters")
    return check_value(template % values)


def _check_widths(widths: list[str]) -> None:
    if any(len(width) > 4 or int(width) > _WIDEST for width in widths):
        raise ExpressionError(f"a format has the width {max(widths, key=len)[:20]}: give at most {_WIDEST}")
