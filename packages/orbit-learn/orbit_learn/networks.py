"""Interface of policies' networks, and the network ``perceptron``: linear layers behind a normalised observation."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

import torch
from torch import Tensor, nn

from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_learn.description import Part
from orbit_learn.picture_layers import PlaceEncoder

_ACTIVATIONS: dict[str, type[nn.Module]] = {"elu": nn.ELU, "relu": nn.ReLU, "tanh": nn.Tanh}
# The network ``convolutional``: pictures through convolutions, joined with vectors, into linear layers.
# Convolutions with strides in place of pooling keep positions in the picture, as in Mnih et al., Human-level control
# through deep reinforcement learning (2015), which policies that reach for objects need. Learning libraries may put
# their own layers behind the encoders.

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
    """Settings that built the module."""
    module: nn.Module
    """Module from an observation to an action."""


@dataclass(frozen=True)
class Perceptron:
    """Network of linear layers that see the observation in standard deviations from its mean."""

    name: ClassVar[str] = "perceptron"
    """Word for this kind in policy files."""
    hidden_sizes: tuple[int, ...]
    """Units of the hidden layers."""
    activation: str = "elu"
    """Activation between layers: elu, relu or tanh."""
    observation_limit: float | None = None
    """Limit of the observation in standard deviations from the mean; unlimited if None."""
    squashed: bool = False
    """Whether the hyperbolic tangent bounds the action, as off-policy algorithms learn it; else it is clipped."""

    def __post_init__(self) -> None:
        activation_type(self.activation)
        if len(self.hidden_sizes) > _MOST_LAYERS or not all(0 < size <= _MOST_UNITS for size in self.hidden_sizes):
            raise ValueError(f"it has up to {_MOST_LAYERS} hidden layers of 1 to {_MOST_UNITS} units each")
        if self.observation_limit is not None and self.observation_limit <= 0.0:
            raise ValueError(f"observation_limit is positive, not {self.observation_limit}")

    def build(self, observation_size: int, action_size: int) -> nn.Module:
        """Return the actor; the observation's mean and deviation are zero and one until they are loaded."""
        layers = perceptron(observation_size, self.hidden_sizes, action_size, activation_type(self.activation))
        return NormalizedActor(layers, observation_size, self.observation_limit, self.squashed)


class NormalizedActor(nn.Module):
    """Actor of :class:`Perceptron`, from an observation (N, O) to an action (N, A) in [-1, 1].

    Args:
        layers: layers from a normalised observation (N, O) to an action (N, A).
        observation_size: number O of the observation's components.
        limit: limit of the normalised observation's components; unlimited if None.
        squashed: whether tanh bounds the action; else it is clipped.
    """

    mean: Tensor
    """Means (O,) of the observations in training."""
    std: Tensor
    """Standard deviations (O,) of the same."""

    def __init__(
        self, layers: nn.Sequential, observation_size: int, limit: float | None, squashed: bool = False
    ) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(observation_size))
        self.register_buffer("std", torch.ones(observation_size))
        self.limit, self.squashed = limit, squashed
        self.layers = layers

    def forward(self, observation: Tensor) -> Tensor:
        unbounded = self.unclipped(observation)
        return torch.tanh(unbounded) if self.squashed else unbounded.clamp(-1.0, 1.0)

    def vectors(self, observation: Tensor) -> Tensor:
        """Return the observation (N, O), of which ``mean`` and ``std`` are."""
        return observation

    def unclipped(self, observation: Tensor) -> Tensor:
        """Compute the action (N, A) before it is bounded, for learning."""
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
    layers: nn.Module,
    mean: Tensor | None = None,
    std: Tensor | None = None,
    limit: float | None = None,
    squashed: bool = False,
) -> ActorNetwork:
    """Return a copy on the CPU of a library's actor that is a perceptron with exponential linear units.

    Args:
        layers: module with the linear layers, in their order.
        mean: means (O,) of the observation; zero if None.
        std: standard deviations (O,) of the observation; one if None.
        limit: limit as :attr:`Perceptron.observation_limit`.
        squashed: whether tanh bounds the action.
    """
    # Libraries wrap the layers differently; their order is the same everywhere.
    linear = [layer for layer in layers.modules() if isinstance(layer, nn.Linear)]
    sizes = tuple(layer.out_features for layer in linear[:-1])
    network = Perceptron(sizes, observation_limit=limit, squashed=squashed)
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


class PictureFeatures(nn.Module):
    """Encoder of a dictionary of terms (N, ...) to the input (N, K) of the network's linear layers.

    Args:
        network: network of the terms.
        normalize: normalisation of the concatenated vectors (N, V); None if the library has normalised them already.
    """

    def __init__(self, network: Convolutional, normalize: nn.Module | None = None) -> None:
        super().__init__()
        self.network = network
        self.normalize = nn.Identity() if normalize is None else normalize
        self.encoders = network.build_encoders()
        """Convolutions of each set of pictures."""

    @property
    def size(self) -> int:
        """Number K of outputs."""
        return self.network.vector_size + self.network.features

    def forward(self, terms: Mapping[str, Tensor]) -> Tensor:
        vectors = self.normalize(joined_vectors(self.network, terms)).clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS)
        return torch.cat((vectors, encoded_pictures(self.network, self.encoders, terms)), dim=1)


class TermByTerm(nn.Module):
    """Adapter of a module of a dictionary, which takes the dictionary's values in order.

    Args:
        module: module that takes a dictionary of tensors.
        names: names of the values.
    """

    def __init__(self, module: nn.Module, names: Sequence[str]) -> None:
        super().__init__()
        self._module, self._names = module, tuple(names)

    def forward(self, *terms: Tensor) -> Tensor:
        return self._module(dict(zip(self._names, terms, strict=True)))


_MOST_PIXELS, _MOST_FILTERS, _MOST_FEATURES = 2**22, 4096, 2**16
MOST_DEVIATIONS = 10.0
"""Limit of vectors in standard deviations: a joint that is hit moves faster than any in the training data."""


@dataclass(frozen=True)
class Picture:
    """Term that is a picture (N, H, W, C)."""

    term: str
    """Name of the observation term."""
    channels: int
    """Number C of channels."""
    far: float | None = None
    """Value that becomes 1, in metres for depth; more is clipped. None: the picture is uint8, and 255 becomes 1."""
    near: float = 0.0
    """Value that becomes 0; less is clipped."""

    def __post_init__(self) -> None:
        if not 0 < self.channels <= _MOST_FILTERS:
            raise ValueError(f"picture '{self.term}' has 1 to {_MOST_FILTERS} channels, not {self.channels}")
        if self.far is not None and not self.near < self.far < math.inf:
            raise ValueError(f"far of picture '{self.term}' is finite and above {self.near:g}, not {self.far}")


@dataclass(frozen=True)
class PictureEncoder:
    """Encoder of pictures: convolutions, each of which halves the size, and a linear layer."""

    pictures: tuple[Picture, ...]
    """Pictures of equal height and width, which become the channels of one picture."""
    height: int
    """Rows of the pictures."""
    width: int
    """Columns of the pictures."""
    filters: tuple[int, ...] = (32, 64, 64)
    """Channels of each convolution: the first is 5 x 5 pixels wide, the others are 3 x 3."""
    features: int = 128
    """Units of the linear layer."""
    places: int = 0
    """Maps whose mean places are features as well, from residual blocks with ``filters`` as their channels
    (:class:`~orbit_learn.picture_layers.PlaceEncoder`); 0 for plain convolutions."""

    def __post_init__(self) -> None:
        if not 0 <= self.places <= _MOST_FILTERS:
            raise ValueError(f"an encoder has 0 to {_MOST_FILTERS} places, not {self.places}")
        if not self.pictures or not 0 < len(self.filters) <= 8:
            raise ValueError("an encoder has pictures, and 1 to 8 convolutions")
        if not all(0 < count <= _MOST_FILTERS for count in self.filters) or not 0 < self.features <= _MOST_FEATURES:
            raise ValueError(f"an encoder has 1 to {_MOST_FILTERS} filters, and 1 to {_MOST_FEATURES} features")
        if not (self.height > 0 and self.width > 0 and self.height * self.width <= _MOST_PIXELS):
            raise ValueError(f"an encoder's pictures have 1 to {_MOST_PIXELS:,} pixels")

    def build(self, activation: type[nn.Module]) -> nn.Module:
        """Return the module from (N, C, H, W) to (N, features)."""
        layers: list[nn.Module] = []
        taken, height, width = sum(picture.channels for picture in self.pictures), self.height, self.width
        if self.places:
            return PlaceEncoder(taken, height, width, self.filters, self.places, self.features, activation)
        for i, given in enumerate(self.filters):
            # A wide first kernel sees more at almost no cost, because the picture has few channels.
            size = 3 if i else 5
            layers += [nn.Conv2d(taken, given, size, stride=2, padding=size // 2), activation()]
            taken, height, width = given, (height + 1) // 2, (width + 1) // 2
        return nn.Sequential(*layers, nn.Flatten(), nn.Linear(taken * height * width, self.features), activation())


@dataclass(frozen=True)
class Convolutional:
    """Network of a dictionary of terms: pictures pass encoders, vectors are normalised by mean and deviation."""

    name: ClassVar[str] = "convolutional"
    """Word for this kind in policy files."""
    encoders: tuple[PictureEncoder, ...]
    """One encoder for each size of pictures."""
    vectors: tuple[Part, ...]
    """Terms that are not pictures, flattened and concatenated."""
    hidden_sizes: tuple[int, ...]
    """Units of the hidden layers behind them."""
    activation: str = "elu"
    """Activation between layers: elu, relu or tanh."""

    def __post_init__(self) -> None:
        activation_type(self.activation)
        if len(self.hidden_sizes) > 64 or not all(0 < size <= _MOST_FEATURES for size in self.hidden_sizes):
            raise ValueError(f"it has up to 64 hidden layers of 1 to {_MOST_FEATURES} units each")
        if not self.encoders:
            raise ValueError("it has at least one picture; for vectors alone there is the network 'perceptron'")

    @property
    def features(self) -> int:
        """Number of features that the encoders give together."""
        return sum(encoder.features for encoder in self.encoders)

    @property
    def vector_size(self) -> int:
        """Number V of components of all vectors."""
        return sum(part.size for part in self.vectors)

    def build_encoders(self) -> nn.ModuleList:
        """Return one module for each encoder."""
        return nn.ModuleList(encoder.build(activation_type(self.activation)) for encoder in self.encoders)

    def build(self, observation_size: int, action_size: int) -> PictureActor:
        """Return the actor; encoders and vectors determine its input size, so ``observation_size`` is ignored."""
        return PictureActor(self, action_size)


class PictureActor(nn.Module):
    """Actor of :class:`Convolutional`, from a dictionary of terms (N, ...) to an action (N, A), clipped to [-1, 1]."""

    mean: Tensor
    """Means (V,) of the concatenated vectors in training."""
    std: Tensor
    """Standard deviations (V,) of the same."""

    def __init__(self, network: Convolutional, action_size: int) -> None:
        super().__init__()
        activation = activation_type(network.activation)
        size = network.vector_size
        self.network = network
        """Settings that built the module."""
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))
        self.encoders = network.build_encoders()
        """Convolutions of each set of pictures."""
        self.layers = perceptron(size + network.features, network.hidden_sizes, action_size, activation)
        """Linear layers from features and vectors to the action."""

    def forward(self, observation: Mapping[str, Tensor]) -> Tensor:
        return self.unclipped(observation).clamp(-1.0, 1.0)  # the range of every action

    def vectors(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return the concatenated terms (N, V) that are not pictures, of which ``mean`` and ``std`` are."""
        return joined_vectors(self.network, observation)

    def unclipped(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Compute the action (N, A) before clipping, for learning."""
        return self.layers(self.encode(observation))

    def encode(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Compute the input (N, K) of the linear layers."""
        vectors = ((self.vectors(observation) - self.mean) / self.std).clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS)
        return torch.cat((vectors, encoded_pictures(self.network, self.encoders, observation)), dim=1)


def joined_vectors(network: Convolutional, observation: Mapping[str, Tensor]) -> Tensor:
    """Concatenate the terms that are not pictures to (N, V), without normalisation."""
    if not network.vectors:  # torch.cat refuses an empty list
        first = observation[network.encoders[0].pictures[0].term]
        return first.new_zeros((len(first), 0), dtype=torch.float32)
    return torch.cat([observation[part.name].float().flatten(1) for part in network.vectors], dim=1)


def encoded_pictures(network: Convolutional, encoders: nn.ModuleList, observation: Mapping[str, Tensor]) -> Tensor:
    """Encode the pictures to (N, features) by the encoders that the network built."""
    seen = []
    for encoder, layers in zip(network.encoders, encoders, strict=True):
        channels = [_scaled(observation[picture.term], picture) for picture in encoder.pictures]
        # From (N, H, W, C), as cameras draw, to (N, C, H, W). The memory stays in channels-last order, in which
        # convolutions are fastest.
        seen.append(layers(torch.cat(channels, dim=3).permute(0, 3, 1, 2)))
    return torch.cat(seen, dim=1)


def convolutional_actor(
    network: Convolutional,
    encoders: nn.ModuleList,
    layers: nn.Module,
    mean: Tensor | None = None,
    std: Tensor | None = None,
) -> ActorNetwork:
    """Return a copy on the CPU of a library's actor that consists of this network's encoders and linear layers.

    Args:
        network: network that built the encoders.
        encoders: encoders of the pictures.
        layers: module with the linear layers behind them, in their order.
        mean: means (V,) of the vectors; zero if None.
        std: standard deviations (V,) of the vectors; one if None.
    """
    weights = {f"encoders.{name}": value for name, value in encoders.state_dict().items()}
    weights |= layer_weights(layers)
    weights["mean"] = torch.zeros(network.vector_size) if mean is None else mean
    weights["std"] = torch.ones(network.vector_size) if std is None else std
    actions = [layer for layer in layers.modules() if isinstance(layer, nn.Linear)][-1].out_features
    with torch.device("meta"):  # without drawing starting weights, which would move the training's random stream
        module = network.build(0, actions)
    copies = {name: value.detach().float().cpu().clone() for name, value in weights.items()}
    module.load_state_dict(copies, assign=True)
    return ActorNetwork(network, module.requires_grad_(False).eval())


def convolutional(parts: Sequence[Part], hidden_sizes: Sequence[int]) -> Convolutional:
    """Return the network for a group of such terms.

    uint8 terms (N, H, W, C) are colours, and floating-point ones, such as depth in metres, are scaled from their bounds
    to [0, 1]. Terms of one camera and size are the channels of one picture.

    Args:
        parts: terms of the group.
        hidden_sizes: units of the layers behind the encoders.

    Raises:
        ConfigurationError: a picture is neither colour nor depth, has no bounds, or there is none.
    """
    # By camera and size: colours and depth of one camera are aligned, so that one encoder can compare them.
    cameras: dict[tuple[str | None, str, int, int], list[Picture]] = {}
    for part in parts:
        if not part.is_picture:
            continue
        assert part.shape is not None
        height, width, channels = part.shape
        if part.dtype not in ("uint8", "float32"):
            raise ConfigurationError(
                f"observation '{part.name}' is a picture of {part.dtype}: the network 'convolutional' takes colours "
                "(uint8) and depth (float32); give segmentation as one picture of 0 and 1 for each label"
            )
        key = (part.camera, "" if part.camera else part.name, height, width)
        cameras.setdefault(key, []).append(_picture(part, channels))
    if not cameras:
        raise ConfigurationError(
            f"a dictionary of terms without pictures ({', '.join(part.name for part in parts)}) needs no convolutions: "
            "give the observation group concatenate=True"
        )
    encoders = tuple(PictureEncoder(tuple(seen), height, width) for (*_, height, width), seen in cameras.items())
    return Convolutional(encoders, tuple(part for part in parts if not part.is_picture), tuple(hidden_sizes))


def _picture(part: Part, channels: int) -> Picture:
    if part.dtype == "uint8":
        return Picture(part.name, channels)
    if part.low is None or part.high is None:
        raise ConfigurationError(
            f"observation '{part.name}' is a picture of {part.dtype} without bounds: give its term bounds=(least, "
            "most), which the network scales to 0 and 1, as orbit_core.mdp.sensing.camera_depth does"
        )
    return Picture(part.name, channels, part.high, part.low)


def _scaled(value: Tensor, picture: Picture) -> Tensor:
    """Scale a picture (N, H, W, C) to [0, 1]."""
    if picture.far is None:
        return value.float() / 255.0
    return (value.float().clamp(picture.near, picture.far) - picture.near) / (picture.far - picture.near)
