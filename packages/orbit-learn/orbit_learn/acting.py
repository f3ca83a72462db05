"""Learned policies as actors, by name, file or folder."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from orbit_learn.pretrained import policy_path, pretrained_policies

if TYPE_CHECKING:
    from orbit_core.envs.actors import Actor
    from orbit_core.envs.environment import Environment

SCHEMES = ("ws://", "wss://")
"""Beginnings of a policy server's address."""


def names() -> Iterable[str]:
    """Return the names of all kept policies."""
    return pretrained_policies()


def has(name: str) -> bool:
    """Return whether a name is a kept policy's, the path of a file or folder, or the address of a policy server."""
    return name.startswith(SCHEMES) or Path(name).exists() or name in pretrained_policies()


def make(name: str, environment: Environment, seed: int) -> Actor:
    """Return the actor of a policy, or of a policy server.

    Raises:
        ConfigurationError: the policy was learned for another environment, or no server answers.
    """
    if name.startswith(SCHEMES):
        from orbit_learn.remote.client import RemoteActor, ServerAddress

        return RemoteActor(environment, ServerAddress.parse(name))
    from orbit_learn.policy import PolicyActor

    return PolicyActor(environment, policy_path(name))


def digest(name: str) -> str:
    """Return the SHA-256 of a policy's files; empty for a policy server."""
    if name.startswith(SCHEMES):
        return ""
    path = policy_path(name)
    # A folder's newest policy acts: all of them count, in the order of their names.
    files = sorted(path.glob("*.safetensors")) if path.is_dir() else [path]
    found = hashlib.sha256()
    for file in files:
        found.update(file.read_bytes())
    return found.hexdigest()
