"""Arguments, most of them bad: a typed pool that every call of the fuzz draws from."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

NUMBERS = (0, 1, -1, 3, 0.5, -0.5, float("nan"), float("inf"), -float("inf"), 1e30, -1e30, 2**31, 2**63, 10**30, True)
OTHERS = (None, "", "nonsense", "panda_joint1", (), [], {}, [1, 2], (0.0, 0.0), {"a": 1}, b"bytes", 1j, object, "cpu")


class Pool:
    """Draws arguments from one generator, so that a seed repeats them."""

    def __init__(self, seed: str) -> None:
        self.random = random.Random(seed)

    def anything(self) -> Any:
        """A number, or something that is none."""
        return self.random.choice((self.number, lambda: self.random.choice(OTHERS), lambda: self.tensor(2)))()

    def number(self) -> Any:
        return self.random.choice(NUMBERS)

    def word(self, good: Sequence[str]) -> Any:
        """A name that something bears, or one that nothing does."""
        return self.random.choice((*good, *good, "nonsense", "", "(", 3, None, "x" * 300, "[1-7]", ["cube"]))

    def indices(self, count: int) -> Any:
        """Joints or links."""
        good = self.random.sample(range(count), self.random.randint(1, count))
        bad = ([count], [-1], [0, 0], ["a"], 0, [0.5], torch.tensor([0]), [])
        return self.random.choice((None, None, good) if self.random.random() < 0.6 else bad)

    def env_ids(self, num_envs: int) -> Any:
        good = torch.tensor(self.random.sample(range(num_envs), self.random.randint(1, num_envs)))
        mask = torch.rand(num_envs) > 0.5
        bad = (
            torch.tensor([num_envs]), torch.tensor([-1]), torch.tensor([0, 0]), torch.tensor([1_000_000]),
            torch.tensor([2**62]), good.float(), good.to(torch.uint8), good[None], torch.ones(num_envs + 1).bool(),
            good.tolist(), 0, "all", torch.tensor(0), good.numpy(), torch.tensor([], dtype=torch.int64), slice(None),
        )  # fmt: skip
        return self.random.choice((None, good, mask) if self.random.random() < 0.5 else bad)

    def tensor(self, *shape: int) -> Any:
        """Numbers of that shape, or nearly so."""
        good = torch.rand(shape) * self.random.choice((1.0, 1.0, 100.0))
        if self.random.random() < 0.4:  # else few calls would come past their first argument
            return good
        flaws: tuple[Callable[[], Any], ...] = (
            lambda: good,
            lambda: good.double(),
            lambda: good.clone().requires_grad_(),
            lambda: self._with(good, float("nan")),
            lambda: self._with(good, float("inf")),
            lambda: self._with(good, self.random.choice((1e30, -1e30, 1e10, -1.0, 0.0))),
            lambda: torch.zeros_like(good),
            lambda: good[:0],
            lambda: good[..., None],
            lambda: torch.rand(*shape, 2) if shape else torch.rand(2),
            lambda: good.to_sparse() if good.dim() else good,
            lambda: good.to(torch.complex64),
            lambda: good > 0.5,
            lambda: good.to(torch.int64),
            lambda: good.half(),
            lambda: good.to("meta"),
            lambda: good.numpy(),
            lambda: good.tolist(),
            lambda: good.transpose(0, -1) if good.dim() else good,
            lambda: np.array(["a"]),
            lambda: self.random.choice(OTHERS),
        )
        return self.random.choice(flaws)()

    def poses(self, count: int) -> Any:
        """(count, 7), or nearly so."""
        value = self.tensor(count, 7)
        if isinstance(value, torch.Tensor) and value.shape == (count, 7) and self.random.random() < 0.5:
            value = torch.rand(count, 7)
            value[:, 3:] = torch.nn.functional.normalize(value[:, 3:], dim=1)
        return value

    def _with(self, good: torch.Tensor, number: float) -> torch.Tensor:
        value = good.clone()
        if value.numel():
            value.view(-1)[self.random.randrange(value.numel())] = number
        return value


def shown(value: object) -> str:
    """Short enough to be printed before each call."""
    if isinstance(value, torch.Tensor):
        return f"tensor{tuple(value.shape)} {value.dtype} {value.layout} {value.device}"
    text = repr(value).replace("\n", " ")
    return text if len(text) < 120 else text[:117] + "..."
