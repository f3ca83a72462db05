"""Actors by the name that a user gives: a scripted one, or one of an installed package, such as a learned policy."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from typing import TYPE_CHECKING, Protocol

from orbit_core.envs.actors import ACTORS, scripted_actor
from orbit_core.interfaces.errors import UnknownNameError
from orbit_core.registry import Registry

if TYPE_CHECKING:
    from orbit_core.envs.actors import Actor
    from orbit_core.envs.environment import Environment


class ActorSource(Protocol):
    """A package's actors; the entry-point group ``orbit.actors`` names modules or objects with these functions."""

    def names(self) -> Iterable[str]:
        """Return the names of all actors that are listed."""
        ...

    def has(self, name: str) -> bool:
        """Return whether a name, or the path of a file or folder, is one of these actors."""
        ...

    def make(self, name: str, environment: Environment, seed: int) -> Actor:
        """Return the actor of that name or path.

        Raises:
            ConfigurationError: it acts in another environment.
        """
        ...


def check_actor(name: str) -> None:
    """Refuse a name that no actor bears.

    Raises:
        UnknownNameError: there is none of that name.
    """
    if name not in ACTORS:
        _source(name)


def make_actor(name: str, environment: Environment, seed: int) -> Actor:
    """Return the actor of that name, the policy in that file or folder, or the kept policy of that name.

    Raises:
        UnknownNameError: there is none.
        ConfigurationError: the policy was learned for another environment.
    """
    return scripted_actor(name, environment, seed) if name in ACTORS else _source(name).make(name, environment, seed)


@functools.cache
def _sources() -> Registry[ActorSource]:
    return Registry[ActorSource]("source of actors", "orbit.actors")


def _source(name: str) -> ActorSource:
    """Return the package's source that has an actor of that name."""
    registry = _sources()
    sources = registry.values.values()
    for source in sources:
        if source.has(name):
            return source
    names = {*ACTORS, *(other for source in sources for other in source.names())}
    raise UnknownNameError("actor or policy", name, names, note=registry.note)
