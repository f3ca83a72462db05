"""Courses of a task's deformables: positions of key points over time in one environment, to compare backends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbit_conformance.recording import Recording

# The most instants of a course that are kept, evenly spaced.
_INSTANTS = 101


@dataclass(frozen=True)
class Course:
    """The first environment's first episode of a task's expert on one backend."""

    task: str
    """Name of the task."""
    backend: str
    """Name of the backend."""
    times: list[float]
    """Seconds since the episode began."""
    points: dict[str, list[list[float]]]
    """Positions (x, y, z) in metres of each key point, as ``deformable/point``."""
    metric: str
    """The task's leading metric."""
    values: list[float]
    """Values of the metric at these times."""


def course_of(recording: Recording) -> Course | None:
    """The course of a recording; None where the task has no deformables with key points."""
    points = {name: track[:, 0] for name, track in recording.tracks.items() if track.shape[2] == 3}
    if not points or not recording.metrics:
        return None
    name, values = next(iter(recording.metrics.items()))
    # The next episode's steps are in the recording too.
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
