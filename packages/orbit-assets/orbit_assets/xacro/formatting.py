"""Text made of values: ``str.format``, f-strings and ``%``, without fields that look into objects, and bounded."""

from __future__ import annotations

import re
from string import Formatter
from typing import Any

from orbit_assets.xacro.values import LARGEST, ExpressionError, check_value

_WIDEST = 1000
"""Width and precision of one formatted value."""
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
