"""Symbolic execution of torch's operations on rows of environments, by name, on arrays of scalar expressions."""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, fx
from torch.fx.experimental.proxy_tensor import make_fx
from torch.fx.node import map_arg

# Expression graphs of the arithmetic of one environment, with common subexpressions shared and zeros removed.

Number = float | bool


@dataclass(frozen=True, eq=False, slots=True)
class Expression:
    """One number: a constant, an element of a row of inputs, or an operation on others.

    The same operation on the same numbers is the same object, as a :class:`Builder` makes them.
    """

    builder: Builder
    """Builder that made it, and that keeps equal ones one object."""
    operation: str
    """Name of the operation; ``constant`` and ``element`` have no operands."""
    operands: tuple[Expression, ...] = ()
    """Numbers that it is computed from."""
    value: Number = 0.0
    """Value of a constant."""
    place: tuple[str, int] = ("", 0)
    """Name of the row and index in it, of an element."""
    is_bool: bool = False
    """True for a truth value."""
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


Numbers = npt.NDArray[np.object_]


def _array(builder: Builder, value: Any) -> Numbers:
    """Return a tensor's expressions, or a Python number as an array of one."""
    if isinstance(value, np.ndarray):
        return value
    result = np.empty((), dtype=object)
    # ``np.array`` would try to iterate the value.
    result[()] = value if isinstance(value, Expression) else builder.constant(value)
    return result


def _elementwise(function: Callable[..., Expression]) -> Callable[..., Numbers]:
    """Apply a function element by element, with torch's rules of broadcasting, which are numpy's."""

    def apply(builder: Builder, *operands: Any, **_: Any) -> Numbers:
        arrays = np.broadcast_arrays(*(_array(builder, operand) for operand in operands))
        result = np.empty(arrays[0].shape, dtype=object)
        result.ravel()[:] = [function(builder, *numbers) for numbers in zip(*(a.ravel() for a in arrays), strict=True)]
        return result

    return apply


def _plain(name: str) -> Callable[..., Numbers]:
    return _elementwise(lambda builder, *numbers: builder.apply(name, *map(builder.number, numbers)))


def _logical(name: str) -> Callable[..., Numbers]:
    return _elementwise(lambda builder, *numbers: builder.apply(name, *numbers))


_sum_of_two = _elementwise(lambda builder, a, b: builder.add(builder.number(a), builder.number(b)))
_product = _elementwise(lambda builder, a, b: builder.multiply(a, b))
_negative = _elementwise(lambda builder, a: builder.negative(a))
_inverse = _elementwise(lambda builder, a: builder.apply("reciprocal", a))
_root = _plain("sqrt")
_smaller, _larger = _plain("min"), _plain("max")


def _add(builder: Builder, a: Any, b: Any, alpha: float = 1) -> Numbers:
    return _sum_of_two(builder, a, b if alpha == 1 else _product(builder, b, alpha))


def _subtract(builder: Builder, a: Any, b: Any, alpha: float = 1) -> Numbers:
    return _sum_of_two(builder, a, _product(builder, b, -float(alpha)))


def _divide(builder: Builder, a: Any, b: Any) -> Numbers:
    return _product(builder, a, _inverse(builder, b))


def _power(builder: Builder, a: Numbers, exponent: float) -> Numbers:
    if exponent == 0.5:
        return _root(builder, a)
    if exponent < 0:
        return _inverse(builder, _power(builder, a, -exponent))
    if exponent != int(exponent) or not 1 <= exponent <= 8:
        # Higher powers are rounding-sensitive products that no servo uses.
        raise NotImplementedError(f"a power of {exponent}")
    return functools.reduce(lambda x, y: _product(builder, x, y), [a] * int(exponent))


def _sum(builder: Builder, a: Numbers, dim: Any = None, keepdim: bool = False, **_: Any) -> Numbers:
    return _reduced(lambda row: builder.total([builder.number(x) for x in row]), a, dim, keepdim)


def _reduced(function: Callable[[Sequence[Expression]], Expression], a: Numbers, dim: Any, keepdim: bool) -> Numbers:
    axes = range(a.ndim) if dim is None else [dim] if isinstance(dim, int) else dim
    axes = tuple(sorted(axis % a.ndim for axis in axes))
    kept = [axis for axis in range(a.ndim) if axis not in axes]
    rows = a.transpose([*kept, *axes]).reshape([a.shape[axis] for axis in kept] + [-1])
    result = np.empty(rows.shape[:-1], dtype=object)
    # Short rows first: longer sums are built from them.
    for place in sorted(np.ndindex(result.shape), key=lambda place: sum(not x.constant for x in rows[place])):
        result[place] = function(rows[place].tolist())
    return np.expand_dims(result, axes) if keepdim else result


def _extreme(name: str) -> Callable[..., Numbers]:
    def apply(builder: Builder, a: Numbers, dim: Any = None, keepdim: bool = False) -> Numbers:
        return _reduced(lambda row: functools.reduce(lambda x, y: builder.apply(name, x, y), row), a, dim, keepdim)

    return apply


def _norm(builder: Builder, a: Numbers, ord: float = 2, dim: Any = None, keepdim: bool = False, **_: Any) -> Numbers:
    if ord != 2:
        raise NotImplementedError(f"a norm of order {ord}")
    return _root(builder, _sum(builder, _product(builder, a, a), dim, keepdim))


def _matmul(builder: Builder, a: Numbers, b: Numbers) -> Numbers:
    # All products at once by broadcasting; zeros of sparse matrices vanish in the sum.
    products = _product(builder, a[..., :, :, None], b[..., None, :, :])
    return _sum(builder, products, a.ndim - 1)


def _addmm(builder: Builder, c: Numbers, a: Numbers, b: Numbers, beta: float = 1, alpha: float = 1) -> Numbers:
    product = _product(builder, _matmul(builder, a, b), alpha)
    return _sum_of_two(builder, _product(builder, c, beta), product)


def _cross(builder: Builder, a: Numbers, b: Numbers, dim: int = -1) -> Numbers:
    a, b = np.broadcast_arrays(a, b)
    if dim % a.ndim != a.ndim - 1:
        raise NotImplementedError("a cross product along another than the last axis")
    ahead, behind = [1, 2, 0], [2, 0, 1]
    first = _product(builder, a[..., ahead], b[..., behind])
    return _subtract(builder, first, _product(builder, a[..., behind], b[..., ahead]))


def _clamp(builder: Builder, a: Numbers, low: Any = None, high: Any = None, **given: Any) -> Numbers:
    low, high = given.get("min", low), given.get("max", high)
    a = a if low is None else _larger(builder, a, low)
    return a if high is None else _smaller(builder, a, high)


def _where(builder: Builder, condition: Numbers, a: Any, b: Any) -> Numbers:
    return _elementwise(lambda builder, c, x, y: builder.apply("where", c, x, y))(builder, condition, a, b)


def _sign_of(builder: Builder, size: Any, sign: Any) -> Numbers:
    """Compute ``copysign``; both zeros count as positive."""
    # The expressions have no bits to copy a sign from: a comparison takes their place.
    size = _plain("abs")(builder, size)
    return _where(builder, _plain("lt")(builder, sign, 0.0), _negative(builder, size), size)


def _cholesky(builder: Builder, a: Numbers, **_: Any) -> tuple[Numbers, None]:
    """Compute lower Cholesky factors, column by column; they are not finite if a matrix is not positive definite."""
    if a.ndim > 2:
        parts = [_cholesky(builder, matrix)[0] for matrix in a]
        return np.stack(parts), None
    size = a.shape[-1]
    zero = builder.constant(0.0)
    factors = np.full(a.shape, zero, dtype=object)
    for j in range(size):
        squares = [factors[j, k] * factors[j, k] for k in range(j)]
        factors[j, j] = builder.apply("sqrt", a[j, j] - builder.total(squares) if squares else a[j, j])
        # One division for a column, because a multiplication is several times as fast.
        inverse = builder.apply("reciprocal", factors[j, j])
        for i in range(j + 1, size):
            products = [factors[i, k] * factors[j, k] for k in range(j)]
            factors[i, j] = (a[i, j] - builder.total(products) if products else a[i, j]) * inverse
    return factors, None


def _triangular(
    builder: Builder, a: Numbers, b: Numbers, upper: bool, left: bool = True, unitriangular: bool = False
) -> Numbers:
    if not left or unitriangular:
        raise NotImplementedError("a triangular system from the right")
    if a.ndim > 2:
        return np.stack([_triangular(builder, x, y, upper=upper) for x, y in zip(a, b, strict=True)])
    size = a.shape[-1]
    result = np.empty(b.shape, dtype=object)
    order = range(size - 1, -1, -1) if upper else range(size)
    for place, i in enumerate(order):
        inverse = builder.apply("reciprocal", a[i, i])
        solved = list(order)[:place]
        for column in range(b.shape[1]):
            products = [a[i, k] * result[k, column] for k in solved]
            right = b[i, column]
            result[i, column] = (right - builder.total(products) if products else right) * inverse
    return result


def _slice(
    _: Builder, a: Numbers, dim: int = 0, start: int | None = None, end: int | None = None, step: int = 1
) -> Any:
    places: list[Any] = [slice(None)] * a.ndim
    places[dim % a.ndim] = slice(start, end, step)
    return a[tuple(places)]


def _index(_: Builder, a: Numbers, indices: Sequence[Any]) -> Numbers:
    return a[tuple(slice(None) if index is None else index for index in indices)]


def _split(_: Builder, a: Numbers, sizes: int | Sequence[int], dim: int = 0) -> list[Numbers]:
    length = a.shape[dim]
    # NumPy splits at places, torch by sizes.
    ends = np.cumsum(sizes)[:-1] if not isinstance(sizes, int) else np.arange(sizes, length, sizes)
    return np.split(a, ends, dim)


def _expand(_: Builder, a: Numbers, shape: Sequence[int], **__: Any) -> Numbers:
    ahead = len(shape) - a.ndim  # new dimensions come first, and -1 keeps an old size
    sizes = [a.shape[i - ahead] if size == -1 else size for i, size in enumerate(shape)]
    return np.broadcast_to(a, sizes)


def _squeeze(_: Builder, a: Numbers, dim: Any = None) -> Numbers:
    axes = range(a.ndim) if dim is None else [dim] if isinstance(dim, int) else dim
    return np.squeeze(a, tuple(axis for axis in axes if a.shape[axis] == 1))


def _diag_embed(builder: Builder, a: Numbers, offset: int = 0, dim1: int = -2, dim2: int = -1) -> Numbers:
    if (offset, dim1, dim2) != (0, -2, -1):
        raise NotImplementedError("a diagonal elsewhere than in the last two axes")
    size = a.shape[-1]
    result = np.full((*a.shape, size), builder.constant(0.0), dtype=object)
    result[..., range(size), range(size)] = a
    return result


def _full(builder: Builder, shape: Sequence[int], value: float, dtype: Any = None, **_: Any) -> npt.NDArray[Any]:
    if dtype in (torch.int64, torch.int32):
        return np.full(tuple(shape), int(value))  # indices stay integers
    return np.full(tuple(shape), builder.constant(value), dtype=object)


def _like(value: float | None) -> Callable[..., Numbers]:
    def apply(builder: Builder, a: Numbers, fill: float = 0.0, **_: Any) -> Numbers:
        return _full(builder, a.shape, fill if value is None else value)

    return apply


def _new(value: float | None) -> Callable[..., Numbers]:
    def apply(builder: Builder, a: Numbers, shape: Sequence[int], fill: float = 0.0, **_: Any) -> Numbers:
        return _full(builder, shape, fill if value is None else value)

    return apply


def _eye(builder: Builder, size: int, **_: Any) -> Numbers:
    result = _full(builder, (size, size), 0.0)
    result[range(size), range(size)] = builder.constant(1.0)
    return result


def _argmax(builder: Builder, a: Numbers, dim: int, keepdim: bool = False) -> Numbers:
    """Return the index of the first maximum, as a float."""

    def place(row: Sequence[Expression]) -> Expression:
        best, largest = builder.constant(0.0), row[0]
        for index, other in enumerate(row[1:], 1):
            better = builder.apply("lt", largest, other)
            best = builder.apply("where", better, builder.constant(float(index)), best)
            largest = builder.apply("max", largest, other)
        return best

    return _reduced(place, a, dim, keepdim)


def _gather(builder: Builder, a: Numbers, dim: int, index: Numbers) -> Numbers:
    # The index is an expression too: all elements are compared with it.
    result = np.empty(index.shape, dtype=object)
    for place in np.ndindex(index.shape):
        row = a[tuple(slice(None) if axis == dim % a.ndim else i for axis, i in enumerate(place))]
        found, chosen = row[0], index.item(place)
        for number, other in enumerate(row[1:], 1):
            found = builder.apply("where", builder.apply("eq", chosen, builder.constant(float(number))), other, found)
        result[place] = found
    return result


def _converted(builder: Builder, a: Any, dtype: Any = None, **_: Any) -> Any:
    is_float = dtype is not None and dtype.is_floating_point
    return _elementwise(lambda builder, x: builder.number(x))(builder, a) if is_float else a


def _same(_: Builder, a: Any, *__: Any, **___: Any) -> Any:
    return a


OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": _add,
    "sub": _subtract,
    "rsub": lambda builder, a, b, alpha=1: _subtract(builder, b, a, alpha),
    "mul": _product,
    "div": _divide,
    "neg": _negative,
    "reciprocal": _inverse,
    "sqrt": _root,
    "rsqrt": lambda builder, a: _inverse(builder, _root(builder, a)),
    "square": lambda builder, a: _product(builder, a, a),
    "pow": _power,
    "sin": _plain("sin"),
    "cos": _plain("cos"),
    "atan2": _plain("atan2"),
    "abs": _plain("abs"),
    "minimum": _smaller,
    "maximum": _larger,
    "clamp": _clamp,
    "clamp_min": lambda builder, a, low: _clamp(builder, a, low),
    "clamp_max": lambda builder, a, high: _clamp(builder, a, None, high),
    "copysign": _sign_of,
    "lt": _plain("lt"),
    "le": _plain("le"),
    "gt": lambda builder, a, b: _plain("lt")(builder, b, a),
    "ge": lambda builder, a, b: _plain("le")(builder, b, a),
    "eq": _plain("eq"),
    "ne": lambda builder, a, b: _logical("not")(builder, _plain("eq")(builder, a, b)),
    "logical_and": _logical("and"),
    "logical_or": _logical("or"),
    "logical_not": _logical("not"),
    "bitwise_and": _logical("and"),
    "bitwise_or": _logical("or"),
    "bitwise_not": _logical("not"),
    "where": _where,
    "sum": _sum,
    "amin": _extreme("min"),
    "amax": _extreme("max"),
    "linalg_vector_norm": _norm,
    "norm": lambda builder, a, p=2, dim=None, keepdim=False: _norm(builder, a, p, dim, keepdim),
    "addcmul": lambda builder, a, b, c, value=1: _add(builder, a, _product(builder, b, c), value),
    "mm": _matmul,
    "bmm": _matmul,
    "addmm": _addmm,
    "baddbmm": _addmm,
    "linalg_cross": _cross,
    "linalg_cholesky_ex": _cholesky,
    "linalg_solve_triangular": _triangular,
    "view": lambda _, a, shape: a.reshape(shape),
    "reshape": lambda _, a, shape: a.reshape(shape),
    "_unsafe_view": lambda _, a, shape: a.reshape(shape),
    "expand": _expand,
    "repeat": lambda _, a, repeats: np.tile(a, repeats),
    "permute": lambda _, a, order: a.transpose(order),
    "transpose": lambda _, a, one, other: a.swapaxes(one, other),
    "t": lambda _, a: a.T,
    "unsqueeze": lambda _, a, dim: np.expand_dims(a, dim),
    "squeeze": _squeeze,
    "select": lambda _, a, dim, index: _array(_, a.take(index, dim)),
    "slice": _slice,
    "index": _index,
    "index_select": lambda _, a, dim, index: a.take(index, dim),
    "cat": lambda _, tensors, dim=0: np.concatenate(tensors, dim),
    "stack": lambda _, tensors, dim=0: np.stack(tensors, dim),
    "unbind": lambda _, a, dim=0: list(np.moveaxis(a, dim, 0)),
    "split": _split,
    "split_with_sizes": _split,
    "diagonal": lambda _, a, offset=0, dim1=0, dim2=1: a.diagonal(offset, dim1, dim2),
    "diag_embed": _diag_embed,
    "scalar_tensor": lambda builder, value, **_: _array(builder, value),
    "eye": _eye,
    "full": _full,
    "zeros": lambda builder, shape, **_: _full(builder, shape, 0.0),
    "ones": lambda builder, shape, **_: _full(builder, shape, 1.0),
    "zeros_like": _like(0.0),
    "ones_like": _like(1.0),
    "full_like": _like(None),
    "new_zeros": _new(0.0),
    "new_ones": _new(1.0),
    "new_full": _new(None),
    "argmax": _argmax,
    "gather": _gather,
    "clone": _same,
    "detach": _same,
    "alias": _same,
    "_to_copy": _converted,
    "lift_fresh_copy": _same,
    "getitem": lambda _, parts, index: operator.getitem(parts, index),
}
"""Operations by the name of torch's operation, without its overload."""


"""Expressions in a tensor's shape."""


class Unfusable(Exception):
    """Raised when a function cannot be executed symbolically; says why."""


def expressions(
    function: Callable[..., Sequence[Tensor]], inputs: Sequence[Tensor], rows: Sequence[str], leading: int
) -> list[Numbers]:
    """Execute the function symbolically for one row, and return arrays of scalar expressions, one per output.

    Args:
        function: of tensors (N, ...), or (N, S, ...), whose rows are independent. All other tensors that it uses are
            constants.
        inputs: examples, float or bool; rows hold zeros and ones for bools.
        rows: name of the input buffer of each input, after those before it in the same buffer.
        leading: number of row axes, 1 or 2.

    Raises:
        Unfusable: an operation is unknown, or the rows depend on each other.
    """
    # One row suffices: the function does the same to all.
    examples = [tensor[(slice(1),) * leading].detach().clone() for tensor in inputs]
    builder = Builder()
    try:
        graph = make_fx(function, tracing_mode="real")(*examples)
        made = _followed(builder, graph, _elements(builder, examples, rows))
    except Unfusable:
        raise
    except Exception as error:  # a user's function may raise anything
        what = next(iter(str(error).splitlines()), "")
        raise Unfusable(f"it cannot be followed, for {type(error).__name__}: {what}") from error
    for numbers in made:
        if numbers.shape[:leading] != (1,) * leading:
            raise Unfusable(f"it gives an array {numbers.shape} for one environment")
    return made


def _followed(builder: Builder, graph: fx.GraphModule, given: Sequence[Numbers]) -> list[Numbers]:
    values: dict[fx.Node, Any] = {}
    remaining = iter(given)

    def value_of(argument: Any) -> Any:
        return values[argument] if isinstance(argument, fx.Node) else argument

    for node in graph.graph.nodes:
        if node.op == "placeholder":
            values[node] = next(remaining)
        elif node.op == "get_attr":
            values[node] = constants(builder, getattr(graph, node.target))
        elif node.op == "output":
            return [value_of(argument) for argument in node.args[0]]
        else:
            name = getattr(node.target, "overloadpacket", node.target).__name__
            operation = OPERATIONS.get(name)
            if operation is None:
                raise Unfusable(f"operation '{name}' is not known")
            arguments = map_arg(node.args, lambda argument: values[argument])
            keywords = map_arg(node.kwargs, lambda argument: values[argument])
            values[node] = operation(builder, *arguments, **keywords)
    raise AssertionError("a graph without an output")


def constants(builder: Builder, tensor: Tensor) -> Numbers:
    """Return the numbers of a constant tensor."""
    if tensor.dtype in (torch.int64, torch.int32):
        return tensor.detach().cpu().numpy()  # indices stay integers
    result = np.empty(tuple(tensor.shape), dtype=object)
    result.ravel()[:] = [builder.constant(value) for value in tensor.detach().cpu().reshape(-1).tolist()]
    return result


def _elements(builder: Builder, examples: Sequence[Tensor], rows: Sequence[str]) -> list[Numbers]:
    given: list[Numbers] = []
    lengths = dict.fromkeys(rows, 0)
    zero = builder.constant(0.0)
    for example, row in zip(examples, rows, strict=True):
        numbers = np.empty(tuple(example.shape), dtype=object)
        elements = [builder.element(row, lengths[row] + place) for place in range(example.numel())]
        is_bool = example.dtype is torch.bool
        numbers.ravel()[:] = [builder.apply("lt", zero, x) for x in elements] if is_bool else elements
        lengths[row] += len(elements)
        given.append(numbers)
    return given
