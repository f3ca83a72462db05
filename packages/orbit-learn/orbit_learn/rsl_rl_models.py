"""Parts of RSL-RL's models: one that sees a dictionary of terms, pictures among them, as ORBIT's own network does, and
statistics of observations that go on from those of a policy.
"""  # fmt: skip

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from tensordict import TensorDict
from torch import Tensor

from orbit_learn.convolutional import MOST_DEVIATIONS, Convolutional, encoded_pictures, joined_vectors


class PictureModel(MLPModel):
    """RSL-RL's model of linear layers, behind the encoders of a network ``convolutional``.

    RSL-RL's own CNNModel takes one floating-point picture a camera, channels first; this one keeps colours as uint8
    until it sees them, so that the steps that are remembered take a fourth of the memory.

    Args:
        obs: an example.
        obs_groups: names of the tensors of each set, ``<group>/<term>``.
        obs_set: "actor" or "critic".
        output_dim: components of the output.
        network: of the group's terms.
        settings: of the linear layers, as RSL-RL has them.
    """

    def __init__(
        self,
        obs: TensorDict,
        obs_groups: dict[str, list[str]],
        obs_set: str,
        output_dim: int,
        network: Convolutional,
        **settings: Any,
    ) -> None:
        self.network: Convolutional
        object.__setattr__(self, "network", network)  # which the base class asks for before it is a module
        self._prefix = obs_groups[obs_set][0].partition("/")[0] + "/"
        super().__init__(obs, obs_groups, obs_set, output_dim, **settings)
        self.encoders = network.build_encoders()

    def get_latent(self, obs: TensorDict, masks: Tensor | None = None, hidden_state: Any = None) -> Tensor:
        terms = self._terms(obs)
        vectors = self.obs_normalizer(joined_vectors(self.network, terms)).clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS)
        return torch.cat((vectors, encoded_pictures(self.network, self.encoders, terms)), dim=-1)

    def update_normalization(self, obs: TensorDict) -> None:
        if self.obs_normalization:
            self.obs_normalizer.update(joined_vectors(self.network, self._terms(obs)))  # pyright: ignore[reportCallIssue]

    def _terms(self, obs: TensorDict) -> dict[str, Tensor]:
        return {name: obs[self._prefix + name] for name in self._names}

    @property
    def _names(self) -> list[str]:
        pictures = [picture.term for encoder in self.network.encoders for picture in encoder.pictures]
        return [*pictures, *(part.name for part in self.network.vectors)]

    def _get_obs_dim(self, obs: TensorDict, obs_groups: dict[str, list[str]], obs_set: str) -> tuple[list[str], int]:
        return obs_groups[obs_set], self.network.vector_size

    def _get_latent_dim(self) -> int:
        return self.obs_dim + self.network.features


class PartlyKnown(EmpiricalNormalization):
    """Statistics of observations of which some stay, for a policy's layers were learned with them.

    Others, of what the policy did not see, follow from what is shown from now on.

    Args:
        mean: (size,) at first.
        std: (size,) at first, with ``eps`` in it.
        known: components that stay as they are.
        weight: how many observations those at first count for.
    """

    count: Tensor
    _mean: Tensor
    _var: Tensor
    _std: Tensor

    def __init__(self, mean: Tensor, std: Tensor, known: Sequence[int], weight: int) -> None:
        super().__init__(len(mean))
        self.count.fill_(weight)
        self._known = list(known)
        self._mean.copy_(mean)
        self._std.copy_((std - self.eps).clamp_min(0.0))
        self._var.copy_(self._std.square())

    def update(self, x: Tensor) -> None:
        known = self._mean[:, self._known], self._var[:, self._known], self._std[:, self._known]
        super().update(x)
        self._mean[:, self._known], self._var[:, self._known], self._std[:, self._known] = known
