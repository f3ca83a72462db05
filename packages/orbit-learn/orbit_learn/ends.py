"""Ends of episodes in the forms that learning libraries need."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from orbit_core.envs.episode import EpisodeEnd, StepInfo
from orbit_core.envs.observation_layout import Observation, leaves_of, map_leaves


def all_ends(info: Mapping[str, EpisodeEnd], count: int) -> tuple[EpisodeEnd, Tensor] | None:
    """Return ends of episodes as rows among all environments, and their mask (N,); None if none ended.

    On a GPU the result is never None, because checking whether an episode ended would wait for the device.

    Args:
        info: info of the environment's step.
        count: number N of environments.
    """
    if isinstance(info, StepInfo):  # which has rows of all environments, so that the host reads nothing
        return info.everyone, info.done
    end = info.get("final")
    return None if end is None else _spread(end, count)


def true_next(observation: Observation, info: Mapping[str, EpisodeEnd]) -> Observation:
    """Return the observation after each step: an episode's last one where it ended, not the next one's first.

    Args:
        observation: observation that the step returned.
        info: info that it returned.
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
    """Mean return and success of the episodes that ended since the last reading.

    Episodes that began on the expert's way do not count.

    Args:
        device: device of the environments.
        parts: rows of the environments whose success is also counted apart, by name.
    """

    def __init__(self, device: torch.device, parts: Mapping[str, slice] | None = None) -> None:
        self._parts = dict(parts or {})
        # (parts, 2) numbers and successes of each part's episodes.
        self._of_parts = torch.zeros(len(self._parts), 2, device=device)
        self.parts: dict[str, float] = {}
        """Success rate of each part's episodes of the last reading in which any ended, by name."""
        # Number, return, success, then the metrics; made with the first episodes, which say how many metrics there are.
        # Always written in place, because a recorded step repeats its writes to this memory.
        self._sums = torch.zeros(3, device=device)
        self._names: tuple[str, ...] | None = None
        self._last = (math.nan, math.nan, 0)
        self.metrics: dict[str, float] = {}
        """Means of the task's metrics over the episodes of the last reading, by name."""

    def add(self, info: Mapping[str, EpisodeEnd], count: int, counts: Tensor | None = None) -> None:
        """Add a step's episodes without waiting for the device.

        Args:
            info: info of the environment's step.
            count: number N of environments.
            counts: mask (N,) of the environments whose episodes count; all if None.
        """
        found = all_ends(info, count)
        if found is None:
            return
        end, ended = found
        # A start on the expert's way is easier, so that its success says little of the policy.
        ended = ended & end.usual
        if counts is not None:
            ended = ended & counts
        if self._names != tuple(end.metrics):  # a curriculum that begins adds a metric
            known = dict(zip(self._names or (), self._sums[3:], strict=True))
            self._sums = torch.stack([*self._sums[:3], *(known.get(n, self._sums.new_zeros(())) for n in end.metrics)])
            self._names = tuple(end.metrics)
        returns = torch.stack(list(end.rewards.values())).sum(0)
        values = [torch.ones_like(returns), returns, end.success, *end.metrics.values()]
        # Not multiplied by the mask: a metric of an environment whose episode goes on may be NaN.
        rows = torch.stack([value.to(returns.dtype) for value in values])
        rows = rows.masked_fill(~ended, 0.0)
        self._sums += rows.sum(1)
        for sums, part in zip(self._of_parts, self._parts.values(), strict=True):
            sums += torch.stack((rows[0, part], rows[2, part])).sum(1)

    def read(self) -> tuple[float, float, int]:
        """Return mean return, success rate and number of episodes, and reset.

        If no episode has ended, the result is that of the last reading.
        """
        for name, (count, reached) in zip(self._parts, self._of_parts.tolist(), strict=True):
            if count:
                self.parts[name] = reached / count
        self._of_parts.zero_()
        # One transfer for all sums, because each waits for the device.
        episodes, returns, successes, *metrics = self._sums.tolist()
        if episodes:
            self._last = (returns / episodes, successes / episodes, round(episodes))
            self.metrics = {name: total / episodes for name, total in zip(self._names or (), metrics, strict=True)}
            self._sums.zero_()
        return self._last


def _spread(end: EpisodeEnd, count: int) -> tuple[EpisodeEnd, Tensor]:
    """Spread ends of some episodes over rows of all environments, zero elsewhere, and return their mask."""
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
