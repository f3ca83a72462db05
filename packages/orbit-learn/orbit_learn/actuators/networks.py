"""Learned actuator models: networks that compute a joint's effort from its position error, velocity, and their past.

Two architectures, as published for the series-elastic ANYdrive: a perceptron that sees the present and some earlier
steps (Hwangbo et al., Learning Agile and Dynamic Motor Skills for Legged Robots, 2019), and a recurrent network of long
short-term memory that sees the present alone and remembers (Rudin et al., Learning to Walk in Minutes Using Massively
Parallel Deep Reinforcement Learning, 2021). One network serves all joints of a kind, each with its own past.

A file contains the weights as safetensors and, as JSON in the header, a :class:`NetworkDescription`; reading it
executes no code.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import torch
from torch import Tensor, nn

from orbit_core.interfaces import ConfigurationError
from orbit_data.tensor_file import read_tensors, write_tensors
from orbit_learn.actuators.recordings import Recording, common_rate

_MOST_UNITS, _MOST_LAYERS, _MOST_HISTORY = 1024, 8, 64
# Number of inputs of a step: position error and velocity.
_INPUTS = 2
# Relative difference of rates that counts as none.
_RATE_TOLERANCE = 1e-4


@dataclass(frozen=True, kw_only=True)
class NetworkDescription:
    """Description of an actuator network, and of the data that it was fitted to."""

    kind: Literal["mlp", "lstm"]
    """Perceptron over a few steps, or long short-term memory."""
    hidden_sizes: tuple[int, ...]
    """Units of the hidden layers; equal in all layers of an LSTM."""
    history: tuple[int, ...] = (0,)
    """Steps back that a perceptron sees, from 0, the present."""
    rate: float
    """Rate in Hz at which the network was fitted, and is evaluated."""
    unit: Literal["rad", "m"] = "rad"
    """Unit of the joints' positions."""
    scales: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Scales of error (rad or m), velocity (rad/s or m/s) and effort (N m or N), which are divided by them."""
    fitted_to: tuple[str, ...] = ()
    """Names of the joints in the recordings."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            ConfigurationError: a number is out of its range.
        """
        sizes, history = self.hidden_sizes, self.history
        if not (1 <= len(sizes) <= _MOST_LAYERS and all(1 <= size <= _MOST_UNITS for size in sizes)):
            raise ConfigurationError(
                f"hidden_sizes are {sizes}: give 1 to {_MOST_LAYERS} layers of 1 to {_MOST_UNITS} units"
            )
        if self.kind == "lstm" and (len({*sizes}) > 1 or history != (0,)):
            raise ConfigurationError(f"an LSTM has layers of one size and no history, not {sizes} and {history}")
        # The present first and each step once: the network's inputs are numbered by this list.
        if history[:1] != (0,) or list(history) != sorted({*history}) or history[-1] > _MOST_HISTORY:
            raise ConfigurationError(
                f"history is {history}: give steps back from 0 on, rising, {_MOST_HISTORY} at most"
            )
        if not (0.0 < self.rate < 1e6 and all(0.0 < scale < 1e9 for scale in self.scales)):
            raise ConfigurationError(f"rate {self.rate:g} Hz and scales {self.scales} must be above zero and finite")

    def build(self) -> ActuatorModule:
        """Return the network with new weights."""
        return MlpActuator(self) if self.kind == "mlp" else LstmActuator(self)


class ActuatorModule(nn.Module, ABC):
    """Network for B joints, whose past is one tensor (*past_shape, B, ...), initially zero."""

    def __init__(self, description: NetworkDescription) -> None:
        super().__init__()
        self.description = description
        """Layers, rate and scales of the network."""
        self._in: Tensor
        # Not among the weights of a file, whose description has the scales already.
        self.register_buffer("_in", torch.tensor(description.scales[:2]), persistent=False)

    @abstractmethod
    def past(self, joints: int, device: torch.device) -> Tensor:
        """Return the initial past of B joints; joints are its second dimension."""

    @abstractmethod
    def step(self, inputs: Tensor, past: Tensor) -> tuple[Tensor, Tensor]:
        """Return efforts (B,) from errors and velocities (B, 2), and the next past."""

    @abstractmethod
    def sequence(self, inputs: Tensor) -> Tensor:
        """Return efforts (T, B) of B joints over T steps (T, B, 2) that begin without a past."""


class MlpActuator(ActuatorModule):
    """Perceptron with softsign units. Steps before the first are assumed to equal it."""

    def __init__(self, description: NetworkDescription) -> None:
        super().__init__(description)
        sizes = (_INPUTS * len(description.history), *description.hidden_sizes)
        layers = [layer for a, b in itertools.pairwise(sizes) for layer in (nn.Linear(a, b), nn.Softsign())]
        self.layers = nn.Sequential(*layers, nn.Linear(sizes[-1], 1))
        """Linear layers from errors and velocities of the history to the effort."""
        self._depth = description.history[-1]

    def past(self, joints: int, device: torch.device) -> Tensor:
        """Return the initial past (steps, B, 3): error, velocity, and 1 where they were measured."""
        return torch.zeros(self._depth, joints, _INPUTS + 1, device=device)

    def step(self, inputs: Tensor, past: Tensor) -> tuple[Tensor, Tensor]:
        newest = torch.cat((inputs, torch.ones_like(inputs[:, :1])), 1)[None]
        # Steps before the first measurement equal the newest, so that an episode does not begin with a jump.
        known = torch.where(past[..., 2:] > 0.0, past, newest)
        line = torch.cat((newest, known))
        seen = torch.cat([line[back, :, :_INPUTS] for back in self.description.history], 1)
        # The oldest step drops out, so that the past keeps its length.
        return self.efforts(seen), line[: self._depth]

    def sequence(self, inputs: Tensor) -> Tensor:
        line = torch.cat((inputs[:1].expand(self._depth, -1, -1), inputs))
        last = len(line) - self._depth
        seen = [line[self._depth - back : self._depth - back + last] for back in self.description.history]
        return self.efforts(torch.cat(seen, 2).flatten(0, 1)).view(inputs.shape[:2])

    def efforts(self, seen: Tensor) -> Tensor:
        """Compute efforts (B,) from the present and past inputs (B, 2 H)."""
        scaled = seen / self._in.repeat(len(self.description.history))
        return self.layers(scaled).squeeze(1) * self.description.scales[2]


class LstmActuator(ActuatorModule):
    """Layers of long short-term memory (Hochreiter and Schmidhuber, 1997), then a linear one."""

    def __init__(self, description: NetworkDescription) -> None:
        super().__init__(description)
        self._layers, self._units = len(description.hidden_sizes), description.hidden_sizes[0]
        self.memory = nn.LSTM(_INPUTS, self._units, self._layers)
        """Recurrent layers over error and velocity."""
        self.out = nn.Linear(self._units, 1)
        """Linear layer to the effort."""

    def past(self, joints: int, device: torch.device) -> Tensor:
        """Return the initial past (2 layers, B, units): hidden states, then cell states."""
        return torch.zeros(2 * self._layers, joints, self._units, device=device)

    def step(self, inputs: Tensor, past: Tensor) -> tuple[Tensor, Tensor]:
        # Written out, because a captured step needs plain operations; the weights are those of torch's module.
        value, hidden, cells = inputs / self._in, [], []
        for layer in range(self._layers):
            weight = [
                getattr(self.memory, f"{name}_l{layer}") for name in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
            ]
            gates = torch.addmm(weight[2] + weight[3], value, weight[0].T) + past[layer] @ weight[1].T
            enter, forget, candidate, leave = gates.chunk(4, 1)
            kept = forget.sigmoid() * past[self._layers + layer]
            cells.append(kept + enter.sigmoid() * candidate.tanh())
            value = leave.sigmoid() * cells[-1].tanh()
            hidden.append(value)
        return self.out(value).squeeze(1) * self.description.scales[2], torch.stack((*hidden, *cells))

    def sequence(self, inputs: Tensor) -> Tensor:
        return self.out(self.memory(inputs / self._in)[0]).squeeze(2) * self.description.scales[2]


def write_network(path: Path | str, network: ActuatorModule) -> None:
    """Write a network for :func:`read_network`.

    Raises:
        StorageError: the disk is full, or the folder cannot be written.
    """
    document = {"format": 1, "actuator": asdict(network.description)}
    write_tensors(path, document, network.state_dict())


def read_network(path: Path | str) -> ActuatorModule:
    """Return a network from its file.

    Raises:
        ConfigurationError: the file does not exist, contains no actuator network, or its weights do not have the sizes
            of its description.
        NonFiniteError: a weight is NaN or infinite.
    """
    document, tensors = read_tensors(path)
    if not isinstance(document, dict) or document.get("format") != 1 or "actuator" not in document:
        raise ConfigurationError(f"{path} holds no actuator network: write one by 'orbit train-actuator'")
    try:
        description = msgspec.convert(document["actuator"], NetworkDescription)
    except (msgspec.ValidationError, ConfigurationError) as error:
        raise ConfigurationError(f"actuator network {path}: {error}") from None
    network = description.build()
    wanted = {name: tuple(weight.shape) for name, weight in network.state_dict().items()}
    found = {name: tuple(weight.shape) for name, weight in tensors.items()}
    if wanted != found:
        name = next(name for name in [*wanted, *found] if wanted.get(name) != found.get(name))
        raise ConfigurationError(
            f"actuator network {path}: weight '{name}' is {_shape(found.get(name))}, and an {description.kind} of "
            f"hidden sizes {list(description.hidden_sizes)} has {_shape(wanted.get(name))}: fit it again"
        )
    network.load_state_dict(tensors)
    return network.requires_grad_(False)


def check_rate(path: str, description: NetworkDescription, physics_dt: float) -> None:
    """Refuse a network in a world of another rate.

    Args:
        path: path of the network's file, for messages.
        description: network's description.
        physics_dt: length of the world's physics steps in seconds.

    Raises:
        ConfigurationError: the rates differ.
    """
    if abs(description.rate * physics_dt - 1.0) > _RATE_TOLERANCE:
        raise ConfigurationError(
            f"actuator network {path} was fitted at {description.rate:g} Hz, and the world's physics steps come at "
            f"{1.0 / physics_dt:g} Hz: set physics_dt={1.0 / description.rate:g}, or fit one at that rate"
        )


def _shape(shape: Sequence[int] | None) -> Any:
    return "missing" if shape is None else list(shape)


# Fitting of actuator networks to recordings ---------------------------------------------------------------------------

# Share of each recording, at its end, that is held out to measure the error.
_HELD_OUT = 0.2
# Steps of a window that is learned from at a time, and the first of these whose errors do not count, because the
# network's memory is still filling.
_WINDOW, _WARM_UP = 100, 20
# Limit of the learning rate; none above one is useful.
_FASTEST = 10.0
# Windows in a batch.
_BATCH = 64


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """Settings of fitting an actuator network."""

    kind: Literal["mlp", "lstm"] = "lstm"
    """Architecture."""
    hidden_sizes: tuple[int, ...] = ()
    """Units of the hidden layers; if empty, the published ones: (32, 32, 32) of a perceptron, (8, 8) of an LSTM."""
    history: tuple[int, ...] = (0, 2, 4)
    """Steps back that a perceptron sees; at 200 Hz these are the published 0, 10 and 20 ms."""
    unit: Literal["rad", "m"] = "rad"
    """Unit of the joints' positions."""
    passes: int = 150
    """Number of passes over the training data."""
    learning_rate: float = 5e-3
    """Initial learning rate; it falls to a hundredth along half a cosine."""
    seed: int = 0
    """Seed of the initial weights and of the order of training data."""

    def __post_init__(self) -> None:
        """Check the settings.

        Raises:
            ConfigurationError: the learning rate is not above zero and at most 10, the passes are not at least one, or
                the seed has more than 64 bits.
        """
        if not 0.0 < self.learning_rate <= _FASTEST:
            raise ConfigurationError(
                f"learning_rate is {self.learning_rate}: give a number above zero, {_FASTEST:g} at most"
            )
        if not -(2**63) <= self.seed < 2**63:
            raise ConfigurationError("seed has more than 64 bits: give a smaller number")
        if self.passes < 1:
            raise ConfigurationError(f"passes are {self.passes}: give at least one")


@dataclass(frozen=True)
class Fit:
    """Result of a fit; errors are root mean squares in N m (N) over the held-out ends."""

    network: ActuatorModule
    """Fitted network."""
    error: float
    """Error of the network."""
    line_error: float
    """Error of the best law ``a error + b velocity + c``, the law of a PD drive."""
    effort: float
    """Root mean square of the efforts themselves."""


def fit(
    recordings: Sequence[Recording],
    settings: FitSettings,
    report: Callable[[int, float], None] = lambda done, loss: None,
) -> Fit:
    """Fit a network to the first four fifths of each recording, by Adam on the mean squared error of its efforts.

    Args:
        recordings: recordings with equal rates.
        settings: architecture and training.
        report: called after each pass with its number and the loss, relative to the efforts' own mean square.

    Raises:
        ConfigurationError: recordings differ in rate, one is too short to hold out a part, sizes are invalid, or the
            fit diverges.
    """
    torch.manual_seed(settings.seed)
    rate = common_rate(recordings)
    for recording in recordings:
        if len(_part(recording, False)[1]) <= _WARM_UP:
            raise ConfigurationError(
                f"a recording has {len(recording.efforts)} steps, of which a fifth is held out and the first "
                f"{_WARM_UP} of that do not count: record more than {round(_WARM_UP / _HELD_OUT)}"
            )
    inputs, efforts = _windows([_part(recording, True) for recording in recordings])
    # Inputs and efforts are scaled by their deviations: networks learn badly from numbers far from one.
    error, velocity, effort = (float(part.std().clamp_min(1e-9)) for part in (*inputs.unbind(-1), efforts))
    recurrent = settings.kind == "lstm"
    network = NetworkDescription(
        kind=settings.kind,
        hidden_sizes=settings.hidden_sizes or ((8, 8) if recurrent else (32, 32, 32)),
        history=(0,) if recurrent else settings.history,
        rate=rate,
        unit=settings.unit,
        scales=(error, velocity, effort),
        fitted_to=tuple(dict.fromkeys(joint for recording in recordings for joint in recording.joints)),
    ).build()
    _learn(network, inputs, efforts, settings, report)
    return _judged(network.requires_grad_(False), recordings)


def _learn(
    network: ActuatorModule,
    inputs: Tensor,
    efforts: Tensor,
    settings: FitSettings,
    report: Callable[[int, float], None],
) -> None:
    """Learn from windows of inputs (T, B, 2) and efforts (T, B)."""
    optimizer = torch.optim.Adam(network.parameters(), settings.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, settings.passes, settings.learning_rate / 100)
    scale = network.description.scales[2]
    for number in range(settings.passes):
        losses: list[float] = []
        for chosen in torch.randperm(inputs.shape[1]).split(_BATCH):
            given = network.sequence(inputs[:, chosen])
            loss = ((given - efforts[:, chosen])[_WARM_UP:] / scale).square().mean()
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            losses.append(float(loss.detach()))
        # After each pass, so that a diverged fit does not run to its end.
        if not all(map(math.isfinite, losses)):
            raise ConfigurationError(
                f"the fit diverged in pass {number + 1}: give a learning_rate below {settings.learning_rate:g}"
            )
        schedule.step()
        report(number, sum(losses) / len(losses))


def _judged(network: ActuatorModule, recordings: Sequence[Recording]) -> Fit:
    wrong: list[Tensor] = []
    line_wrong: list[Tensor] = []
    truths: list[Tensor] = []
    known = [_part(recording, True) for recording in recordings]
    # The line is fitted to the same data as the network, so that the comparison is fair.
    line = _line(torch.cat([i.flatten(0, 1) for i, _ in known]), torch.cat([e.flatten() for _, e in known]))
    for recording in recordings:
        inputs, efforts = _part(recording, False)
        wrong.append((network.sequence(inputs) - efforts)[_WARM_UP:].flatten())
        line_wrong.append((_with_one(inputs) @ line - efforts)[_WARM_UP:].flatten())
        truths.append(efforts[_WARM_UP:].flatten())
    return Fit(network, *(float(torch.cat(parts).square().mean().sqrt()) for parts in (wrong, line_wrong, truths)))


def _line(inputs: Tensor, efforts: Tensor) -> Tensor:
    """Compute the coefficients (3,) of the best law, by least squares, from inputs (M, 2) and efforts (M,)."""
    return torch.linalg.lstsq(_with_one(inputs), efforts[:, None]).solution.squeeze(1)


def _with_one(inputs: Tensor) -> Tensor:
    return torch.cat((inputs, torch.ones_like(inputs[..., :1])), -1)


def _part(recording: Recording, learned: bool) -> tuple[Tensor, Tensor]:
    """Return inputs (T, k, 2) and efforts (T, k) of the beginning, or of the held-out end."""
    at = round((1.0 - _HELD_OUT) * len(recording.efforts))
    rows = slice(0, at) if learned else slice(at, None)
    return recording.inputs[rows], recording.efforts[rows]


def _windows(parts: Sequence[tuple[Tensor, Tensor]]) -> tuple[Tensor, Tensor]:
    """Cut parts into windows (T, B, 2) and (T, B) that overlap by their warm-up, so that each step counts once."""
    cut = [tuple(whole.unfold(0, min(_WINDOW, len(whole)), _WINDOW - _WARM_UP) for whole in part) for part in parts]
    # Short recordings have one shorter window, to which all are cut.
    least = min(inputs.shape[-1] for inputs, _ in cut)
    inputs = torch.cat([one[..., :least].permute(3, 0, 1, 2).flatten(1, 2) for one, _ in cut], 1)
    efforts = torch.cat([one[..., :least].permute(2, 0, 1).flatten(1, 2) for _, one in cut], 1)
    return inputs, efforts
