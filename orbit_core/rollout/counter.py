"""Counting episodes: the first few of every environment, so that short episodes are not preferred to long ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.rollout.estimates import Estimate, proportion
from orbit_core.rollout.stepping import StepObserver

if TYPE_CHECKING:
    from orbit_core.envs.episode import EpisodeEnd


@dataclass(frozen=True, eq=False)
class Episodes:
    """What n episodes came to: those of the first environment, in the order in which they ended, then the next's."""

    env_ids: Tensor
    """(n,) int64"""
    success: Tensor
    """(n,) bool"""
    steps: Tensor
    """(n,) int64, of the environment."""
    returns: Tensor
    """(n,) sums of the rewards."""
    metrics: dict[str, Tensor]
    """(n,) each, by name; the first leads."""

    @property
    def success_rate(self) -> Estimate:
        """Success rate in [0, 1], with its 95 % interval."""
        return proportion(int(self.success.sum()), len(self.success))


class EpisodeCounter(StepObserver):
    """Counts the first episodes of each environment.

    Environment i counts its first ``episodes // num_envs`` episodes, and one more if i < ``episodes % num_envs``. A
    race for the first ``episodes`` to end would prefer short episodes to long ones, and so failures to successes or
    the reverse.

    Args:
        episodes: to count.
        num_envs: of the environment.
        device: of the environment.
    """

    def __init__(self, episodes: int, num_envs: int, device: torch.device | str = "cpu") -> None:
        ids = torch.arange(num_envs, device=device)
        self._left = episodes // num_envs + (ids < episodes % num_envs).long()
        self._counted: list[Episodes] = []
        self.wanted = episodes
        """Episodes to count."""
        self.counted = 0
        """Episodes that have been counted."""

    @property
    def complete(self) -> bool:
        """Whether all episodes are in."""
        return self.counted == self.wanted

    @property
    def running(self) -> Tensor:
        """(N,) bool: environments in which episodes are still to be counted."""
        return self._left > 0

    def after_step(self, action: Tensor, info: Mapping[str, EpisodeEnd]) -> None:
        """Count the episodes that ended in a step."""
        if "final" in info:
            self.add(info["final"])

    def add(self, end: EpisodeEnd) -> None:
        """Count those of the episodes that are within their environment's share."""
        rows = self.running[end.env_ids].nonzero().squeeze(-1)
        if not len(rows):
            return
        end = end.only(rows)
        self._left[end.env_ids] -= 1
        returns = sum(end.rewards.values(), torch.zeros_like(end.steps, dtype=torch.float32))
        self._counted.append(Episodes(end.env_ids, end.success, end.steps, returns, end.metrics))
        self.counted += len(rows)

    def episodes(self) -> Episodes:
        """What has been counted; at least one episode."""
        parts = self._counted
        env_ids = torch.cat([part.env_ids for part in parts])
        order = env_ids.argsort(stable=True)
        return Episodes(
            env_ids=env_ids[order],
            success=torch.cat([part.success for part in parts])[order],
            steps=torch.cat([part.steps for part in parts])[order],
            returns=torch.cat([part.returns for part in parts])[order],
            metrics={name: torch.cat([part.metrics[name] for part in parts])[order] for name in parts[0].metrics},
        )
