"""Gymnasium's spaces of an environment's observation and action."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces

from orbit_core.envs.environment import Environment
from orbit_core.envs.observation_layout import GroupLayout, TermLayout

_DTYPES: Mapping[torch.dtype, type[np.generic]] = {
    torch.float32: np.float32, torch.uint8: np.uint8, torch.int32: np.int32, torch.int64: np.int64,
    torch.bool: np.bool_,
}  # fmt: skip


def observation_space(environment: Environment) -> spaces.Dict:
    """Return the space of observations of one environment: a box or a dictionary of boxes for each group."""
    return _ordered({name: group_space(layout) for name, layout in environment.observation.items()})


def group_space(layout: GroupLayout) -> spaces.Space[Any]:
    """Return the space of one observation group, with its terms' dtypes and bounds."""
    if not layout.concatenated:
        return _ordered({name: _term_space(term) for name, term in layout.terms.items()})
    # One box over all terms, with each term's bounds repeated for its components.
    low, high = (
        np.concatenate([np.full(term.shape, getattr(term, side), np.float32) for term in layout.terms.values()])
        for side in ("low", "high")
    )
    return spaces.Box(low, high, dtype=np.float32)


def critic_space(environment: Environment) -> spaces.Space[Any] | None:
    """Return the space of the observation group ``critic``; None if the task has none."""
    layout = environment.observation.get("critic")
    return None if layout is None else group_space(layout)


def action_space(environment: Environment) -> spaces.Space[Any]:
    """Return the space of actions of one environment: components in [-1, 1]."""
    return spaces.Box(-1.0, 1.0, (environment.action_size,), np.float32)


def _ordered(boxes: Mapping[str, spaces.Space[Any]]) -> spaces.Dict:
    """Return a dictionary of boxes in the order of an observation: Gymnasium sorts plain dictionaries by name."""
    return spaces.Dict(OrderedDict(boxes))


def _term_space(term: TermLayout) -> spaces.Box:
    dtype: Any = _DTYPES[term.dtype]  # bounds of this type: Gymnasium warns of others
    return spaces.Box(dtype(term.low), dtype(term.high), term.shape, dtype)
