"""Observation groups as Stable-Baselines3 takes them: one array, or a dictionary of arrays with pictures among them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor

from orbit_core.envs.observation_layout import GroupLayout
from orbit_learn.convolutional import Convolutional
from orbit_learn.description import group_parts
from orbit_learn.picture_features import PictureFeatures
from orbit_learn.spaces import group_space

Seen = npt.NDArray[Any] | dict[str, npt.NDArray[Any]]
"""A group: one array, or its terms by name."""


class PicturePpo(PPO):
    """PPO that leaves pictures (H, W, C), as its :class:`PictureExtractor` reads them."""

    @staticmethod
    def _wrap_env(env: Any, verbose: int = 0, monitor_wrapper: bool = True) -> VecEnv:
        return env


class PictureExtractor(BaseFeaturesExtractor):
    """The features extractor of ``MultiInputPolicy`` that reads what ORBIT's network ``convolutional`` reads.

    Args:
        observation_space: of the group.
        network: of the group's terms.
    """

    def __init__(self, observation_space: spaces.Dict, network: Convolutional) -> None:
        features = PictureFeatures(network)
        super().__init__(observation_space, features.size)
        self.features = features

    def forward(self, terms: dict[str, Tensor]) -> Tensor:
        return self.features(terms)


def observed_space(layout: GroupLayout) -> spaces.Space[Any]:
    """Space of a group: pictures as they are, all else unbounded float32, which is normalised."""
    if layout.concatenated:
        return spaces.Box(-np.inf, np.inf, (layout.size,), np.float32)
    whole: Any = group_space(layout)
    return spaces.Dict(
        {
            part.name: whole[part.name] if part.is_picture else spaces.Box(-np.inf, np.inf, part.shape, np.float32)
            for part in group_parts(layout)
        }
    )


def seen_arrays(group: Tensor | Mapping[str, Tensor]) -> Seen:
    """Return a group on the host, of the dtypes of :func:`observed_space`."""
    if isinstance(group, Tensor):
        return array_of(group)
    return {name: array_of(value if value.dim() == 4 else value.float()) for name, value in group.items()}


def row_of(seen: Seen, row: int) -> Seen:
    """What one environment sees."""
    return {name: values[row] for name, values in seen.items()} if isinstance(seen, dict) else seen[row]


def array_of(values: Tensor) -> npt.NDArray[Any]:
    """Return a copy on the host."""
    return values.cpu().numpy().copy()
