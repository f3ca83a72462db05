"""Observation groups of actor and critic, and the libraries that support them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from orbit_core.interfaces.errors import ConfigurationError

if TYPE_CHECKING:
    from torch import Tensor

    from orbit_core.envs.environment import Environment
    from orbit_core.envs.observation_layout import Observation

ACTOR = "policy"
CRITIC = "critic"
# Libraries whose adapters here build encoders of pictures, and those that give the critic its own observation.
_TAKE_PICTURES = ("rsl-rl", "sb3", "skrl", "torchrl", "distill")
_TAKE_CRITICS = ("rsl-rl", "rl-games", "skrl", "torchrl")


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
