"""A task's episodes kept in a file: what was done, where things went; and how two such files part over time."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.files import written_whole
from orbit_core.interfaces import AssetError, ConfigurationError, Object, Robot
from orbit_core.world import SimulatedWorld

_TRACK = "track:"
_POINTS = 101
"""At most so many instants of a divergence are kept, evenly spaced."""


@dataclass(frozen=True, eq=False)
class Recording:
    """The first episode of every environment of a task on one backend."""

    task: str
    backend: str
    seed: int
    fields: Mapping[str, Any]
    """Of the task, where they differ from its defaults."""
    step_dt: float
    """Seconds between two rows."""
    actions: npt.NDArray[np.float32]
    """(T, N, A); of no meaning after an episode's end."""
    lengths: npt.NDArray[np.int64]
    """(N,) steps of each episode."""
    tracks: Mapping[str, npt.NDArray[np.float32]]
    """(T, k, 7) poses before each step, of end effectors and movable objects in the first k environments; NaN after an
    episode's end."""

    def save(self, path: Path) -> None:
        """Write an ``.npz`` file.

        Raises:
            StorageError: it cannot be written.
        """
        about = {"task": self.task, "backend": self.backend, "seed": self.seed, "step_dt": self.step_dt}
        arrays: dict[str, npt.NDArray[Any]] = {_TRACK + name: track for name, track in self.tracks.items()}
        header = json.dumps({**about, "fields": dict(self.fields)})
        arrays |= {"header": np.array(header), "actions": self.actions, "lengths": self.lengths}
        with written_whole(path) as written:
            np.savez_compressed(written, **arrays)  # pyright: ignore[reportArgumentType]

    @staticmethod
    def load(path: Path) -> Recording:
        """Read what :meth:`save` wrote.

        Raises:
            AssetError: the file is no recording.
        """
        try:
            with np.load(path) as file:
                about = json.loads(str(file["header"]))
                tracks = {name.removeprefix(_TRACK): file[name] for name in file.files if name.startswith(_TRACK)}
                return Recording(**about, actions=file["actions"], lengths=file["lengths"], tracks=tracks)
        except (OSError, KeyError, ValueError, TypeError) as error:
            raise AssetError(f"{path} is no recording of a task's episodes: {error}") from error


class Tracker:
    """Keeps the poses of end effectors and of whatever can move among the objects, in the first environments."""

    def __init__(self, world: SimulatedWorld, environments: int) -> None:
        self._world = world
        self._count = min(environments, world.num_envs)
        self._frames = dict(_tracked_frames(world))
        self._poses: dict[str, list[Tensor]] = {name: [] for name in self._frames}

    def add(self, running: Tensor) -> None:
        """Keep the present poses of those environments (N,) whose first episode still runs."""
        over = ~running[: self._count, None]
        for name, (entity, frame) in self._frames.items():
            pose = entity.frame_pose(frame)[: self._count]
            self._poses[name].append(pose.masked_fill(over, torch.nan).cpu())

    def tracks(self) -> dict[str, npt.NDArray[np.float32]]:
        """(T, k, 7) by name."""
        return {name: torch.stack(poses).numpy() for name, poses in self._poses.items()}


def _tracked_frames(world: SimulatedWorld) -> Iterator[tuple[str, tuple[Object, str]]]:
    for name, robot in world.robots.items():
        ends = [end.frame for end in robot.spec.end_effectors] if isinstance(robot, Robot) else []
        for frame in ends or robot.link_names[:1]:
            yield f"{name}/{frame}", (robot, frame)
    for name, thing in world.objects.items():
        for link in thing.link_names[1 if thing.spec.fixed_base else 0 :]:
            yield (name if len(thing.link_names) == 1 else f"{name}/{link}"), (thing, link)


@dataclass(frozen=True)
class Divergence:
    """How far apart one thing is in two runs of a task, over the environments in which both episodes still run."""

    thing: str
    times: list[float]
    """Seconds since the episode began."""
    lower_quartile: list[float]
    """Metres."""
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
