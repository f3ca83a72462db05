"""Where the key points of a task's deformables went in one environment, to be held side by side over backends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbit_conformance.recording import Recording

_INSTANTS = 101
"""The most instants of a course that are kept, evenly spaced."""


@dataclass(frozen=True)
class Course:
    """The first environment's first episode of a task's expert on one backend."""

    task: str
    backend: str
    times: list[float]
    """Seconds since the episode began."""
    points: dict[str, list[list[float]]]
    """Positions (x, y, z) in metres of each key point, as ``deformable/point``."""
    metric: str
    """The task's leading metric."""
    values: list[float]


def course_of(recording: Recording) -> Course | None:
    """The course of a recording; None where the task has no deformables with key points."""
    points = {name: track[:, 0] for name, track in recording.tracks.items() if track.shape[2] == 3}
    if not points or not recording.metrics:
        return None
    name, values = next(iter(recording.metrics.items()))
    last = int(recording.lengths[0]) - 1
    rows = np.unique(np.linspace(0, last, min(_INSTANTS, last + 1)).round().astype(int))
    return Course(
        recording.task,
        recording.backend,
        (rows * recording.step_dt).tolist(),
        {point: places[rows].astype(np.float64).tolist() for point, places in points.items()},
        name,
        values[rows, 0].astype(np.float64).tolist(),
    )
