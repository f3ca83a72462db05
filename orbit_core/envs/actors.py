"""Actors: sources of actions for an environment without a policy that learns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from orbit_core.interfaces.errors import UnknownNameError

if TYPE_CHECKING:
    from torch import Tensor

    from orbit_core.envs.environment import Environment

# Added to the environment's seed, so that random actions are not the numbers that the task itself draws.
_OTHER_STREAM = 0x5EED


class Actor(Protocol):
    """Gives the environments' actions, one step after another."""

    def act(self) -> Tensor:
        """(N, A) the next action."""
        ...


@runtime_checkable
class RemoteSource(Protocol):
    """An actor that asks another program, which may not answer."""

    unanswered: Sequence[bool]
    """Environments whose present episode got no answer: it counts as a failure."""
    failures: Mapping[str, int]
    """What went wrong, and how often."""


@runtime_checkable
class Teacher(Protocol):
    """An expert that may label the states of another that acts."""

    teaches: bool
    """True while another acts, so that the phase follows from the state alone."""


class ExpertActor(Actor):
    """The task's scripted expert."""

    def __init__(self, environment: Environment, seed: int) -> None:
        self._expert = environment.expert()

    def act(self) -> Tensor:
        return self._expert.compute({})["action"]


class RandomActor(Actor):
    """Uniform in [-1, 1], from a stream per environment and episode.

    Environment i does the same in its episode k however many other environments there are, and whether its earlier
    episodes ran in this process or before it: a recording that was cut off goes on as it would have.
    """

    def __init__(self, environment: Environment, seed: int) -> None:
        from orbit_core.dynamics.random import RandomStreams

        self._streams = RandomStreams(environment.num_envs, (seed + _OTHER_STREAM) % 2**63, environment.device)
        self._episodes = environment.world.random
        self._shape = (environment.action_size,)

    def act(self) -> Tensor:
        self._streams.begin(self._episodes.episode)
        return self._streams.uniform(self._shape, -1.0, 1.0)


class ZeroActor(Actor):
    """All components zero."""

    def __init__(self, environment: Environment, seed: int) -> None:
        import torch

        self._action = torch.zeros(environment.num_envs, environment.action_size, device=environment.device)

    def act(self) -> Tensor:
        return self._action


class HoldActor(Actor):
    """The first action of the random actor, held until the episode ends."""

    def __init__(self, environment: Environment, seed: int) -> None:
        import torch

        self._random = RandomActor(environment, seed)
        self._begun = environment.state.episode_step
        self._held = torch.zeros(environment.num_envs, environment.action_size, device=environment.device)

    def act(self) -> Tensor:
        drawn, begun = self._random.act(), self._begun == 0
        self._held.copy_(drawn.where(begun[:, None], self._held))
        return self._held


ACTORS = {"expert": ExpertActor, "random": RandomActor, "zero": ZeroActor, "hold": HoldActor}


def scripted_actor(name: str, environment: Environment, seed: int) -> Actor:
    """The actor of that name.

    Raises:
        UnknownNameError: there is none.
    """
    if name not in ACTORS:
        raise UnknownNameError("actor", name, ACTORS)
    return ACTORS[name](environment, seed)
