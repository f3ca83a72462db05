"""Layout of observations: groups, their terms, shapes, dtypes and bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.interfaces import ConfigurationError

Observation = dict[str, Tensor | dict[str, Tensor]]
"""Groups by name: one tensor (N, K) where a group is concatenated, else its terms (N, ...) by name."""


@dataclass(frozen=True)
class TermLayout:
    """A term as its group shows it, history included."""

    shape: tuple[int, ...]
    """Shape of one environment's value."""
    dtype: torch.dtype
    low: float
    high: float
    camera: str | None = None
    """Camera whose picture the term is."""


@dataclass(frozen=True)
class GroupLayout:
    """One group of an observation, its terms in order."""

    name: str
    concatenated: bool
    terms: Mapping[str, TermLayout]

    @property
    def size(self) -> int:
        """K, the components of a concatenated group.

        Raises:
            ConfigurationError: the group is a dictionary of its terms.
        """
        if not self.concatenated:
            raise _is_dictionary(self.name, self.terms)
        return sum(math.prod(term.shape) for term in self.terms.values())

    @property
    def columns(self) -> dict[str, slice]:
        """Slice of each term in a concatenated group, by name."""
        columns: dict[str, slice] = {}
        end = 0
        for name, term in self.terms.items():
            begin, end = end, end + math.prod(term.shape)
            columns[name] = slice(begin, end)
        return columns


def one_tensor(observation: Observation, group: str = "policy") -> Tensor:
    """A concatenated group (N, K) of an observation.

    Raises:
        ConfigurationError: the group is a dictionary of its terms.
    """
    value = observation[group]
    if isinstance(value, dict):
        raise _is_dictionary(group, value)
    return value


def leaf_shapes(layouts: Mapping[str, GroupLayout]) -> dict[str, tuple[int, ...]]:
    """Shape of each tensor in one environment's observation, by ``group`` or ``group/term``."""
    shapes: dict[str, tuple[int, ...]] = {}
    for group, layout in layouts.items():
        if layout.concatenated:
            shapes[group] = (layout.size,)
        else:
            shapes |= {f"{group}/{name}": term.shape for name, term in layout.terms.items()}
    return shapes


def leaves_of(observation: Observation) -> list[Tensor]:
    """All tensors, in the order of :func:`leaf_shapes`."""
    leaves: list[Tensor] = []
    for group in observation.values():
        if isinstance(group, dict):
            leaves += group.values()
        else:
            leaves.append(group)
    return leaves


def observation_of(layouts: Mapping[str, GroupLayout], leaves: Sequence[Tensor]) -> Observation:
    """The observation whose tensors, in the order of :func:`leaf_shapes`, are ``leaves``."""
    tensors: Iterator[Tensor] = iter(leaves)
    return {
        group: next(tensors) if layout.concatenated else {name: next(tensors) for name in layout.terms}
        for group, layout in layouts.items()
    }


def map_leaves(function: Callable[[Tensor], Tensor], observation: Observation) -> Observation:
    """The observation with each tensor replaced by what ``function`` gives for it."""
    return {
        name: {term: function(value) for term, value in group.items()} if isinstance(group, dict) else function(group)
        for name, group in observation.items()
    }


def _is_dictionary(group: str, terms: Mapping[str, object]) -> ConfigurationError:
    return ConfigurationError(
        f"observation group '{group}' is a dictionary of its terms ({', '.join(terms)}), where one tensor is needed: "
        "give the group concatenate=True, or take what accepts dictionaries"
    )
