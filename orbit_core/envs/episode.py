"""Results of episodes, and what a step reports of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.envs.observation_layout import Observation, map_leaves

# Name of the metric that is 1 where an episode began on the expert's way, else 0.
EXPERT_START = "expert_start"


@dataclass(frozen=True)
class EpisodeEnd:
    """Results of n episodes."""

    env_ids: Tensor
    """(n,)"""
    observation: Observation
    """Observation of the last state, before the reset, with n rows."""
    success: Tensor
    """(n,) bool"""
    metrics: dict[str, Tensor]
    """(n,) each."""
    rewards: dict[str, Tensor]
    """(n,) each term's contribution to the return."""
    steps: Tensor
    """(n,) int64"""

    @property
    def usual(self) -> Tensor:
        """(n,) bool: which began as the task says, not on the expert's way; learning curves count these."""
        there = self.metrics.get(EXPERT_START)
        return torch.ones_like(self.success) if there is None else there == 0.0

    def only(self, rows: Tensor) -> EpisodeEnd:
        """The ends in the rows (k,), by index."""
        return EpisodeEnd(
            env_ids=self.env_ids[rows],
            observation=map_leaves(lambda value: value[rows], self.observation),
            success=self.success[rows],
            metrics=_rows_of(self.metrics, rows),
            rewards=_rows_of(self.rewards, rows),
            steps=self.steps[rows],
        )


class StepInfo(Mapping[str, EpisodeEnd]):
    """Holds an :class:`EpisodeEnd` under ``"final"`` where an episode ended in the step, and else nothing.

    It is looked for when it is asked for, and only that waits for the device. Who would not wait takes :attr:`done` and
    :attr:`everyone`.
    """

    def __init__(self, done: Tensor, everyone: EpisodeEnd) -> None:
        self.done = done
        """(N,) bool: whose episode ended."""
        self.everyone = everyone
        """Ends of all environments' episodes, as if each had ended with this step."""
        self._final: EpisodeEnd | None = None
        self._looked = False

    @property
    def _found(self) -> EpisodeEnd | None:
        if not self._looked:
            rows = self.done.nonzero().squeeze(-1)
            self._final = self.everyone.only(rows) if len(rows) else None
            self._looked = True
        return self._final

    def __getitem__(self, key: str) -> EpisodeEnd:
        if key != "final" or self._found is None:
            raise KeyError(key)
        return self._found

    def __iter__(self) -> Iterator[str]:
        return iter(() if self._found is None else ("final",))

    def __len__(self) -> int:
        return int(self._found is not None)

    def __repr__(self) -> str:
        return repr(dict(self))


def _rows_of(values: dict[str, Tensor], rows: Tensor) -> dict[str, Tensor]:
    return {name: value[rows] for name, value in values.items()}
