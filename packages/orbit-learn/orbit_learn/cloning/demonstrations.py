"""Demonstrations as tensors: observations and actions of all episodes one after another, and windows of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from orbit_core.envs.observation_layout import POLICY
from orbit_core.interfaces import ConfigurationError
from orbit_data.episodes import ACTIONS, OBSERVED, TAUGHT
from orbit_data.formats import opened
from orbit_data.manifest.manifest import Kind, Manifest, differences
from orbit_data.noise import CLEAN
from orbit_data.reading.budget import ReadBudget
from orbit_learn.description import Part, group_parts
from orbit_learn.memory import map_seen

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment
    from orbit_data.episodes import Dataset, Episode

# Files may be anyone's. An episode of real cameras takes some GB, and reading thousands of videos any time.
_BUDGET = ReadBudget(bytes=1 << 33, seconds=math.inf)
_FEWEST_STEPS = 64
# Actions are within [-1, 1], but for rounding.
_LARGEST_ACTION = 1.001


@dataclass(frozen=True)
class Demonstrations:
    """Steps of all episodes, one episode after another."""

    observation: Tensor | dict[str, Tensor]
    """(T, O), or terms (T, ...) by name."""
    actions: Tensor
    """(T, A) that the demonstrator chose."""
    ends: Tensor
    """(T,) last step of the episode that each step belongs to."""

    @property
    def steps(self) -> int:
        """T, steps of all episodes."""
        return len(self.actions)

    @property
    def bytes(self) -> int:
        """Size in memory."""
        seen = [self.observation] if isinstance(self.observation, Tensor) else list(self.observation.values())
        return sum(each.nbytes for each in (*seen, self.actions, self.ends))

    def to(self, device: torch.device) -> Demonstrations:
        """Return these demonstrations on a device."""
        observation = map_seen(lambda value: value.to(device), self.observation)
        return Demonstrations(observation, self.actions.to(device), self.ends.to(device))

    def observed(self, rows: Tensor) -> Tensor | dict[str, Tensor]:
        """Return the observations of some steps, of any shape of ``rows``."""
        return map_seen(lambda value: value[rows], self.observation)

    def windows(self, rows: Tensor, chunk: int) -> tuple[Tensor, Tensor]:
        """Return the actions (..., H, A) from each of ``rows`` (...) on, and which of them are within the episode.

        Beyond the end of an episode its last action is repeated.
        """
        steps = rows[..., None] + torch.arange(chunk, device=rows.device)
        ends = self.ends[rows][..., None]
        return self.actions[torch.minimum(steps, ends)], steps <= ends


def load_demonstrations(path: Path | str, environment: Environment, only_successes: bool) -> Demonstrations:
    """Read a dataset for a policy of an environment, which sees the group ``policy``.

    Args:
        path: of the dataset, in any format.
        environment: that the policy is for.
        only_successes: leave episodes out that are known to have failed.

    Raises:
        ConfigurationError: the dataset is of another robot, task, action space or scale, or too small; names all that
            differs.
    """
    layout = environment.observation[POLICY]
    parts, concatenated = group_parts(layout), layout.concatenated
    with opened(path, _BUDGET) as dataset:
        check_fit(dataset, environment)
        positions = [i for i, info in enumerate(dataset.episodes) if not (only_successes and info.success is False)]
        infos = [dataset.episodes[i] for i in positions]
        total = sum(info.length if info.taught is None else info.taught for info in infos)
        if total < _FEWEST_STEPS:
            failed = len(dataset.episodes) - len(positions)
            left_out = f" ({failed} that failed are left out: only_successes=false takes them too)" if failed else ""
            raise ConfigurationError(
                f"{path} has {total} steps in {len(positions)} episodes to clone{left_out}, and cloning needs "
                f"{_FEWEST_STEPS}: record more"
            )
        return _load(dataset, positions, total, parts, concatenated, environment)


def joined(loaded: Sequence[Demonstrations]) -> Demonstrations:
    """Return demonstrations of several datasets as one."""
    if len(loaded) == 1:
        return loaded[0]
    begins = np.cumsum([0, *(each.steps for each in loaded[:-1])])
    ends = torch.cat([each.ends + int(begin) for each, begin in zip(loaded, begins, strict=True)])
    observation = _concatenated([each.observation for each in loaded])
    actions = torch.cat([each.actions for each in loaded])
    return Demonstrations(observation, actions, ends)


def _concatenated(observations: Sequence[Tensor | dict[str, Tensor]]) -> Tensor | dict[str, Tensor]:
    """Return observations of one form, one after another."""
    first = observations[0]
    if isinstance(first, Tensor):
        return torch.cat([each for each in observations if isinstance(each, Tensor)])
    return {name: torch.cat([each[name] for each in observations]) for name in first}  # pyright: ignore


def check_fit(dataset: Dataset, environment: Environment) -> None:
    """Reject a dataset whose numbers mean something else in an environment.

    Raises:
        ConfigurationError: names every difference.
    """
    recorded = dataset.known()
    present = Manifest.of(environment, recorded.task, recorded.seed)
    if POLICY not in recorded.observations:
        raise ConfigurationError(
            f"{dataset.path} holds observation groups {', '.join(recorded.observations)}, not '{POLICY}', which a "
            f"policy sees: record it with --group {POLICY}"
        )
    found = differences(recorded, present, [POLICY])
    wrong = [str(each) for each in found if each.kind is Kind.ERROR]
    if wrong:
        raise ConfigurationError(f"{dataset.path} cannot be cloned for this environment: {'; '.join(wrong)}")


def _taught(episode: Episode, where: str) -> np.ndarray:
    """Return the steps of an episode that are learned from: all, or those that a person led in a policy's place."""
    if episode.info.taught is None:
        return np.arange(episode.info.length)
    steps = np.flatnonzero(episode.arrays.get(TAUGHT, ()))
    if len(steps) != episode.info.taught:
        raise ConfigurationError(
            f"{where} would have {episode.info.taught} steps to learn from, and has {len(steps)} in '{TAUGHT}'"
        )
    return steps


def _check_actions(actions: np.ndarray, size: int, where: str) -> None:
    """Reject actions of another form, which would be copied or cut in silence, or of other units."""
    if actions.ndim != 2 or actions.shape[1] != size or actions.dtype.kind != "f":
        raise ConfigurationError(
            f"{where} has actions of shape {actions.shape} and type {actions.dtype}: cloning needs real numbers "
            f"(steps, {size})"
        )
    largest = float(np.abs(actions).max(initial=0.0))
    if not largest <= _LARGEST_ACTION:
        raise ConfigurationError(
            f"{where} has actions of up to {largest:.3g}, and a policy's are within [-1, 1]: divide them by their scale"
        )


def _ends(steps: np.ndarray) -> np.ndarray:
    """Return the place of the last of each stretch of consecutive steps, for each of them."""
    lasts = np.flatnonzero(np.append(np.diff(steps) != 1, True)) if len(steps) else np.zeros(0, np.int64)
    return lasts[np.searchsorted(lasts, np.arange(len(steps)))]


def _empty(shape: tuple[int, ...], dtype: np.dtype, dataset: Dataset) -> np.ndarray:
    """Return memory for an array of all steps.

    Raises:
        ConfigurationError: there is not that much.
    """
    try:
        return np.empty(shape, dtype)
    except MemoryError:
        size = math.prod(shape) * dtype.itemsize / 1e9
        raise ConfigurationError(
            f"{dataset.path} would take {size:.3g} GB for an array of {shape[0]:,} steps, more than this computer has: "
            "clone a part ('orbit data filter --first')"
        ) from None


def _load(
    dataset: Dataset, positions: list[int], total: int, parts: tuple[Part, ...], concatenated: bool,
    environment: Environment,
) -> Demonstrations:  # fmt: skip
    # Filled in place: pictures of a thousand episodes do not fit into memory twice.
    arrays: dict[str, np.ndarray] = {}
    actions = _empty((total, environment.action_size), np.dtype(np.float32), dataset)
    ends = _empty((total,), np.dtype(np.int64), dataset)
    begin = 0
    for position in positions:
        episode = dataset.read(position)
        where = f"episode {episode.info.number} of {dataset.path}"
        steps = _taught(episode, where)
        stop = begin + len(steps)
        for part in parts:
            value = episode.arrays.get(OBSERVED + part.name)
            if value is None or tuple(value.shape[1:]) != part.shape:
                held = "lacks it" if value is None else f"has shape {tuple(value.shape[1:])}"
                raise ConfigurationError(f"the policy sees '{part.name}' of shape {part.shape}, and {where} {held}")
            if part.name not in arrays:
                arrays[part.name] = _empty((total, *value.shape[1:]), value.dtype, dataset)
            elif arrays[part.name].dtype != value.dtype:
                raise ConfigurationError(
                    f"'{part.name}' of {where} holds {value.dtype}, and that of episodes before "
                    f"{arrays[part.name].dtype}: record or convert all alike"
                )
            arrays[part.name][begin:stop] = value[steps]
        # Without the noise that was added to disturb the demonstrator, where both were recorded.
        chosen = episode.arrays.get(CLEAN, episode.arrays[ACTIONS])
        _check_actions(chosen, actions.shape[1], where)
        actions[begin:stop] = chosen[steps]
        ends[begin:stop] = begin + _ends(steps)
        begin = stop
    tensors: Mapping[str, Tensor] = {name: torch.from_numpy(value) for name, value in arrays.items()}
    observation = (
        torch.cat([tensors[part.name].float().flatten(1) for part in parts], 1) if concatenated else dict(tensors)
    )
    return Demonstrations(observation, torch.from_numpy(actions), torch.from_numpy(ends))
