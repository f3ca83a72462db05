"""Expressions of xacro files compute values as Python does, and reach nothing else."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import pytest

from orbit_assets.xacro.functions import evaluate, global_symbols, launch_symbols, tokenize
from orbit_assets.xacro.values import ExpressionError, Function, Namespace

XACRO = Namespace(
    {name: Function(name, lambda *values: "") for name in ("load_yaml", "abs_filename", "dotify")}
    | {"tokenize": Function("tokenize", tokenize)}
)
WHEEL = {"radius": 0.1, "names": ["left", "right"], "limit": {"lower": -2.9, "upper": 2.9}}
NAMES: Mapping[str, Any] = global_symbols(XACRO) | {"x": 3, "side": "left_arm", "on": True, "wheel": WHEEL, "f": [3, 1]}
AS_PYTHON = (
    "x + 1", "x * 2.5 - x / 2", "x ** 2 // 2 % 5", "2 ** -1", "-x", "~x", "1 << 4 | 3 & 1 ^ 2", "not on",
    "on and x or 0",
    "1 < x <= 3 != 4", "'left' in side and 'q' not in side", "None is None and x is not None", "x if on else 0",
    "side + '_link'", "'%s_%03d %.2f%%' % (side, x, 2.5)", "'%(a)s' % dict(a=1)", "f'{side}_{x:>4}_{x!r}'",
    "'{} {}'.format(side, x)", "'{0:.2f} {k:>{w}}'.format(2.5, k='q', w=5)", "side.split('_')[0].upper()",
    "'_'.join([str(i) for i in range(3)])", "side.replace('left', 'right')[::-1]", "'7'.zfill(3) + ' a '.strip()",
    "f[0] + f[-1] + len(f[1:])", "[*f, 4] + f * 2", "(1, 2)[0]", "{i for i in f} == {1, 3}", "{'a': 1, **{'b': 2}}",
    "[(a, b) for a in f for b in range(a) if b]", "{k: v for k, v in {'a': 1}.items()}",
    "list(map(lambda i: i + 1, f))",
    "sorted(f, key=lambda i: -i)", "max(f), min(1, x), round(2.567, 2), round(2.5)", "float('2.5') + int(2.9)",
    "str([1, 2.5, 'a', None, True])", "bool(''), dict([('a', 1)]), dict(a=1)['a']", "0x10 + 1_000 + 1e-3", "[2] == [2]",
    "wheel['limit']['lower']", "wheel.get('width', 5)", "list(wheel.keys())", "'radius' in wheel", "f.index(1)",
    "(lambda a, b: a + b)(1, 2)", "any(f) if False else 1",
)  # fmt: skip


@pytest.mark.parametrize("text", AS_PYTHON)
def test_expressions_are_what_they_are_in_python(text: str) -> None:
    expected = eval(text, {"x": 3, "side": "left_arm", "on": True, "wheel": WHEEL, "f": [3, 1]})
    found = evaluate(text, NAMES)
    assert found == expected
    assert type(found) is type(expected)


def test_namespaces_give_functions_and_dictionaries_give_entries_by_a_dot() -> None:
    assert evaluate("cos(math.pi) + radians(180) + python.abs(-2) + math.hypot(3, 4)", NAMES) == 6.0 + math.pi
    assert evaluate("wheel.limit.upper * wheel.radius", NAMES) == pytest.approx(0.29)
    assert evaluate("wheel.names", NAMES) == ["left", "right"]
    assert evaluate("xacro.tokenize('a b,c') + xacro.tokenize('a_b', sep='_')", NAMES) == ["a", "b", "c", "a", "b"]
    assert evaluate("python.isinstance(side, python.str) and python.type(f) == python.list", NAMES)
    assert evaluate("python.list(python.zip(f, python.reversed('ab')))", NAMES) == [(3, "b"), (1, "a")]
    assert evaluate("python.sum(python.filter(lambda i: i > 1, f))", NAMES) == 3
    assert evaluate("true and sqrt(4)", launch_symbols()) == 2.0


REACHING = (
    "''.__class__", "().__class__.__bases__[0].__subclasses__()", "f.__add__", "math.__dict__", "math.sin.__self__",
    "math.sin.call", "str.kind", "(lambda: 1).__code__", "(i for i in f).gi_frame", "wheel.__class__", "f.append(1)",
    "wheel.update", "1 .real", "'{0.__class__}'.format(1)", "'{0[0]}'.format(f)", "f'{().__class__}'", "str.format",
    "'a'.format_map(wheel)", "'a'.translate(wheel)", "'a'.encode()", "__import__('os')", "open('/etc/passwd')",
    "eval('1')", "globals()", "vars()", "python.vars(math)", "python.type(1).mro()", "getattr(f, 'x')", "print(1)",
    "ｅｖａｌ('1')", "''.__ｃlass__", "(y := 1)", "(yield)", "(await f)", "1j", "b''", "...", "math", "str(math)",
    "[python]",
    "math == math", "(-8) ** 0.5", "element", "element.parentNode", "[element]", "str(element)", "wheel[element]",
    "sorted(f, key=math)", "map(str.join, f)", "[element for element.x in f]", "[0 for f[0] in f]", "lambda *a: a",
    "math.factorial(5)", "math.comb(5, 2)", "python.hash(1)", "python.complex(1)", "python.slice(1)", "f @ f",
    "side * f",
)  # fmt: skip


@pytest.mark.parametrize("text", REACHING)
def test_expressions_reach_no_python_object(text: str) -> None:
    with pytest.raises((ExpressionError, NameError, TypeError)):
        evaluate(text, {**NAMES, "element": object()})


HUGE = (
    "10 ** 10 ** 10", "9 ** 9 ** 9", "(10 ** 1000) ** 1000", "1 << 10 ** 9", "(1 << 4000) * (1 << 4000)",
    "'a' * 10 ** 9", "10 ** 9 * [0]", "'a' * 999999 * 999999", "['a' * 999999] * 999999", "'a' * 999999 + 'a' * 999999",
    "range(10 ** 30)", "[[0] * 999 for a in range(2000)]", "[*range(600000), *range(600000)]",
    "'%1000000000d' % 1", "'%*d' % (10 ** 9, 1)", "'%.1000000000f' % 1", "('%(a)s' * 9999) % dict(a='x' * 9999)",
    "'{:1000000000}'.format(1)", "'{:{w}}'.format(1, w=10 ** 9)", "('{0}' * 9999).format('x' * 9999)",
    "f'{1:1000000000}'", "f\"{'a':>{10 ** 9}}\"", "'{:{:{}}}'.format(1, 2, 3)", "('x' * 999).join(['y'] * 99999)",
    "('x' * 9999).replace('x', 'y' * 9999)", "('x' * 9999).replace('', 'y' * 9999)", "'a'.zfill(10 ** 9)",
    "'a'.center(10 ** 9, 'b')", "round(5, -10 ** 9)", "int('9' * 99999)", "int('f' * 99999, 16)", "0x" + "f" * 9999,
    "1" + "0" * 2000, "x" * 30_000,
)  # fmt: skip


@pytest.mark.parametrize("text", HUGE)
def test_huge_values_are_refused_before_they_are_made(text: str) -> None:
    started = time.process_time()
    with pytest.raises((ExpressionError, ValueError)):
        evaluate(text, NAMES)
    assert time.process_time() - started < 10.0


NESTED = (
    "(" * 3000 + ")" * 3000,
    "[" * 3000,
    "-" * 9000 + "1",
    "+".join("1" * 9000),
    "x" + ".x" * 9000,
    "f" + "(1)" * 6000,
)


@pytest.mark.parametrize("text", [*NESTED, "(lambda g: g(g))(lambda g: g(g))"], ids=range(len(NESTED) + 1))
def test_expressions_that_nest_without_end_are_refused(text: str) -> None:
    with pytest.raises((ExpressionError, SyntaxError, RecursionError, MemoryError)):
        evaluate(text, NAMES)
