"""Interface of policies' networks, and the network ``perceptron``: linear layers behind a normalised observation."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

import torch
from torch import Tensor, nn

from orbit_core.interfaces import UnknownNameError

_ACTIVATIONS: dict[str, type[nn.Module]] = {"elu": nn.ELU, "relu": nn.ReLU, "tanh": nn.Tanh}
_MOST_LAYERS, _MOST_UNITS = 64, 2**16


def activation_type(name: str) -> type[nn.Module]:
    """Return an activation by name.

    Raises:
        UnknownNameError: no activation has the name.
    """
    if name not in _ACTIVATIONS:
        raise UnknownNameError("activation", name, _ACTIVATIONS)
    return _ACTIVATIONS[name]


class Network(Protocol):
    """Settings of a network: a frozen dataclass that :func:`~orbit_core.configuration.from_plain` can read."""

    name: ClassVar[str]
    """Name of the network in files."""

    def build(self, observation_size: int, action_size: int) -> nn.Module:
        """Return the module that maps an observation to an action (N, A) in [-1, 1], for any N.

        The observation is that of the policy's group: one tensor (N, O), or a dictionary of its terms.

        The complete state of the module is its ``state_dict``, in float32, which is loaded after building. Building
        must not depend on values of tensors, because it also runs on torch's ``meta`` device.
        """
        ...


class ActorNetwork(NamedTuple):
    """Network with the module that it built."""

    network: Network
    module: nn.Module


@dataclass(frozen=True)
class Perceptron:
    """Network of linear layers that see the observation in standard deviations from its mean."""

    name: ClassVar[str] = "perceptron"
    hidden_sizes: tuple[int, ...]
    """Units of the hidden layers."""
    activation: str = "elu"
    """Activation between layers: elu, relu or tanh."""
    observation_limit: float | None = None
    """Limit of the observation in standard deviations from the mean; unlimited if None."""

    def __post_init__(self) -> None:
        activation_type(self.activation)
        if len(self.hidden_sizes) > _MOST_LAYERS or not all(0 < size <= _MOST_UNITS for size in self.hidden_sizes):
            raise ValueError(f"it has up to {_MOST_LAYERS} hidden layers of 1 to {_MOST_UNITS} units each")
        if self.observation_limit is not None and self.observation_limit <= 0.0:
            raise ValueError(f"observation_limit is positive, not {self.observation_limit}")

    def build(self, observation_size: int, action_size: int) -> nn.Module:
        """Return the actor; the observation's mean and deviation are zero and one until they are loaded."""
        layers = perceptron(observation_size, self.hidden_sizes, action_size, activation_type(self.activation))
        return NormalizedActor(layers, observation_size, self.observation_limit)


class NormalizedActor(nn.Module):
    """Actor of :class:`Perceptron`, from an observation (N, O) to an action (N, A), clipped to [-1, 1].

    Args:
        layers: layers from a normalised observation (N, O) to an action (N, A).
        observation_size: number O of the observation's components.
        limit: limit of the normalised observation's components; unlimited if None.
    """

    mean: Tensor
    """Means (O,) of the observations in training."""
    std: Tensor
    """Standard deviations (O,) of the same."""

    def __init__(self, layers: nn.Sequential, observation_size: int, limit: float | None) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(observation_size))
        self.register_buffer("std", torch.ones(observation_size))
        self.limit = limit
        self.layers = layers

    def forward(self, observation: Tensor) -> Tensor:
        return self.unclipped(observation).clamp(-1.0, 1.0)

    def vectors(self, observation: Tensor) -> Tensor:
        """Return the observation (N, O), of which ``mean`` and ``std`` are."""
        return observation

    def unclipped(self, observation: Tensor) -> Tensor:
        """Compute the action (N, A) before clipping, for learning."""
        return self.layers(self.encode(observation))

    def encode(self, observation: Tensor) -> Tensor:
        """Normalise the observation to the layers' input (N, O)."""
        seen = (observation - self.mean) / self.std
        return seen if self.limit is None else seen.clamp(-self.limit, self.limit)


def perceptron(inputs: int, hidden: Sequence[int], outputs: int, activation: type[nn.Module] = nn.ELU) -> nn.Sequential:
    """Return linear layers with activations between them."""
    sizes = [inputs, *hidden]
    layers: list[nn.Module] = []
    for taken, given in itertools.pairwise(sizes):
        layers += [nn.Linear(taken, given), activation()]
    return nn.Sequential(*layers, nn.Linear(sizes[-1], outputs))


def perceptron_actor(
    layers: nn.Module, mean: Tensor | None = None, std: Tensor | None = None, limit: float | None = None
) -> ActorNetwork:
    """Return a copy on the CPU of a library's actor that is a perceptron with exponential linear units.

    Args:
        layers: module with the linear layers, in their order.
        mean: means (O,) of the observation; zero if None.
        std: standard deviations (O,) of the observation; one if None.
        limit: limit as :attr:`Perceptron.observation_limit`.
    """
    # Libraries wrap the layers differently; their order is the same everywhere.
    linear = [layer for layer in layers.modules() if isinstance(layer, nn.Linear)]
    network = Perceptron(tuple(layer.out_features for layer in linear[:-1]), observation_limit=limit)
    size = linear[0].in_features
    with torch.device("meta"):  # without drawing starting weights, which would move the training's random stream
        module = network.build(size, linear[-1].out_features)
    weights = layer_weights(layers)
    weights["mean"] = torch.zeros(size) if mean is None else mean.reshape(-1)
    weights["std"] = torch.ones(size) if std is None else std.reshape(-1)
    copies = {name: value.detach().float().cpu().clone() for name, value in weights.items()}
    module.load_state_dict(copies, assign=True)
    return ActorNetwork(network, module.requires_grad_(False).eval())


def layer_weights(layers: nn.Module) -> dict[str, Tensor]:
    """Return the weights of the linear layers, with the names that :func:`perceptron` gives them as ``layers``."""
    linear = [layer for layer in layers.modules() if isinstance(layer, nn.Linear)]
    # The activations are between them, at the odd places.
    return {
        f"layers.{2 * i}.{name}": value for i, layer in enumerate(linear) for name, value in layer.state_dict().items()
    }
