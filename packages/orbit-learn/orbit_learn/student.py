"""A network of ORBIT's own for whatever the group ``policy`` holds, to be learned."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from orbit_core.envs.observation_layout import GroupLayout
from orbit_learn.convolutional import PictureActor, convolutional
from orbit_learn.description import group_parts
from orbit_learn.networks import ActorNetwork, Network, NormalizedActor, Perceptron

# Added to standard deviations: what never changes in training must not weigh more for that.
_LEAST_STD = 1e-2


def network_for(layout: GroupLayout, hidden_sizes: Sequence[int]) -> Network:
    """Return a perceptron for a concatenated group; for a dictionary with pictures, convolutions before it.

    Raises:
        ConfigurationError: the dictionary holds pictures that are neither colour nor depth, or none at all.
    """
    if layout.concatenated:
        return Perceptron(tuple(hidden_sizes))
    return convolutional(group_parts(layout), hidden_sizes)


def build_actor(network: Network, layout: GroupLayout, action_size: int) -> PictureActor | NormalizedActor:
    """Return the module of :func:`network_for`."""
    module = network.build(layout.size if layout.concatenated else 0, action_size)
    assert isinstance(module, PictureActor | NormalizedActor)
    return module


def copied_actor(network: Network, module: nn.Module) -> ActorNetwork:
    """Return a copy on the CPU that learns no more."""
    copied = copy.deepcopy(module).cpu().to(memory_format=torch.contiguous_format)  # pyright: ignore[reportCallIssue]
    return ActorNetwork(network, copied.requires_grad_(False).eval())


class RunningMoments:
    """Mean and standard deviation of all rows so far, which weigh the same.

    Chan, Golub and LeVeque, Updating Formulae and a Pairwise Algorithm for Computing Sample Variances (1979).
    """

    def __init__(self, size: int, device: torch.device) -> None:
        self.count = torch.zeros((), device=device)
        self.mean = torch.zeros(size, device=device)
        self._squares = torch.zeros(size, device=device)
        """(size,) sum of squared deviations from the mean."""

    def add(self, rows: Tensor) -> None:
        """Take in (M, size)."""
        count, mean = len(rows), rows.mean(0)
        total, change = self.count + count, mean - self.mean
        self._squares += ((rows - mean) ** 2).sum(0) + change**2 * self.count * count / total
        self.mean += change * count / total
        self.count += count

    @property
    def std(self) -> Tensor:
        """(size,) never zero."""
        return (self._squares / self.count.clamp(min=1.0)).sqrt() + _LEAST_STD

    def state(self) -> dict[str, Tensor]:
        """Return the statistics, for a checkpoint."""
        return {"count": self.count, "mean": self.mean, "squares": self._squares}

    def load(self, state: dict[str, Tensor]) -> None:
        """Take over what :meth:`state` gave."""
        self.count.copy_(state["count"])
        self.mean.copy_(state["mean"])
        self._squares.copy_(state["squares"])
