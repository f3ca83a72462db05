"""The encoders of a network ``convolutional`` where a learning library puts its own layers behind them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn

from orbit_learn.convolutional import MOST_DEVIATIONS, Convolutional, encoded_pictures, joined_vectors


class PictureFeatures(nn.Module):
    """A dictionary of terms, (N, ...) each -> (N, K) as the network's linear layers see them.

    Args:
        network: of the terms.
        normalize: of the vectors side by side (N, V); nothing if None, where the library has done that before.
    """

    def __init__(self, network: Convolutional, normalize: nn.Module | None = None) -> None:
        super().__init__()
        self.network = network
        self.normalize = nn.Identity() if normalize is None else normalize
        self.encoders = network.build_encoders()

    @property
    def size(self) -> int:
        """K."""
        return self.network.vector_size + self.network.features

    def forward(self, terms: Mapping[str, Tensor]) -> Tensor:
        vectors = self.normalize(joined_vectors(self.network, terms)).clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS)
        return torch.cat((vectors, encoded_pictures(self.network, self.encoders, terms)), dim=1)


class TermByTerm(nn.Module):
    """A module of a dictionary as one of its values, in order.

    Args:
        module: takes a dictionary of tensors.
        names: of its values.
    """

    def __init__(self, module: nn.Module, names: Sequence[str]) -> None:
        super().__init__()
        self._module, self._names = module, tuple(names)

    def forward(self, *terms: Tensor) -> Tensor:
        return self._module(dict(zip(self._names, terms, strict=True)))
