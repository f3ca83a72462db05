"""Gymnasium's spaces of an environment's observation and action."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from gymnasium import spaces

from orbit_core.envs.environment import Environment
from orbit_core.envs.observation_layout import GroupLayout, TermLayout
from orbit_core.interfaces.errors import ConfigurationError

if TYPE_CHECKING:
    from torch import Tensor

    from orbit_core.envs.environment import Environment
    from orbit_core.envs.observation_layout import Observation


# Observation groups of actor and critic, and the libraries that support them ------------------------------------------

ACTOR = "policy"
CRITIC = "critic"
# Libraries whose adapters here build encoders of pictures, and those that give the critic its own observation.
_TAKE_PICTURES = ("rsl-rl", "sb3", "skrl", "torchrl", "distill")
_TAKE_CRITICS = ("rsl-rl", "rl-games", "skrl", "torchrl", "orbit")


def critic_group(environment: Environment) -> str:
    """Return the group that a critic sees: ``critic`` if the task has one, else ``policy``."""
    return CRITIC if CRITIC in environment.observation else ACTOR


def check_groups(environment: Environment, library: str) -> None:
    """Refuse observation groups that a library does not support.

    Raises:
        ConfigurationError: a group is not supported; the message names the libraries that support it.
    """
    groups = environment.observation
    if CRITIC in groups and library not in _TAKE_CRITICS:
        raise ConfigurationError(
            f"library '{library}' gives its critic what the policy sees, and cannot take observation group '{CRITIC}': "
            f"set it to None, or use {' or '.join(_TAKE_CRITICS)}"
        )
    # Once, if actor and critic share a group.
    for name in dict.fromkeys((ACTOR, critic_group(environment))):
        if not groups[name].concatenated and library not in _TAKE_PICTURES:
            raise ConfigurationError(
                f"library '{library}' takes one tensor, and observation group '{name}' is a dictionary of its terms "
                f"({', '.join(groups[name].terms)}): give the group concatenate=True, or use "
                f"{' or '.join(_TAKE_PICTURES)}"
            )


def tensors_by_name(observation: Observation) -> dict[str, Tensor]:
    """Return all tensors of an observation by ``group`` if it is concatenated, else by ``group/term``."""
    named: dict[str, Tensor] = {}
    for group, value in observation.items():
        if isinstance(value, Mapping):
            named |= {f"{group}/{term}": tensor for term, tensor in value.items()}
        else:
            named[group] = value
    return named


def tensor_names(environment: Environment, group: str) -> list[str]:
    """Return names of a group's tensors, as :func:`tensors_by_name` gives them."""
    layout = environment.observation[group]
    return [group] if layout.concatenated else [f"{group}/{term}" for term in layout.terms]


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
