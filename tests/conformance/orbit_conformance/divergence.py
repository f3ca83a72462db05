"""How far apart two recorded runs of a task are, over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from orbit_conformance.recording import Recording
from orbit_core.interfaces import ConfigurationError

_POINTS = 101
"""The most instants of a divergence that are kept, evenly spaced."""


@dataclass(frozen=True)
class Divergence:
    """How far apart one thing is in two runs of a task, over the environments in which both episodes still run."""

    thing: str
    times: list[float]
    """Seconds since the episode began."""
    lower_quartile: list[float]
    """Distance in metres that a quarter of the environments stay below."""
    median: list[float]
    upper_quartile: list[float]


def divergence(recording: Recording, reference: Recording) -> list[Divergence]:
    """Distance over time between two runs of one task, for each thing that both have tracked.

    Raises:
        ConfigurationError: the runs are of different tasks, seeds or fields.
    """
    for name in ("task", "seed", "fields", "step_dt"):
        ours, theirs = getattr(recording, name), getattr(reference, name)
        if ours != theirs:
            raise ConfigurationError(f"recordings of different runs: {name} is {ours!r} here and {theirs!r} there")
    shared = [name for name in recording.tracks if name in reference.tracks]
    return [_divergence(name, recording.tracks[name], reference.tracks[name], recording.step_dt) for name in shared]


def _divergence(
    name: str, ours: npt.NDArray[np.float32], theirs: npt.NDArray[np.float32], step_dt: float
) -> Divergence:
    steps, count = min(len(ours), len(theirs)), min(ours.shape[1], theirs.shape[1])
    distances = np.linalg.norm(ours[:steps, :count, :3] - theirs[:steps, :count, :3], axis=2).astype(np.float64)
    rows = np.unique(np.linspace(0, steps - 1, min(_POINTS, steps)).round().astype(int))
    rows = rows[np.isfinite(distances[rows]).any(axis=1)]
    lower, middle, upper = np.nanquantile(distances[rows], (0.25, 0.5, 0.75), axis=1)
    return Divergence(name, (rows * step_dt).tolist(), lower.tolist(), middle.tolist(), upper.tolist())
