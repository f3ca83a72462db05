"""Actor and critic for skrl, of one flattened observation group each, with pictures or without."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.resources.preprocessors.torch import RunningStandardScaler
from skrl.utils.spaces.torch import unflatten_tensorized_space
from torch import Tensor, nn

from orbit_core.envs.observation_layout import GroupLayout
from orbit_learn.convolutional import MOST_DEVIATIONS, convolutional
from orbit_learn.description import Part, group_parts
from orbit_learn.networks import perceptron
from orbit_learn.picture_features import PictureFeatures
from orbit_learn.spaces import group_space


class GroupModel(Model):
    """Linear layers, behind encoders where the group is a dictionary.

    Args:
        layout: of the group.
        hidden: units of the hidden layers.
        outputs: components of the output.
        spaces: and device, as skrl's models take them.
    """

    def __init__(self, layout: GroupLayout, hidden: Sequence[int], outputs: int, **spaces: Any) -> None:
        Model.__init__(self, **spaces)
        self._space = group_space(layout)
        self.features = None
        if not layout.concatenated:
            self.features = PictureFeatures(convolutional(group_parts(layout), hidden))
        self.layers = perceptron(layout.size if self.features is None else self.features.size, hidden, outputs)

    def output(self, seen: Tensor) -> Tensor:
        """(N, outputs) of a group as skrl flattens it, (N, K)."""
        if self.features is None:
            return self.layers(seen)
        return self.layers(self.features(unflatten_tensorized_space(self._space, seen)))


class Actor(GaussianMixin, GroupModel):
    """Normal about the output, with a deviation that is learned but no function of the observation."""

    def __init__(self, layout: GroupLayout, hidden: Sequence[int], initial_std: float, **spaces: Any) -> None:
        actions = spaces["action_space"].shape[0]
        GroupModel.__init__(self, layout, hidden, actions, **spaces)
        GaussianMixin.__init__(self)
        self.log_std = nn.Parameter(torch.full((actions,), math.log(initial_std)))

    def compute(  # pyright: ignore[reportIncompatibleMethodOverride] - its mixins give the role by position
        self, inputs: dict[str, Any], role: str = ""
    ) -> tuple[Tensor, dict[str, Any]]:
        return self.output(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, GroupModel):
    """The worth of skrl's state where there is one, else of the observation."""

    def __init__(self, layout: GroupLayout, hidden: Sequence[int], **spaces: Any) -> None:
        GroupModel.__init__(self, layout, hidden, 1, **spaces)
        DeterministicMixin.__init__(self)
        self._seen = "observations" if self.state_space is None else "states"

    def compute(  # pyright: ignore[reportIncompatibleMethodOverride] - its mixins give the role by position
        self, inputs: dict[str, Any], role: str = ""
    ) -> tuple[Tensor, dict[str, Any]]:
        return self.output(inputs[self._seen]), {}


class VectorScaler(RunningStandardScaler):
    """Standardises the vectors of a flattened dictionary, and leaves its pictures as they are.

    Its mean and variance are those of the vectors side by side, in the order of the group's terms.

    Args:
        size: layout of the group, by the name that skrl's configuration gives it.
        device: where the statistics live.
    """

    columns: Tensor

    def __init__(self, size: GroupLayout, *, device: torch.device) -> None:
        parts = group_parts(size)
        begins = _begins(parts)
        columns = [begins[part.name] + i for part in parts if not part.is_picture for i in range(part.size)]
        super().__init__(len(columns), clip_threshold=MOST_DEVIATIONS, device=device)
        self.register_buffer("columns", torch.tensor(columns, dtype=torch.long, device=device), persistent=False)

    def forward(
        self, x: Tensor | None, *, train: bool = False, inverse: bool = False, no_grad: bool = True
    ) -> Tensor | None:
        if x is None:
            return None
        vectors = super().forward(x[:, self.columns], train=train, inverse=inverse, no_grad=no_grad)
        assert vectors is not None
        return x.index_copy(1, self.columns, vectors)


def _begins(parts: Sequence[Part]) -> dict[str, int]:
    """First column of each term: skrl flattens dictionaries in the order of their names."""
    begins: dict[str, int] = {}
    end = 0
    for part in sorted(parts, key=lambda part: part.name):
        begins[part.name] = end
        end += part.size
    return begins
