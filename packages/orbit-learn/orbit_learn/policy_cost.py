"""Limits of a policy's computation, checked before it is carried out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, Protocol, runtime_checkable

from torch import Tensor, nn

# Limit of the numbers of one environment between observation and action, over all layers.
_MOST_NUMBERS = 2**26
# Limit of the multiplications for an action of one environment; kept policies of pictures take a thousandth.
_MOST_OPERATIONS = 2**35


@runtime_checkable
class Watched(Protocol):
    """Module that reports the shape of each result, and the number of multiplications for each of its numbers."""

    watch: Callable[[Sequence[int], int], None] | None
    """Function that is given each result's shape and multiplications for a number; None: nobody counts."""


@contextmanager
def limited(module: nn.Module) -> Iterator[None]:
    """Stop a module before it computes more than any robot's policy does.

    Args:
        module: convolutions and linear layers, or :class:`Watched`.

    Raises:
        RuntimeError: a limit would be exceeded.
    """
    numbers = operations = 0

    def add(shape: Sequence[int], depth: int) -> None:
        nonlocal numbers, operations
        size = 1
        for extent in shape[1:]:
            size *= extent
        numbers, operations = numbers + size, operations + size * depth
        if numbers > _MOST_NUMBERS:
            raise RuntimeError(f"it has more than {_MOST_NUMBERS:,} numbers between observation and action")
        if operations > _MOST_OPERATIONS:
            raise RuntimeError(f"it takes more than {_MOST_OPERATIONS:,} multiplications an action")

    # Only convolutions can compute far more numbers than they have weights. Linear layers cannot: weights of a file
    # are limited by its size.
    def before(layer: nn.Conv2d, inputs: tuple[Any, ...]) -> None:
        (picture,) = inputs
        sides = zip(picture.shape[2:], layer.kernel_size, layer.stride, layer.padding, strict=True)
        shape = [(side + 2 * int(padding) - kernel) // stride + 1 for side, kernel, stride, padding in sides]
        add((len(picture), layer.out_channels, *shape), layer.weight[0].numel())

    with ExitStack() as stack:
        if isinstance(module, Watched):
            module.watch = add
            stack.callback(setattr, module, "watch", None)
        for layer in module.modules():
            if isinstance(layer, nn.Conv2d):
                stack.callback(layer.register_forward_pre_hook(before).remove)
        yield


def depth_of(product: bool, first: Tensor | None, transposed: bool) -> int:
    """Return the number of multiplications for each number of a result.

    Args:
        product: whether the operation is a product of matrices.
        first: first factor.
        transposed: whether the first factor is transposed.
    """
    return first.shape[0 if transposed else -1] if product and first is not None and first.dim() else 1
