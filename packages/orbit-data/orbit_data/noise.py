"""Noise on the actions of a demonstrator, who then shows how to return: Laskey et al., DART: Noise Injection for Robust
Imitation Learning (2017)."""  # fmt: skip

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.random import RandomStreams
from orbit_core.envs.actors import Actor
from orbit_core.interfaces import ConfigurationError

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment

CLEAN = "clean_actions"
"""Array of the actions that the demonstrator chose, before noise; ``actions`` are those that were executed."""
# Probability of new noise at a step: noise that changes at each step is what the drives average away.
_RENEWED = 0.1
# Most of an episode that a strayed start takes: 1 s of Lift's 5 s.
_STRAYED = 0.2
# Added to the seed, so that noise is not the numbers that the task draws.
_STREAM = 0xDA27


class NoisyActor(Actor):
    """Adds noise to another actor's actions, held for ten steps on average; a seed repeats it.

    Args:
        actor: whose actions are disturbed.
        environment: that it acts in.
        deviation: standard deviation of the noise, in units of the action; each episode has its own, uniform between
            zero and twice this, so that a dataset holds quiet episodes and disturbed ones.
        seed: of the random streams.
        straying: the same, of noise at an episode's start only, for a time that is uniform between zero and a fifth of
            the longest episode; the way back is demonstrated without noise.

    Raises:
        ConfigurationError: a deviation is negative or infinite, or both are zero.
    """

    def __init__(
        self, actor: Actor, environment: Environment, deviation: float, seed: int, straying: float = 0.0
    ) -> None:
        for name, value in (("noise", deviation), ("stray", straying)):
            if not 0.0 <= value < math.inf:
                raise ConfigurationError(f"{name} is a standard deviation of at least zero, not {value:g}")
        if not deviation + straying:
            raise ConfigurationError("a disturbed demonstrator needs noise or a strayed start above zero")
        self._actor, self._environment = actor, environment
        self._deviation, self._straying = deviation, straying
        count, size = environment.num_envs, environment.action_size
        self._streams = RandomStreams(count, (seed + _STREAM) % 2**63, environment.device)
        self._noise = torch.zeros(count, size, device=environment.device)
        self._scale = torch.zeros(count, 1, device=environment.device)
        self._stray_scale = torch.zeros(count, 1, device=environment.device)
        self._stray_end = torch.zeros(count, 1, device=environment.device)
        self.clean = torch.zeros(count, size, device=environment.device)
        """(N, A) what the actor chose at the last step, clipped to [-1, 1]."""

    def act(self) -> Tensor:
        self.clean = self._actor.act().clamp(-1.0, 1.0)
        self._streams.begin(self._environment.world.random.episode)
        step, size = self._environment.state.episode_step[:, None], self._environment.action_size
        begun = step == 0
        drawn = self._streams.uniform((2 * size + 2,), 0.0, 1.0)
        self._scale = torch.where(begun, 2.0 * self._deviation * drawn[:, :1], self._scale)
        if self._straying:
            begins = self._streams.uniform((2,), 0.0, 1.0)
            longest = _STRAYED * self._environment.max_episode_steps
            self._stray_scale = torch.where(begun, 2.0 * self._straying * begins[:, :1], self._stray_scale)
            self._stray_end = torch.where(begun, longest * begins[:, 1:], self._stray_end)
        # Box and Muller, A Note on the Generation of Random Normal Deviates (1958); 1 - u is never zero.
        radius = (-2.0 * (1.0 - drawn[:, 2 : size + 2]).log()).sqrt()
        normal = radius * (2.0 * math.pi * drawn[:, size + 2 :]).cos()
        renewed = begun | (drawn[:, 1:2] < _RENEWED)
        self._noise = torch.where(renewed, normal, self._noise)
        scale = torch.where(step < self._stray_end, self._stray_scale, 0.0) + self._scale
        return (self.clean + scale * self._noise).clamp(-1.0, 1.0)
