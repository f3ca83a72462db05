"""What a step says of the episodes that ended in it, in the forms that learning libraries ask for."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from orbit_core.envs.episode import EpisodeEnd, StepInfo
from orbit_core.envs.observation_layout import Observation, leaves_of, map_leaves


def all_ends(info: Mapping[str, EpisodeEnd], count: int) -> tuple[EpisodeEnd, Tensor] | None:
    """Ends of episodes as rows among all environments, and the mask (N,) of where; None where none ended.

    On a GPU there is always something, since to look whether an episode ended would be to wait for the device.

    Args:
        info: that the environment's step returned.
        count: N, of environments.
    """
    if isinstance(info, StepInfo):
        return info.everyone, info.done
    end = info.get("final")
    return None if end is None else _spread(end, count)


def true_next(observation: Observation, info: Mapping[str, EpisodeEnd]) -> Observation:
    """What each step led to: the last observation of an episode where one ended, not the next one's first.

    Args:
        observation: that the step returned.
        info: that it returned.
    """
    leaves = leaves_of(observation)
    found = all_ends(info, len(leaves[0]))
    if found is None:
        return observation
    end, ended = found
    lasts = iter(leaves_of(end.observation))

    def chosen(value: Tensor) -> Tensor:
        return torch.where(ended.view(-1, *(1,) * (value.dim() - 1)), next(lasts), value)

    return map_leaves(chosen, observation)


class EpisodeTally:
    """Mean return and success of the episodes that ended since it was last read; those that began on the expert's way
    do not count."""  # fmt: skip

    def __init__(self, device: torch.device) -> None:
        self._sums = torch.zeros(3, device=device)
        self._last = (math.nan, math.nan, 0)
        self._metrics: dict[str, Tensor] = {}
        self.metrics: dict[str, float] = {}
        """Means of what the task measures over the episodes that were last read, by name."""

    def add(self, info: Mapping[str, EpisodeEnd], count: int, counts: Tensor | None = None) -> None:
        """Take in a step's episodes; nothing here waits for the device.

        Args:
            info: that the environment's step returned.
            count: N, of environments.
            counts: (N,) bool whose episodes count; all if None.
        """
        found = all_ends(info, count)
        if found is None:
            return
        end, ended = found
        ended = ended & end.usual
        if counts is not None:
            ended = ended & counts
        returns = torch.stack(list(end.rewards.values())).sum(0)
        self._sums += (torch.stack([torch.ones_like(returns), returns, end.success.float()]) * ended).sum(1)
        for name, values in end.metrics.items():
            self._metrics[name] = self._metrics.get(name, 0.0) + (values * ended).sum()

    def read(self) -> tuple[float, float, int]:
        """Return, success rate and number of episodes, and begin anew.

        Where no episode has ended, it tells what the last reading told.
        """
        episodes, returns, successes = self._sums.tolist()
        if episodes:
            self._last = (returns / episodes, successes / episodes, round(episodes))
            self.metrics = {name: float(total) / episodes for name, total in self._metrics.items()}
            self._sums.zero_()
            self._metrics.clear()
        return self._last


def _spread(end: EpisodeEnd, count: int) -> tuple[EpisodeEnd, Tensor]:
    """Ends of some episodes as rows among all environments, zero elsewhere, and the mask of where."""
    device = end.env_ids.device
    ended = torch.zeros(count, dtype=torch.bool, device=device)
    ended[end.env_ids] = True

    def spread(values: Tensor) -> Tensor:
        full = torch.zeros((count, *values.shape[1:]), dtype=values.dtype, device=device)
        full[end.env_ids] = values
        return full

    everyone = EpisodeEnd(
        env_ids=torch.arange(count, device=device),
        observation=map_leaves(spread, end.observation),
        success=spread(end.success),
        metrics={name: spread(value) for name, value in end.metrics.items()},
        rewards={name: spread(value) for name, value in end.rewards.items()},
        steps=spread(end.steps),
    )
    return everyone, ended
