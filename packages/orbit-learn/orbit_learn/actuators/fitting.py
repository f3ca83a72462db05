"""Fitting of actuator networks to recordings."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from orbit_core.interfaces import ConfigurationError
from orbit_learn.actuators.networks import ActuatorModule, NetworkDescription
from orbit_learn.actuators.recordings import Recording, common_rate

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
