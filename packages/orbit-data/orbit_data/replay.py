"""Replay of recorded episodes on any engine: their actions open loop, or their states set one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
from torch import Tensor

from orbit_core.envs.configuration import configure
from orbit_core.envs.registry import task_entry
from orbit_core.interfaces import ConfigurationError, Object
from orbit_core.rollout.estimates import Estimate, proportion
from orbit_data.episodes import ACTIONS, INITIAL, POSES, STATES, Array, Dataset, Episode
from orbit_data.manifest.manifest import Manifest, check_manifest
from orbit_data.manifest.plain import as_plain
from orbit_data.recording import tracked_frames
from orbit_data.states import TaskMemory, WorldStates

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment

Mode = Literal["actions", "states"]
_NEEDED = (ACTIONS, STATES, INITIAL, POSES)
_QUARTILES = (0.25, 0.5, 0.75)


@dataclass(frozen=True, eq=False)
class ReplayResult:
    """Result of a replay."""

    backend: str
    """Engine of the replay."""
    recorded_on: tuple[str, ...]
    """Engines that recorded the episodes."""
    mode: Mode
    """Source of the replayed motion: actions or states."""
    success: Estimate
    """Success rate of the replayed episodes, at the step at which the recorded ones ended."""
    recorded_success: Estimate
    """Success rate of the same episodes as they were recorded."""
    times: Array
    """Times (T,) in s since the episode began."""
    distances: Mapping[str, Array]
    """Distances (T, 3) in m between an object's position and the recorded one, by name: quartiles over the episodes."""


def fields_of(manifest: Manifest) -> dict[str, Any]:
    """Return the task's fields, by path, in which a manifest differs from the task's defaults and which text can set.

    Functions and types are not among them: ``check_manifest`` reports differences of those.
    """
    default = dict(_scalars(as_plain(configure(task_entry(manifest.task).task_type(), {})), ""))
    recorded = dict(_scalars(manifest.configuration, ""))
    return {path: value for path, value in recorded.items() if path in default and default[path] != value}


def _scalars(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, item in value.items():
            if key not in ("type", "function", "bound"):
                yield from _scalars(item, f"{path}.{key}" if path else key)
    elif isinstance(value, bool | int | float | str):
        yield path, value


def replay(
    environment: Environment,
    dataset: Dataset,
    positions: Sequence[int],
    mode: Mode = "actions",
    before_step: Callable[[], None] = lambda: None,
) -> ReplayResult:
    """Replay episodes from the states and goals that they began with, ``num_envs`` at a time.

    Args:
        environment: environment of the dataset's task, on any engine.
        dataset: dataset with states, poses and the tasks' memory, as ``orbit record`` writes them.
        positions: positions of the episodes in the dataset.
        mode: whether actions are repeated, or states are set.
        before_step: called before each step, to film it.

    Raises:
        ConfigurationError: the dataset does not fit the environment, or lacks an array; the message names it.
    """
    # Observations do not matter: actions and states are read, not what a policy saw.
    check_manifest(dataset.known(), environment, str(dataset.path), groups=())
    player = EpisodePlayer(environment)
    distances: dict[str, list[Array]] = {}
    successes: list[bool] = []
    count, longest = environment.num_envs, max(dataset.episodes[p].length for p in positions)
    for begin in range(0, len(positions), count):
        batch = [dataset.read(place, _NEEDED) for place in positions[begin : begin + count]]
        apart, reached = player.play(batch, mode, before_step)
        successes += reached
        for name, values in apart.items():
            # Batches have different lengths; quantiles ignore the NaN after their ends.
            padded = np.full((longest, len(batch)), np.nan)
            padded[: len(values)] = values
            distances.setdefault(name, []).append(padded)
    infos = [dataset.episodes[place] for place in positions]
    return ReplayResult(
        backend=environment.world.backend,
        recorded_on=tuple(dict.fromkeys(info.backend for info in infos)),
        mode=mode,
        success=proportion(sum(successes), len(successes)),
        recorded_success=proportion(sum(bool(info.success) for info in infos), len(infos)),
        times=np.arange(longest) * environment.step_dt,
        distances={n: np.nanquantile(np.concatenate(v, 1), _QUARTILES, axis=1).T for n, v in distances.items()},
    )


class EpisodePlayer:
    """Player of recorded episodes: begins environments where episodes began, and repeats what was recorded."""

    def __init__(self, environment: Environment) -> None:
        self._environment = environment
        self._states, self._memory = WorldStates(environment.world), TaskMemory(environment)
        self._frames: dict[str, tuple[Object, str]] = dict(tracked_frames(environment.world))

    def begin(self, episodes: Sequence[Episode]) -> Tensor:
        """Put the first environments into the episodes' initial states, and return their indices (n,).

        Raises:
            ConfigurationError: there are more episodes than environments, or they belong to another world.
        """
        environment = self._environment
        for episode in episodes:
            self._check(episode)
        if len(episodes) > environment.num_envs:
            raise ConfigurationError(f"{len(episodes)} episodes do not begin in {environment.num_envs} environments")
        environment.reset()
        rows = environment.all_ids[: len(episodes)]
        self.set_states([episode.arrays[STATES][0] for episode in episodes], rows)
        names = episodes[0].named(INITIAL)
        values = {name: self._stack([episode.arrays[INITIAL + name] for episode in episodes]) for name in names}
        # The reset has drawn new goals, which the recorded ones replace.
        self._memory.write(values, rows)
        return rows

    def _check(self, episode: Episode) -> None:
        """Refuse arrays of other shapes than this environment's."""
        wanted = {ACTIONS: (self._environment.action_size,), STATES: (self._states.size,)}
        wanted |= {name: (7,) for name in episode.arrays if name.startswith(POSES)}
        for name, shape in wanted.items():
            if (array := episode.arrays.get(name)) is not None and array.shape[1:] != shape:
                raise ConfigurationError(
                    f"'{name}' of episode {episode.info.number} has {array.shape[1:]} numbers a step, and this "
                    f"environment takes {shape}: the recording is of another robot or other objects"
                )

    def set_states(self, states: Sequence[Array], rows: Tensor) -> None:
        """Set a state (S,) in each of some environments (n,)."""
        self._states.write(self._stack(states), rows)

    def play(
        self, episodes: Sequence[Episode], mode: Mode, before_step: Callable[[], None]
    ) -> tuple[dict[str, Array], list[bool]]:
        """Play episodes.

        Args:
            episodes: episodes, at most one for each environment.
            mode: whether actions are repeated, or states are set.
            before_step: called before each step.

        Returns:
            Distances (T, n) in m from the recorded poses, NaN after an episode's end, and whether each episode reached
            the goal.
        """
        environment, rows = self._environment, self.begin(episodes)
        lengths = np.array([episode.info.length for episode in episodes])
        running = np.ones(len(episodes), bool)
        reached = np.zeros(len(episodes), bool)
        apart = {name: np.full((lengths.max(), len(episodes)), np.nan) for name in self._frames}
        action = torch.zeros(environment.num_envs, environment.action_size, device=environment.device)
        for step in range(int(lengths.max())):
            # Ended episodes keep repeating their last row; their results no longer count.
            now = [min(step, length - 1) for length in lengths.tolist()]
            if mode == "states":
                self.set_states([e.arrays[STATES][t] for e, t in zip(episodes, now, strict=True)], rows)
            before_step()
            for name, values in apart.items():
                values[step, running] = self._apart(name, episodes, now)[running]
            if mode == "states":
                reached = np.where(step < lengths, self._success(rows), reached)
            else:
                action[rows] = self._stack([e.arrays[ACTIONS][t] for e, t in zip(episodes, now, strict=True)])
                reached = self._step(action, rows, running, reached, np.equal(lengths, step + 1))
            running &= step + 1 < lengths
        return apart, reached.tolist()

    def _step(self, action: Tensor, rows: Tensor, running: Array, reached: Array, last: Array) -> Array:
        """Take one step, and return which episodes succeeded by the end of the recorded or the replayed one."""
        info = self._environment.step(action)[4]
        success = self._success(rows)
        ended = np.zeros_like(running)
        if "final" in info:
            end = info["final"]
            ids = end.env_ids.cpu().numpy()
            here = ids < len(rows)  # other environments run without an episode to replay
            ended[ids[here]], success[ids[here]] = True, end.success.cpu().numpy()[here]
        # An episode that ends earlier than the recorded one counts by its own end.
        reached = np.where(running & (ended | last), success, reached)
        running &= ~ended
        return reached

    def _success(self, rows: Tensor) -> Array:
        return self._environment.task.success(self._environment)[rows].cpu().numpy()

    def _apart(self, name: str, episodes: Sequence[Episode], now: Sequence[int]) -> Array:
        """Compute the distances (n,) in m from an object's recorded position; NaN if none was recorded."""
        if POSES + name not in episodes[0].arrays:
            return np.full(len(episodes), np.nan)
        entity, frame = self._frames[name]
        here = entity.frame_pose(frame)[: len(episodes), :3].cpu().numpy()
        there = np.stack([e.arrays[POSES + name][t, :3] for e, t in zip(episodes, now, strict=True)])
        return np.linalg.norm(here - there, axis=1)

    def _stack(self, arrays: Sequence[Array]) -> Tensor:
        return torch.from_numpy(np.stack(arrays)).to(self._environment.device)
