"""Layers of a picture encoder that reports where things are: residual blocks and the mean places of their maps."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

_GROUPS = 8
# Filters of the coarse map, which keeps what places do not hold, such as how a thing is turned.
_COARSE = 16


class ResidualBlock(nn.Module):
    """Two convolutions of 3 x 3 with group normalisation, added to their input (He et al., 2016).

    Args:
        taken: channels of the input.
        given: channels of the output.
        stride: of the first convolution.
        activation: type of the activations.
    """

    def __init__(self, taken: int, given: int, stride: int, activation: type[nn.Module]) -> None:
        super().__init__()
        # Group and not batch normalisation: a policy acts for one environment as for many, without running means.
        self.layers = nn.Sequential(
            nn.Conv2d(taken, given, 3, stride, 1), _normalized(given), activation(),
            nn.Conv2d(given, given, 3, 1, 1), _normalized(given),
        )  # fmt: skip
        self.shortcut = nn.Identity() if taken == given and stride == 1 else nn.Conv2d(taken, given, 1, stride)
        self.activation = activation()

    def forward(self, pictures: Tensor) -> Tensor:
        return self.activation(self.layers(pictures) + self.shortcut(pictures))


class MeanPlaces(nn.Module):
    """Spatial softmax: the mean place of each map, weighted by the softmax of its values.

    Why: a place is known to a fraction of a cell, and moves with what is seen, so that few pictures teach it (Finn et
    al., Deep Spatial Autoencoders for Visuomotor Learning, 2016).

    Args:
        height: rows of the maps.
        width: columns of the maps.
    """

    rows: Tensor
    """(H W,) place of each cell's row, -1 to 1."""
    columns: Tensor
    """(H W,) place of each cell's column, -1 to 1."""

    def __init__(self, height: int, width: int) -> None:
        super().__init__()
        # On the CPU even while weights are made on torch's meta device: no file would fill them.
        rows = torch.linspace(-1.0, 1.0, height, device="cpu")
        columns = torch.linspace(-1.0, 1.0, width, device="cpu")
        self.register_buffer("rows", rows.repeat_interleave(width), persistent=False)
        self.register_buffer("columns", columns.repeat(height), persistent=False)

    def forward(self, maps: Tensor) -> Tensor:
        """Return (N, 2 K) rows and columns of maps (N, K, H, W)."""
        weights = maps.flatten(2).softmax(2)
        return torch.cat(((weights * self.rows).sum(2), (weights * self.columns).sum(2)), 1)


class PlaceEncoder(nn.Module):
    """Encoder from (N, C, H, W) to (N, features): residual blocks, mean places of their maps, and a coarse map.

    Args:
        channels: C.
        height: H.
        width: W.
        filters: channels of the first convolution and of each block; the first two halve the size.
        places: maps whose mean places are features.
        features: units of the last layer.
        activation: type of the activations.
    """

    def __init__(
        self, channels: int, height: int, width: int, filters: tuple[int, ...], places: int, features: int,
        activation: type[nn.Module],
    ) -> None:  # fmt: skip
        super().__init__()
        layers = [nn.Conv2d(channels, filters[0], 5, 2, 2), _normalized(filters[0]), activation()]
        height, width = (height + 1) // 2, (width + 1) // 2
        for i in range(1, len(filters)):
            stride = 2 if i == 1 else 1
            layers.append(ResidualBlock(filters[i - 1], filters[i], stride, activation))
            height, width = (height + stride - 1) // stride, (width + stride - 1) // stride
        self.layers = nn.Sequential(*layers)
        """Convolutions to the maps that places and the coarse map are read from."""
        self.places = nn.Sequential(nn.Conv2d(filters[-1], places, 1), MeanPlaces(height, width))
        self.coarse = nn.Sequential(nn.Conv2d(filters[-1], _COARSE, 3, 2, 1), activation(), nn.Flatten())
        size = 2 * places + _COARSE * ((height + 1) // 2) * ((width + 1) // 2)
        self.last = nn.Sequential(nn.Linear(size, features), activation())

    def forward(self, pictures: Tensor) -> Tensor:
        maps = self.layers(pictures)
        return self.last(torch.cat((self.places(maps), self.coarse(maps)), 1))


def _normalized(channels: int) -> nn.GroupNorm:
    return nn.GroupNorm(math.gcd(channels, _GROUPS), channels)
