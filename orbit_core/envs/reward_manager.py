"""Reward manager: the weighted sum of a task's reward terms, and the sum of each over the episode."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.envs.observation_layout import surely_finite
from orbit_core.envs.terms import RewardTerm, check_same_names, per_environment, terms_of, weight_of
from orbit_core.interfaces import ConfigurationError, NonFiniteError, first_few

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


class RewardManager:
    """Computes the reward (N,) of a world's present state.

    Args:
        env: whose task has the terms; every weight is multiplied by the seconds of its step.
    """

    def __init__(self, env: Environment) -> None:
        self._env = env
        self.terms = terms_of(env.task.rewards, RewardTerm)
        """Reward terms by name."""
        self._weights = torch.tensor(self._scaled(), device=env.device)
        self._column = self._weights[:, None]
        self._shape = torch.Size((env.num_envs,))
        self.sums = torch.zeros(len(self.terms), env.num_envs, device=env.device)
        """(terms, N) each term's contribution to the episode so far."""

    def refresh(self) -> None:
        """Take the terms and weights that the task has now; a captured step sees them too.

        Raises:
            ConfigurationError: a weight is no finite number, or there are other terms than before.
        """
        check_same_names(
            "reward", self.terms, now := terms_of(self._env.task.rewards, RewardTerm), "set its weight to 0"
        )
        self.terms.update(now)
        self._weights.copy_(torch.tensor(self._scaled()))

    def _scaled(self) -> list[float]:
        return [weight_of(name, term) * self._env.step_dt for name, term in self.terms.items()]

    def values(self) -> Tensor:
        """(terms, N) of this step, unweighted; they are added to :attr:`sums`.

        Raises:
            ConfigurationError, ShapeError: a term gives something else than (N,) numbers; names it.
        """
        # An empty stack is an error, and the sums have the shape (0, N) that is needed.
        if not self.terms:
            return self.sums
        values: list[Tensor] = []
        for name, term in self.terms.items():  # a plain loop: a step's time is that of its Python calls
            value = term.function(self._env)
            if type(value) is not Tensor or value.dtype is not torch.float32 or value.shape != self._shape:
                value = self._checked(name, value)
            values.append(value)
        stacked = torch.stack(values)
        self.sums.addcmul_(stacked, self._column)
        return stacked

    def _checked(self, name: str, value: object) -> Tensor:
        value = per_environment(value, f"reward term '{name}'", self._env.num_envs)
        if value.is_complex():
            raise ConfigurationError(f"reward term '{name}' gives {value.dtype}: its function must give real numbers")
        return value if value.dtype == torch.float32 else value.float()

    def check_finite(self, reward: Tensor) -> None:
        """Refuse a reward (N,) that is NaN or infinite; this waits for the device.

        Raises:
            NonFiniteError: names the terms and the environments.
        """
        if surely_finite(reward) or bool(reward.isfinite().all()):
            return
        wrong = (~reward.isfinite()).nonzero().squeeze(-1).tolist()
        # The step's own values are gone, but a term that was not finite has spoilt its sum.
        names = [name for name, total in zip(self.terms, self.sums, strict=True) if not total[wrong].isfinite().all()]
        terms = f"reward term {' and '.join(map(repr, names))}" if names else "the reward"
        raise NonFiniteError(
            f"{terms} is not finite in environment{'s' if len(wrong) > 1 else ''} {first_few(wrong)}: a term must give "
            "finite numbers; bound what divides or measures"
        )

    def total(self, values: Tensor) -> Tensor:
        """(N,) the reward that the terms' values (terms, N) make."""
        # Four operations with the weights on the left, as the product makes a matrix of them and takes it away again.
        return torch.mv(values.t(), self._weights)

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget some environments' sums, by index or mask."""
        # Transposed, because rows are environments; the view writes into the sums themselves.
        write_rows(self.sums.T, 0.0, env_ids)
