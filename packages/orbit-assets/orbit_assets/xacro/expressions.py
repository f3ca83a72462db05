"""Evaluator of the expressions in xacro files.

Expressions are written in Python's grammar, and Python does not run them: a syntax tree is walked whose nodes,
operators, functions and methods are all listed here and in :mod:`orbit_assets.xacro.functions`. Values are
numbers, text, lists, tuples, sets and dictionaries of these. An attribute is an entry of a namespace or dictionary, or
one of the listed methods; it is never an attribute of a Python object. Results are bounded in size.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from orbit_assets.xacro.values import (
    LARGEST,
    NUMBERS,
    ExpressionError,
    Function,
    check_integer,
    check_power,
    check_value,
    format_value,
    is_namespace,
    items_of,
    known,
    methods_of,
    percent_text,
)

# Most characters of one expression.
_LONGEST = 20_000
_NUMERIC: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
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
        if kind not in _NUMERIC:
            raise ExpressionError(f"operator {kind.__name__} is not allowed in expressions")
        if type(left) in NUMBERS and type(right) in NUMBERS:
            # Before the computation: 9**9**9 would take all memory.
            if kind in (ast.Pow, ast.LShift):
                check_power(left, right, shift=kind is ast.LShift)
            return check_integer(_NUMERIC[kind](left, right))
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
            return check_value(_NUMERIC[kind](left, right))
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
