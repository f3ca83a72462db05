"""Learned policies as actors, by name, file or folder."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from orbit_learn.pretrained import policy_path, pretrained_policies

if TYPE_CHECKING:
    from orbit_core.envs.actors import Actor
    from orbit_core.envs.environment import Environment


def names() -> Iterable[str]:
    """Return the names of all kept policies."""
    return pretrained_policies()


def has(name: str) -> bool:
    """Return whether a name is a kept policy's, or the path of a file or folder."""
    return Path(name).exists() or name in pretrained_policies()


def make(name: str, environment: Environment, seed: int) -> Actor:
    """Return the actor of a policy.

    Raises:
        ConfigurationError: the policy was learned for another environment.
    """
    from orbit_learn.policy import PolicyActor

    return PolicyActor(environment, policy_path(name))
