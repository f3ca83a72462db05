"""What policies are made of where a library leaves that to its users."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from torch import Tensor, nn


def perceptron(inputs: int, hidden: Sequence[int], outputs: int) -> nn.Sequential:
    """Linear layers with exponential linear units between them."""
    sizes = [inputs, *hidden]
    layers: list[nn.Module] = []
    for taken, given in itertools.pairwise(sizes):
        layers += [nn.Linear(taken, given), nn.ELU()]
    return nn.Sequential(*layers, nn.Linear(sizes[-1], outputs))


class NormalizedActor(nn.Module):
    """Layers that see the observation in standard deviations from its mean, at most ``limit`` of them.

    Args:
        mean: (O,) of observations seen in training.
        std: (O,) theirs.
        limit: of what the layers see.
        layers: normalised observation (N, O) -> action (N, A).
    """

    mean: Tensor
    std: Tensor

    def __init__(self, mean: Tensor, std: Tensor, limit: float, layers: nn.Module) -> None:
        super().__init__()
        self.register_buffer("mean", mean.float().cpu())
        self.register_buffer("std", std.float().cpu())
        self.limit = limit
        self.layers = layers

    def forward(self, observation: Tensor) -> Tensor:
        return self.layers(((observation - self.mean) / self.std).clamp(-self.limit, self.limit))
