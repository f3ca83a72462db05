"""What a step of an environment is put together from."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from orbit_core.envs.action_manager import ActionManager
from orbit_core.envs.observation_layout import GroupLayout, Observation
from orbit_core.envs.observation_manager import ObservationManager
from orbit_core.envs.task import Task
from orbit_core.envs.terms import RewardTerm
from orbit_core.interfaces import World


class CapturableEnvironment(Protocol):
    """The parts of a step, which an environment runs one by one or has captured. None of them waits for the device."""

    world: World
    task: Task
    actions: ActionManager
    device: torch.device
    observer: ObservationManager
    observation: dict[str, GroupLayout]
    """What each group of the observation is like, by name."""
    reward_terms: dict[str, RewardTerm]
    """The rewards, by name."""
    reward_sums: Tensor
    """(rewards, N) of each term over the episode."""
    max_episode_steps: int
    """Steps of an episode."""
    all_ids: Tensor
    """(N,) indices of all environments."""
    done: Tensor
    """(N,) whose episode ended in the last step."""

    def observe(self) -> Observation:
        """Return what a policy sees of the present state."""
        ...

    def advance(self) -> tuple[Tensor, Tensor, Tensor]:
        """Apply the action; gives reward (N,), terminated (N,) and truncated (N,); sets :attr:`done`."""
        ...

    def success(self) -> Tensor:
        """(N,) bool: whether episodes that end now reach the goal."""
        ...

    def metrics(self) -> dict[str, Tensor]:
        """The task's measures (N,) of the episode so far, by name."""
        ...

    def progress(self) -> None:
        """Let episodes that have just ended decide how difficult the next will be."""
        ...

    def begin(self, env_ids: Tensor | None) -> None:
        """New episodes in some environments: by index (n,) int64, by mask (N,) bool, or in all of them if None."""
        ...
