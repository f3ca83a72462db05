"""One observation group as TorchRL's actor or critic reads it."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn
from torchrl.data import Composite, Unbounded

from orbit_core.envs.observation_layout import GroupLayout
from orbit_core.envs.ppo import PpoSettings
from orbit_learn.convolutional import convolutional, convolutional_actor, joined_vectors
from orbit_learn.description import group_parts
from orbit_learn.networks import ActorNetwork, perceptron, perceptron_actor
from orbit_learn.picture_features import PictureFeatures


class ObservedGroup:
    """A group's keys, its statistics, and the networks that see it.

    Args:
        layout: of the group.
        settings: of the learning.
        device: where it is learned.
    """

    def __init__(self, layout: GroupLayout, settings: PpoSettings, device: torch.device) -> None:
        self._layout, self._hidden, self._device = layout, settings.hidden_sizes, device
        self._network = None if layout.concatenated else convolutional(group_parts(layout), settings.hidden_sizes)
        self._size = layout.size if self._network is None else self._network.vector_size
        self._norm: Normalization | None = None
        if settings.normalize_observations and self._size > 0:
            self._norm = Normalization(self._size, momentum=None, affine=False, device=device).eval()

    @property
    def keys(self) -> list[NestedKey]:
        """Keys of the group's tensors."""
        name = self._layout.name
        return [name] if self._network is None else [(name, term) for term in self._layout.terms]

    def network(self, outputs: int) -> nn.Module:
        """Tensors in the order of :attr:`keys` -> (..., outputs). All share this group's statistics."""
        if self._network is None:
            normalize = nn.Identity() if self._norm is None else self._norm
            return nn.Sequential(normalize, perceptron(self._size, self._hidden, outputs).to(self._device))
        features = PictureFeatures(self._network, self._norm)
        layers = perceptron(features.size, self._hidden, outputs)
        return TermLayers(self._layout, features, layers).to(self._device)

    def take_in(self, batch: TensorDictBase) -> None:
        """Add a batch (M,) to the statistics."""
        if self._norm is None:
            return
        seen: Any = batch[self._layout.name]
        self._norm.train()(seen if self._network is None else joined_vectors(self._network, seen))
        self._norm.eval()

    def actor(self, built: nn.Module) -> ActorNetwork:
        """ORBIT's own copy of what :meth:`network` built."""
        mean, std = None, None
        if self._norm is not None and self._norm.running_mean is not None and self._norm.running_var is not None:
            mean, std = self._norm.running_mean, (self._norm.running_var + self._norm.eps).sqrt()
        if not isinstance(built, TermLayers):
            return perceptron_actor(built, mean, std)
        return convolutional_actor(built.features.network, built.features.encoders, built.layers, mean, std)


class TermLayers(nn.Module):
    """Encoders and linear layers, over any leading dimensions, for TorchRL values whole rollouts at once.

    Args:
        layout: of the group whose terms it takes, one by one.
        features: of the terms.
        layers: behind them.
    """

    def __init__(self, layout: GroupLayout, features: PictureFeatures, layers: nn.Sequential) -> None:
        super().__init__()
        self._dims = {name: len(term.shape) for name, term in layout.terms.items()}
        self.features, self.layers = features, layers

    def forward(self, *terms: Tensor) -> Tensor:
        leading = terms[0].shape[: terms[0].dim() - next(iter(self._dims.values()))]
        last = len(leading) - 1
        rows = {name: term.flatten(0, last) for name, term in zip(self._dims, terms, strict=True)}
        return self.layers(self.features(rows)).unflatten(0, leading)


class Normalization(nn.BatchNorm1d):
    """Normalise by the mean and variance of all batches so far, which weigh the same; over any leading dimensions."""

    def forward(self, input: Tensor) -> Tensor:
        return super().forward(input.reshape(-1, self.num_features)).view_as(input)


def group_spec(layout: GroupLayout, count: int, device: torch.device) -> Composite | Unbounded:
    """Specification of the group of so many environments: one tensor, or its terms with their dtypes."""
    if layout.concatenated:
        return Unbounded(torch.Size((count, layout.size)), device=device)
    terms = {
        name: Unbounded(torch.Size((count, *term.shape)), device=device, dtype=term.dtype)
        for name, term in layout.terms.items()
    }
    return Composite(terms, shape=torch.Size([count]), device=device)
