"""Recordings of a task's episodes: the actions that were taken, and where things went."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.files import as_path, written_whole
from orbit_core.interfaces import AssetError, ConfigurationError, World
from orbit_core.rollout.stepping import EpisodeCounter, StepObserver
from orbit_data.reading.budget import ReadAccount, ReadBudget
from orbit_data.reading.npz import FAULTS, read_npz
from orbit_data.recording import tracked_frames
from orbit_data.tensor_file import parse_json

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment
    from orbit_core.envs.episode import EpisodeEnd

_TRACK = "track:"
_METRIC = "metric:"


@dataclass(frozen=True, eq=False)
class Recording:
    """The first episode of every environment of a task on one backend."""

    task: str
    """Name of the task."""
    backend: str
    """Name of the backend that recorded."""
    seed: int
    """Seed of the random streams, by which a replay starts alike."""
    fields: Mapping[str, Any]
    """Fields of the task that differ from its defaults."""
    step_dt: float
    """Seconds between two rows."""
    actions: npt.NDArray[np.float32]
    """(T, N, A); of no meaning after an episode's end."""
    lengths: npt.NDArray[np.int64]
    """(N,) steps of each episode."""
    tracks: Mapping[str, npt.NDArray[np.float32]]
    """(T, k, 7) poses before each step, of end effectors and movable objects in the first k environments, and (T, k, 3)
    positions of the key points of deformables, as ``deformable/point``; NaN after an episode's end."""
    metrics: Mapping[str, npt.NDArray[np.float32]] = field(default_factory=dict)
    """(T, k) the leading metric before each step, of tasks with deformables; NaN after an episode's end."""

    def save(self, path: Path | str) -> None:
        """Write an ``.npz`` file.

        Raises:
            StorageError: it cannot be written.
        """
        about = {"task": self.task, "backend": self.backend, "seed": self.seed, "step_dt": self.step_dt}
        arrays: dict[str, npt.NDArray[Any]] = {_TRACK + name: track for name, track in self.tracks.items()}
        arrays |= {_METRIC + name: values for name, values in self.metrics.items()}
        header = json.dumps({**about, "fields": dict(self.fields)})
        arrays |= {"header": np.array(header), "actions": self.actions, "lengths": self.lengths}
        with written_whole(as_path(path)) as written:
            np.savez_compressed(written, **arrays)  # pyright: ignore[reportArgumentType]

    @staticmethod
    def load(path: Path | str, budget: ReadBudget = ReadBudget()) -> Recording:
        """Read what :meth:`save` wrote.

        Args:
            path: of the file.
            budget: limits on the bytes and the time that it may take.

        Raises:
            AssetError: the file is no recording, or beyond the budget.
        """
        path = as_path(path)
        try:
            if not path.is_file():
                raise ValueError("it is no regular file")
            arrays = read_npz(path, ReadAccount(budget, str(path)))
            about = msgspec.convert(parse_json(str(arrays.pop("header"))), _Header)
            tracks, metrics = (
                {name.removeprefix(kind): array for name, array in arrays.items() if name.startswith(kind)}
                for kind in (_TRACK, _METRIC)
            )
            actions, lengths = arrays["actions"], arrays["lengths"]
            _check_arrays(actions, lengths, (*tracks.values(), *metrics.values()))
        except (*FAULTS, RecursionError, ConfigurationError) as error:
            raise AssetError(f"{path} is no recording of a task's episodes: {error}") from error
        return Recording(
            **msgspec.structs.asdict(about), actions=actions, lengths=lengths, tracks=tracks, metrics=metrics
        )


class _Header(msgspec.Struct, forbid_unknown_fields=True):
    """Header of a recording's file, next to its arrays."""

    task: str
    backend: str
    seed: int
    step_dt: float
    fields: dict[str, Any]


def _check_arrays(actions: npt.NDArray[Any], lengths: npt.NDArray[Any], others: tuple[npt.NDArray[Any], ...]) -> None:
    """Refuse arrays of shapes that do not fit each other, or of other than real numbers.

    Raises:
        ValueError: says which.
    """
    # A file from elsewhere may hold anything: numpy's own errors would not name it.
    if actions.ndim != 3 or lengths.shape != actions.shape[1:2] or not lengths.size:
        raise ValueError(f"it has actions of shape {actions.shape} and lengths of shape {lengths.shape}")
    if actions.dtype.kind != "f" or lengths.dtype.kind not in "iu" or any(a.dtype.kind != "f" for a in others):
        raise ValueError("its arrays hold other than real numbers")
    if lengths.min() < 1 or lengths.max() > len(actions):
        raise ValueError(f"it has episodes of {lengths.min()} to {lengths.max()} steps, of {len(actions)} recorded")
    for array in others:
        if array.ndim < 2 or len(array) != len(actions) or array.shape[1] > len(lengths):
            raise ValueError(f"it has a track of shape {array.shape} over {len(actions)} steps")


class RecordedActions:
    """Gives the actions of a recording again, open loop. After an episode's end its last action is held.

    Args:
        recording: of as many environments as are stepped.
        device: of the actions.
    """

    def __init__(self, recording: Recording, device: torch.device) -> None:
        steps = np.arange(len(recording.actions))[:, None]
        rows = np.minimum(steps, recording.lengths[None] - 1)
        held = recording.actions[rows, np.arange(recording.actions.shape[1])]
        self._actions = torch.from_numpy(held).to(device)
        self._step = 0

    def act(self) -> Tensor:
        """(N, A) the next action."""
        step = min(self._step, len(self._actions) - 1)
        self._step += 1
        return self._actions[step]


class EpisodeRecorder(StepObserver):
    """Records actions, the poses of end effectors and of all objects that can move, and of deformables the key points.

    Args:
        environment: that is stepped.
        counter: tells whose first episode still runs; what comes later is not recorded.
        tracked_envs: number of environments, from the first on, whose poses are recorded.
    """

    def __init__(self, environment: Environment, counter: EpisodeCounter, tracked_envs: int) -> None:
        self._environment = environment
        self._counter = counter
        self._count = min(tracked_envs, environment.num_envs)
        self._watched = dict(_tracked(environment.world))
        self._tracks: dict[str, list[Tensor]] = {name: [] for name in self._watched}
        self._metrics: dict[str, list[Tensor]] = {}
        self._actions: list[Tensor] = []

    def before_step(self) -> None:
        """Record where things are; not a number where the episode is over."""
        over = ~self._counter.running[: self._count]
        for name, place in self._watched.items():
            self._tracks[name].append(place()[: self._count].masked_fill(over[:, None], torch.nan).cpu())
        if self._environment.world.deformables:
            name, values = next(iter(self._environment.task.metrics(self._environment).items()))
            self._metrics.setdefault(name, []).append(values[: self._count].masked_fill(over, torch.nan).cpu())

    def after_step(self, action: Tensor, info: Mapping[str, EpisodeEnd]) -> None:
        """Record what was done."""
        self._actions.append(action.cpu().clone())

    def recording(self, task: str, seed: int, fields: Mapping[str, Any]) -> Recording:
        """Return the recording, once all first episodes are over.

        Args:
            task: name of the task.
            seed: of the environments.
            fields: of the task, where they differ from its defaults.
        """
        return Recording(
            task=task,
            backend=self._environment.world.backend,
            seed=seed,
            fields=fields,
            step_dt=self._environment.step_dt,
            actions=torch.stack(self._actions).numpy(),
            lengths=self._counter.episodes().steps.cpu().numpy(),
            tracks={name: torch.stack(places).numpy() for name, places in self._tracks.items()},
            metrics={name: torch.stack(values).numpy() for name, values in self._metrics.items()},
        )


def _tracked(world: World) -> Iterator[tuple[str, Callable[[], Tensor]]]:
    """Yield the name and the reader of every tracked place: (N, 7) of a frame, (N, 3) of a key point."""
    for name, (entity, frame) in tracked_frames(world):
        yield name, functools.partial(entity.frame_pose, frame)
    for name, body in world.deformables.items():
        for point in body.spec.key_points:
            yield f"{name}/{point.name}", functools.partial(body.key_point, point.name)
