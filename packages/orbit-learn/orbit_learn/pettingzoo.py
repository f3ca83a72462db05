"""Environment of several agents with PettingZoo's parallel interface: Terry et al., PettingZoo (2021)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces
from pettingzoo import ParallelEnv

from orbit_core.envs.episode import EpisodeEnd
from orbit_core.envs.making import make
from orbit_core.envs.observation_layout import Observation
from orbit_core.envs.task import Task
from orbit_core.interfaces import ArgumentError, ConfigurationError
from orbit_core.world.lifetime import mark_closed
from orbit_learn.gymnasium import Spectator, arrays_of, as_tensor, checked_mode, outcome
from orbit_learn.spaces import group_space

Array = npt.NDArray[np.float32]


class ParallelEnvironment(ParallelEnv[str, Array, Array]):
    """One environment with NumPy arrays, whose agents are the robots that act, by their names in the scene.

    :class:`orbit_core.envs.multi_agent.MultiAgentView` defines each agent's observation and reward. All agents live
    from ``reset`` to the end of the episode, whose last observation the last step returns; the information then has
    success and metrics. ``state`` is the whole observation. For many environments, ``Environment.multi_agent`` does
    the same with torch tensors.

    Keywords are those of :func:`orbit_core.envs.make`: backend, device, seed, and the task's own fields.

    Raises:
        ConfigurationError: the task has one agent.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}  # noqa: RUF012 - PettingZoo looks at the class's own
    """Name, render modes and rate, as PettingZoo reads them."""

    def __init__(self, task: str | Task, render_mode: str | None = None, **keywords: Any) -> None:
        self.render_mode = checked_mode(render_mode)
        """``"rgb_array"``, or None without pictures."""
        self.environment = make(task, num_envs=1, autoreset=False, **keywords)
        """ORBIT's environment, for what PettingZoo's interface lacks."""
        name = type(self.environment.task).__name__
        if self.environment.multi_agent is None:
            self.environment.close()
            raise ConfigurationError(f"task {name} has one agent: take orbit_learn.gymnasium.SingleEnvironment for it")
        self._shares = shares = self.environment.multi_agent
        fps = round(1.0 / self.environment.step_dt)
        self.metadata = {**ParallelEnvironment.metadata, "name": f"orbit/{name}", "render_fps": fps}
        self.possible_agents = list(shares.agents)
        """Names of all robots that act."""
        self.agents: list[str] = []
        """The same during an episode; empty before the first and after its end."""
        self.observation_spaces = {agent: group_space(layout) for agent, layout in shares.layouts.items()}
        """Space of each agent's observation."""
        self.action_spaces = {
            agent: spaces.Box(-1.0, 1.0, (size,), np.float32) for agent, size in shares.action_sizes.items()
        }
        """Space of each agent's part of the action, in [-1, 1]."""
        self.state_space = group_space(self.environment.observation["policy"])
        """Space of the whole observation."""
        self._state: Any = None
        self._spectator = Spectator(self.environment, self.render_mode)

    def observation_space(self, agent: str) -> spaces.Space[Array]:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Array]:
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, dict[str, Any]]]:
        """Begin an episode. Options are not used: PettingZoo's own test gives some to every environment."""
        observation, _ = self.environment.reset(seed)
        self.agents = list(self.possible_agents)
        return self._observed(observation), {agent: {} for agent in self.agents}

    def step(
        self, actions: dict[str, Array]
    ) -> tuple[dict[str, Array], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        if not isinstance(actions, Mapping):
            raise ArgumentError(f"actions must be a dictionary by agent, not a {type(actions).__name__}")
        if not self.agents:
            raise ConfigurationError("the episode is over: reset the environment, then step")
        device = self.environment.device
        batch = {
            agent: as_tensor(action, torch.float32, device, f"action of '{agent}'")[None]
            for agent, action in actions.items()
        }
        observation, _, terminated, truncated, info = self.environment.step(self._shares.action(batch))
        end: EpisodeEnd | None = info.get("final")
        rewards = {agent: float(reward) for agent, reward in self._shares.rewards().items()}
        terminations, truncations = (dict.fromkeys(self.agents, bool(over)) for over in (terminated, truncated))
        infos = {agent: outcome(end, 0) for agent in self.agents}
        if end is not None:
            self.agents = []  # PettingZoo's sign that the episode is over
        return self._observed(observation), rewards, terminations, truncations, infos

    def state(self) -> Any:
        """Return the whole group ``"policy"``: (O,), or its terms by name.

        Raises:
            ConfigurationError: no episode has begun.
        """
        if self._state is None:
            raise ConfigurationError("there is no state before the first episode: reset the environment")
        return self._state

    def render(self) -> npt.NDArray[np.uint8] | None:
        pictures = self._spectator.pictures()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        self._spectator.close()
        self.environment.close()
        mark_closed(self, "the environment")

    def _observed(self, observation: Observation) -> dict[str, Any]:
        policy = observation["policy"]
        self._state = arrays_of({"policy": policy})["policy"]
        return dict(arrays_of(self._shares.observations(policy)))
