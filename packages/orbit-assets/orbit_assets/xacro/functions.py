"""Functions, constants and methods that expressions of xacro files may use: those of xacro that compute values."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
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
    check_power,
    check_value,
    format_text,
    format_value,
    is_namespace,
    items_of,
    known,
    methods_of,
    percent_text,
)

# Evaluator of the expressions in xacro files --------------------------------------------------------------------------
# Expressions are written in Python's grammar, and Python does not run them: a syntax tree is walked whose nodes,
# operators, functions and methods are all listed here. Values are
# numbers, text, lists, tuples, sets and dictionaries of these. An attribute is an entry of a namespace or dictionary,
# or one of the listed methods; it is never an attribute of a Python object. Results are bounded in size.

# Most characters of one expression.
_LONGEST = 20_000
_ARITHMETIC: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
}
_SIGNS: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
    ast.Invert: operator.invert,
}
_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda item, container: item in container,
    ast.NotIn: lambda item, container: item not in container,
}
# Types that ``+`` joins and ``*`` repeats.
_JOINED = (str, list, tuple)


def evaluate(text: str, names: Mapping[str, Any]) -> Any:
    """Return the value of an expression.

    Args:
        text: the expression.
        names: the values of names: properties, functions and namespaces.

    Raises:
        ExpressionError: the expression uses what is not allowed, or asks for a value that is too large.
        Exception: a function or operator rejects its arguments, as in Python: ``ZeroDivisionError``, ``KeyError``.
    """
    text = text.strip()
    if len(text) > _LONGEST:
        raise ExpressionError(f"an expression has {len(text)} characters: give at most {_LONGEST}")
    return _Scope(names).value(ast.parse(text, mode="eval").body)


@dataclass(frozen=True)
class _Scope:
    """Names that an expression sees: those of the file, and over them the variables of comprehensions and lambdas."""

    names: Mapping[str, Any]
    local: Mapping[str, Any] | None = None

    def value(self, node: ast.expr) -> Any:
        """Return the value of a node, which is no namespace."""
        value = self._any(node)
        if is_namespace(value):
            raise ExpressionError(f"'{ast.unparse(node)}' is a namespace: name one of its entries")
        return value

    def _any(self, node: ast.expr) -> Any:
        handler = _NODES.get(type(node))
        if handler is None:
            raise ExpressionError(f"{type(node).__name__} is not allowed in expressions")
        return handler(self, node)

    def _constant(self, node: ast.Constant) -> Any:
        return check_value(node.value)

    def _name(self, node: ast.Name) -> Any:
        if self.local is not None and node.id in self.local:
            return self.local[node.id]
        try:
            return known(self.names[node.id], node.id)
        except KeyError:
            raise NameError(f"name '{node.id}' is not defined") from None

    def _attribute(self, node: ast.Attribute) -> Any:
        owner = self._any(node.value)
        methods = methods_of(owner)
        if node.attr in methods:
            return methods[node.attr].bound(owner)
        # xacro allows a dot for the entries of dictionaries, such as those of YAML files.
        if isinstance(owner, dict):
            try:
                return known(owner[node.attr], node.attr)
            except KeyError:
                raise NameError(f"'{ast.unparse(node.value)}' has no entry '{node.attr}'") from None
        listed = f"it has {', '.join(methods)}" if methods else "it has none"
        raise ExpressionError(f"'{node.attr}' is no method of {type(owner).__name__} in expressions: {listed}")

    def _subscript(self, node: ast.Subscript) -> Any:
        owner = self._any(node.value)
        if isinstance(node.slice, ast.Slice):
            ends = (node.slice.lower, node.slice.upper, node.slice.step)
            index: Any = slice(*(None if end is None else self.value(end) for end in ends))
        else:
            index = self.value(node.slice)
        if not isinstance(owner, dict | str | list | tuple):
            raise TypeError(f"'{ast.unparse(node.value)}' is {type(owner).__name__}, which has no items")
        return known(owner[index], str(index))

    def _binary(self, node: ast.BinOp) -> Any:
        return self._combined(type(node.op), self.value(node.left), self.value(node.right))

    def _combined(self, kind: type[ast.operator], left: Any, right: Any) -> Any:
        # All nodes, operators and types are looked up in tables: what is not listed does not exist.
        if kind not in _ARITHMETIC:
            raise ExpressionError(f"operator {kind.__name__} is not allowed in expressions")
        if type(left) in NUMBERS and type(right) in NUMBERS:
            # Before the computation: 9**9**9 would take all memory.
            if kind in (ast.Pow, ast.LShift):
                check_power(left, right, shift=kind is ast.LShift)
            return check_integer(_ARITHMETIC[kind](left, right))
        if kind is ast.Mod and type(left) is str:
            return percent_text(left, right)
        if kind is ast.Add and type(left) is type(right) and type(left) in _JOINED:
            return check_value(left + right)
        if kind is ast.Mult:
            sequence, count = (right, left) if type(left) in (int, bool) else (left, right)
            if type(sequence) in _JOINED and type(count) in (int, bool):
                if len(sequence) * count > LARGEST:
                    raise ExpressionError(f"{len(sequence)} items times {count} is more than {LARGEST}")
                return check_value(sequence * count)
        if kind in (ast.Sub, ast.BitAnd, ast.BitOr, ast.BitXor) and type(left) is type(right) is set:
            return check_value(_ARITHMETIC[kind](left, right))
        raise TypeError(f"{kind.__name__} of {type(left).__name__} and {type(right).__name__}")

    def _unary(self, node: ast.UnaryOp) -> Any:
        value = self.value(node.operand)
        if isinstance(node.op, ast.Not):
            return not value
        if type(value) not in NUMBERS:
            raise TypeError(f"a sign before {type(value).__name__}")
        return _SIGNS[type(node.op)](value)

    def _boolean(self, node: ast.BoolOp) -> Any:
        # Stops at the first value that decides, as Python does, and returns the value itself.
        value: Any = None
        for part in node.values:
            value = self.value(part)
            if bool(value) is isinstance(node.op, ast.Or):
                break
        return value

    def _compare(self, node: ast.Compare) -> bool:
        left = self.value(node.left)
        for kind, part in zip(node.ops, node.comparators, strict=True):
            right = self.value(part)  # once, although it is compared to both neighbours
            if not _COMPARISONS[type(kind)](left, right):
                return False
            left = right
        return True

    def _conditional(self, node: ast.IfExp) -> Any:
        return self.value(node.body if self.value(node.test) else node.orelse)

    def _list(self, node: ast.List) -> Any:
        return check_value(self._items(node.elts))

    def _tuple(self, node: ast.Tuple) -> Any:
        return check_value(tuple(self._items(node.elts)))

    def _set(self, node: ast.Set) -> Any:
        return check_value(set(self._items(node.elts)))

    def _dict(self, node: ast.Dict) -> Any:
        made: dict[Any, Any] = {}
        for key, value in zip(node.keys, node.values, strict=True):
            if key is None:
                made |= dict(self.value(value))
            else:
                made[self.value(key)] = self.value(value)
        return check_value(made)

    def _items(self, nodes: list[ast.expr]) -> list[Any]:
        """Return the values of nodes, those after a star one by one."""
        made: list[Any] = []
        for node in nodes:
            if isinstance(node, ast.Starred):
                made += items_of(self.value(node.value))
            else:
                made.append(self.value(node))
            _check_count(made)  # in the loop, before a long list takes the memory
        return made

    def _call(self, node: ast.Call) -> Any:
        function = self.value(node.func)
        # Only functions that this package offers are of that type, so that no other object can be called.
        if not isinstance(function, Function):
            raise TypeError(f"'{ast.unparse(node.func)}' is no function")
        arguments = self._items(node.args)
        options: dict[str, Any] = {}
        for keyword in node.keywords:
            value = self.value(keyword.value)
            options |= {keyword.arg: value} if keyword.arg is not None else dict(value)
        return function(*arguments, **options)

    def _lambda(self, node: ast.Lambda) -> Function:
        spec = node.args
        if spec.posonlyargs or spec.kwonlyargs or spec.vararg or spec.kwarg or spec.defaults:
            raise ExpressionError("a lambda takes plain parameters only")
        parameters = [each.arg for each in spec.args]

        def call(*values: Any) -> Any:
            given = dict(zip(parameters, values, strict=True))
            return _Scope(self.names, {**(self.local or {}), **given}).value(node.body)

        return Function("lambda", call)

    def _comprehension(self, node: ast.ListComp | ast.SetComp | ast.GeneratorExp) -> Any:
        made: list[Any] = []
        for scope in self._loop(node.generators):
            made.append(scope.value(node.elt))
            _check_count(made)
        return check_value(set(made) if isinstance(node, ast.SetComp) else made)

    def _dict_comprehension(self, node: ast.DictComp) -> Any:
        made: dict[Any, Any] = {}
        for scope in self._loop(node.generators):
            made[scope.value(node.key)] = scope.value(node.value)
            _check_count(made)
        return check_value(made)

    def _loop(self, generators: list[ast.comprehension]) -> Iterator[_Scope]:
        """Yield the scopes in which a comprehension's element is evaluated."""
        if not generators:
            yield self
            return
        first, *others = generators
        for item in items_of(self.value(first.iter)):
            scope = _Scope(self.names, {**(self.local or {}), **_assigned(first.target, item)})
            if all(scope.value(condition) for condition in first.ifs):
                yield from scope._loop(others)

    def _joined(self, node: ast.JoinedStr) -> str:
        return check_value("".join(self.value(part) for part in node.values))

    def _formatted(self, node: ast.FormattedValue) -> str:
        spec = "" if node.format_spec is None else self.value(node.format_spec)
        conversion = chr(node.conversion) if node.conversion >= 0 else None
        return format_value(self.value(node.value), spec, conversion)


def _check_count(made: list[Any] | dict[Any, Any]) -> None:
    if len(made) > LARGEST:
        raise ExpressionError(f"an expression makes more than {LARGEST} items")


def _assigned(target: ast.expr, value: Any) -> dict[str, Any]:
    """Return the names that a comprehension's target assigns to a value."""
    if isinstance(target, ast.Name):
        return {target.id: value}
    if not isinstance(target, ast.Tuple | ast.List):
        raise ExpressionError("a comprehension assigns to names only")
    made: dict[str, Any] = {}
    for part, item in zip(target.elts, items_of(value), strict=True):
        made |= _assigned(part, item)
    return made


_NODES: dict[type[ast.expr], Callable[[_Scope, Any], Any]] = {
    ast.Constant: _Scope._constant,
    ast.Name: _Scope._name,
    ast.Attribute: _Scope._attribute,
    ast.Subscript: _Scope._subscript,
    ast.BinOp: _Scope._binary,
    ast.UnaryOp: _Scope._unary,
    ast.BoolOp: _Scope._boolean,
    ast.Compare: _Scope._compare,
    ast.IfExp: _Scope._conditional,
    ast.List: _Scope._list,
    ast.Tuple: _Scope._tuple,
    ast.Set: _Scope._set,
    ast.Dict: _Scope._dict,
    ast.Call: _Scope._call,
    ast.Lambda: _Scope._lambda,
    ast.ListComp: _Scope._comprehension,
    ast.SetComp: _Scope._comprehension,
    ast.GeneratorExp: _Scope._comprehension,
    ast.DictComp: _Scope._dict_comprehension,
    ast.JoinedStr: _Scope._joined,
    ast.FormattedValue: _Scope._formatted,
}


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
