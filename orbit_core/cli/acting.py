"""Actors by the name that a user gives: a scripted one, a kept policy, or the file of a learned policy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from orbit_core.envs.actors import ACTORS, scripted_actor
from orbit_core.interfaces.errors import UnknownNameError
from orbit_learn.pretrained import policy_path, pretrained_policies

if TYPE_CHECKING:
    from orbit_core.envs.actors import Actor
    from orbit_core.envs.environment import Environment


def check_actor(name: str) -> None:
    """Refuse a name that no actor and no kept policy bears and that is no file or folder.

    Raises:
        UnknownNameError: there is none.
    """
    if name not in ACTORS and not Path(name).exists() and name not in pretrained_policies():
        raise UnknownNameError("actor or policy", name, {*ACTORS, *pretrained_policies()})


def make_actor(name: str, environment: Environment, seed: int) -> Actor:
    """The actor of that name, the policy in that file or folder, or the kept policy of that name.

    Raises:
        UnknownNameError: there is none.
        ConfigurationError: the policy was learned for another environment.
    """
    check_actor(name)
    if name in ACTORS:
        return scripted_actor(name, environment, seed)
    from orbit_learn.policy import PolicyActor

    return PolicyActor(environment, policy_path(name))
