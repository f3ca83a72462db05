"""Expression graphs of the arithmetic of one environment, with common subexpressions shared and zeros removed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

Number = float | bool


@dataclass(frozen=True, eq=False, slots=True)
class Expression:
    """One number: a constant, an element of a row of inputs, or an operation on others.

    The same operation on the same numbers is the same object, as a :class:`Builder` makes them.
    """

    builder: Builder
    operation: str
    operands: tuple[Expression, ...] = ()
    value: Number = 0.0
    """Value of a constant."""
    place: tuple[str, int] = ("", 0)
    """Name of the row and index in it, of an element."""
    is_bool: bool = False
    number: int = 0
    """Number of expressions that were created before it."""

    @property
    def constant(self) -> bool:
        """True if the value is known and the same in all environments."""
        return self.operation == "constant"

    def __add__(self, other: Expression) -> Expression:
        return self.builder.add(self, other)

    def __sub__(self, other: Expression) -> Expression:
        return self.builder.add(self, -other)

    def __mul__(self, other: Expression) -> Expression:
        return self.builder.multiply(self, other)

    def __neg__(self) -> Expression:
        return self.builder.negative(self)


FOLDED: dict[str, Callable[..., Number]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "neg": lambda a: -a,
    "reciprocal": lambda a: 1.0 / a if a else math.inf,
    "sqrt": math.sqrt,
    "sin": math.sin,
    "cos": math.cos,
    "atan2": math.atan2,
    "abs": lambda a: abs(a),
    "min": lambda a, b: min(a, b),
    "max": lambda a, b: max(a, b),
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "eq": lambda a, b: a == b,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
    "where": lambda c, a, b: a if c else b,
}
"""All operations, for constant operands."""
_BOOLEAN = {"lt", "le", "eq", "and", "or", "not"}


class Builder:
    """Factory of expressions, simplified by signs, zeros, ones and constants."""

    def __init__(self) -> None:
        self._known: dict[tuple[object, ...], Expression] = {}
        self._sums: dict[tuple[Expression, ...], Expression] = {}

    def constant(self, value: Number) -> Expression:
        """Return a known number; a bool stays one."""
        if isinstance(value, bool):
            return self._made("constant", value=value, is_bool=True)
        # Adding 0.0 turns -0.0 into 0.0, which would be another constant.
        return self._made("constant", value=float(value) + 0.0)

    def element(self, row: str, place: int) -> Expression:
        """Return the scalar input at index ``place`` of input buffer ``row``."""
        return self._made("element", place=(row, place))

    def apply(self, operation: str, *operands: Expression) -> Expression:
        """Return an operation of :data:`FOLDED`."""
        if all(operand.constant for operand in operands):
            return self.constant(FOLDED[operation](*(operand.value for operand in operands)))
        if operation == "where":
            condition, first, second = operands
            if condition.constant:
                return first if condition.value else second
            if first is second:
                return first
        return self._made(operation, operands, is_bool=operation in _BOOLEAN)

    def number(self, value: Expression) -> Expression:
        """Return a bool as zero or one."""
        return self.apply("where", value, self.constant(1.0), self.constant(0.0)) if value.is_bool else value

    def add(self, a: Expression, b: Expression) -> Expression:
        """Return ``a + b``."""
        if _is(a, 0.0):
            return b
        if _is(b, 0.0):
            return a
        if b.operation == "neg":
            return self._subtracted(a, b.operands[0])
        if a.operation == "neg":
            return self._subtracted(b, a.operands[0])
        return self.apply("add", *self._ordered(a, b))

    def total(self, numbers: Sequence[Expression]) -> Expression:
        """Return a sum as a balanced tree of short dependency chains, extending a known sum where one is a part of it.

        So sums along a robot's branch, each of which has one link more than another, cost one addition each.
        """
        parts = tuple(number for number in numbers if not _is(number, 0.0)) or (self.constant(0.0),)
        if parts in self._sums:
            return self._sums[parts]
        # The longest known part first: it saves the most additions.
        for length in range(len(parts) - 1, 1, -1):
            for known, rest in ((parts[:length], parts[length:]), (parts[-length:], parts[:-length])):
                if known in self._sums:
                    return self._sums.setdefault(parts, self._sums[known] + self._balanced(rest))
        return self._sums.setdefault(parts, self._balanced(parts))

    @staticmethod
    def _balanced(numbers: Sequence[Expression]) -> Expression:
        parts = list(numbers)
        while len(parts) > 1:
            pairs = [a + b for a, b in zip(parts[::2], parts[1::2], strict=False)]
            parts = pairs + parts[len(pairs) * 2 :]
        return parts[0]

    def multiply(self, a: Expression, b: Expression) -> Expression:
        """Return ``a b``; zero times anything is zero."""
        a, b = self.number(a), self.number(b)
        for one, other in ((a, b), (b, a)):
            if _is(one, 0.0):
                return one
            if _is(one, 1.0):
                return other
            if _is(one, -1.0):
                return self.negative(other)
            if one.operation == "neg":
                return self.negative(self.multiply(one.operands[0], other))
            # Signs move outwards, so that a product with 2 and one with -2 share their factors.
            if one.constant and isinstance(one.value, float) and one.value < 0.0:
                return self.negative(self.multiply(self.constant(-one.value), other))
        return self.apply("mul", *self._ordered(a, b))

    def negative(self, a: Expression) -> Expression:
        """Return ``-a``."""
        if a.operation == "neg":
            return a.operands[0]
        if a.operation == "sub":
            return self._subtracted(a.operands[1], a.operands[0])
        return self.apply("neg", a)

    def _subtracted(self, a: Expression, b: Expression) -> Expression:
        if a is b:  # equal expressions are one object
            return self.constant(0.0)
        return self.negative(b) if _is(a, 0.0) else self.apply("sub", a, b)

    @staticmethod
    def _ordered(a: Expression, b: Expression) -> tuple[Expression, Expression]:
        """Order the operands of a commutative operation, equally in every run, so that compiled kernels are found
        again.
        """
        return (a, b) if a.number <= b.number else (b, a)

    def _made(
        self,
        operation: str,
        operands: tuple[Expression, ...] = (),
        value: Number = 0.0,
        place: tuple[str, int] = ("", 0),
        is_bool: bool = False,
    ) -> Expression:
        # Identity of operands is equality: each expression exists once.
        key = (operation, *map(id, operands), value, place, is_bool)
        found = self._known.get(key)
        if found is None:
            found = Expression(self, operation, operands, value, place, is_bool, len(self._known))
            self._known[key] = found
        return found


def _is(expression: Expression, value: float) -> bool:
    return expression.constant and not expression.is_bool and expression.value == value
