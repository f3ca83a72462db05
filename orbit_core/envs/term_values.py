"""Checks of terms: what reward and termination terms give, weights, and names that must stay."""

from __future__ import annotations

import math
from collections.abc import Collection

from torch import Tensor

from orbit_core.envs.terms import RewardTerm
from orbit_core.interfaces import ConfigurationError, ShapeError


def per_environment(value: object, what: str, num_envs: int) -> Tensor:
    """A term's value, where it is a tensor (N,).

    Args:
        value: that the term's function gave.
        what: the term, for the message.
        num_envs: N.

    Raises:
        ConfigurationError: it is no tensor.
        ShapeError: it has another shape.
    """
    if not isinstance(value, Tensor):
        raise ConfigurationError(f"{what} gives a {type(value).__name__}: its function must return a torch.Tensor")
    if value.shape != (num_envs,):
        raise ShapeError(
            f"{what} has shape {tuple(value.shape)}, but must have ({num_envs},), a value for each environment"
        )
    return value


def weight_of(name: str, term: RewardTerm) -> float:
    """Return a reward term's weight.

    Raises:
        ConfigurationError: it is no finite number; names the term.
    """
    weight = term.weight
    if isinstance(weight, bool) or not isinstance(weight, int | float) or not math.isfinite(weight):
        raise ConfigurationError(f"the weight of reward term '{name}' must be a finite number, not {weight!r}")
    return float(weight)


def check_same_names(kind: str, before: Collection[str], now: Collection[str], remedy: str) -> None:
    """Check that a collection has the terms that it had when the environment was made.

    Raises:
        ConfigurationError: one is missing, or new; names it.
    """
    if missing := [name for name in before if name not in now]:
        raise ConfigurationError(
            f"{kind} term '{missing[0]}' was there when the environment was made, and cannot be switched off now: "
            f"{remedy}"
        )
    if new := [name for name in now if name not in before]:
        raise ConfigurationError(
            f"{kind} term '{new[0]}' was not there when the environment was made: give it to the task before"
        )
