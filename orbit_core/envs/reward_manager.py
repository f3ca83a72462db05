"""What a step earns: the weighted sum of a task's reward terms, and what each has come to in the episode."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.envs.task import Task
from orbit_core.envs.terms import RewardTerm, terms_of
from orbit_core.interfaces import World


class RewardManager:
    """Computes the reward (N,) of a world's present state.

    Args:
        world: that is looked at.
        task: whose terms they are.
        step_dt: seconds in a step of the environment, by which every weight is multiplied.
    """

    def __init__(self, world: World, task: Task, step_dt: float) -> None:
        self._world = world
        self._task = task
        self.terms = terms_of(task.rewards, RewardTerm)
        self._weights = torch.tensor([term.weight * step_dt for term in self.terms.values()], device=world.device)
        self._column = self._weights[:, None]
        self.sums = torch.zeros(len(self.terms), world.num_envs, device=world.device)
        """(terms, N) each term's contribution to the episode so far."""

    def values(self) -> Tensor:
        """(terms, N) of this step, unweighted; they are added to :attr:`sums`."""
        values = torch.stack([term.function(self._world, self._task) for term in self.terms.values()])
        self.sums.addcmul_(values, self._column)
        return values

    def total(self, values: Tensor) -> Tensor:
        """(N,) the reward that the terms' values (terms, N) make."""
        return self._weights @ values

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget some environments' sums, by index or mask."""
        write_rows(self.sums.T, 0.0, env_ids)
