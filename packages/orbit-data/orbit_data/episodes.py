"""Episodes as data: their arrays by name, their facts, and the interface of all file formats."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import ConfigurationError
from orbit_data.manifest.manifest import Manifest
from orbit_data.reading.budget import ReadAccount, check_name

Array = npt.NDArray[Any]

ACTIONS, REWARDS, DONES, STATES = "actions", "rewards", "dones", "states"
TAUGHT = "taught"
"""Array (T,) of the steps that a person led while correcting a policy; only these are learned from."""
OBSERVED, NEXT, POSES, CONTACTS, INITIAL = "obs/", "next_obs/", "poses/", "contacts/", "initial/"
"""Prefixes of arrays' names: observations before a step and after it, poses (T, 7) of end effectors and objects, forces
on links, and the task's memory at the beginning of the episode, without the dimension of time."""


@dataclass(frozen=True)
class EpisodeInfo:
    """Facts about an episode, in addition to its arrays."""

    number: int
    """Number of the episode among all that were begun."""
    length: int
    """Number T of steps."""
    success: bool | None = None
    """Whether the episode succeeded; None if unknown."""
    episode_return: float = 0.0
    """Sum of the rewards."""
    metrics: dict[str, float] = field(default_factory=dict)
    """Metrics of the task at the end."""
    seed: int | None = None
    """Seed of the environment's random stream; together with the next two it determines the initial state."""
    env_id: int | None = None
    """Row of the environment in the recording world; None if unknown."""
    episode: int | None = None
    """Number of the episode among the environment's own."""
    backend: str = ""
    """Engine that ran the episode."""
    taught: int | None = None
    """Steps that a person led, correcting a policy, which alone are learned from; None where all are."""
    instruction: str = ""
    """What the episode shows, in words, as policies of vision and language are asked for it; empty if nobody said."""


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode: arrays (T, ...) by name, and ``initial/`` ones without time; row t is before action t."""

    info: EpisodeInfo
    """Length, success, seed and origin."""
    arrays: Mapping[str, Array]
    """Arrays by name, NumPy's dtypes as they were recorded."""

    def named(self, prefix: str) -> dict[str, Array]:
        """Return the arrays whose names begin with ``prefix``, by the rest of their names."""
        return {name.removeprefix(prefix): array for name, array in self.arrays.items() if name.startswith(prefix)}


class Dataset(ABC):
    """Recorded episodes, in any format. Reading never executes code that a file contains."""

    path: Path
    """File or folder that it was read from."""
    manifest: Manifest | None
    """Manifest of the environment of the recording; None in files of other programs."""
    episodes: Sequence[EpisodeInfo]
    """Facts of all episodes, read without their arrays."""
    masks: Mapping[str, Sequence[int]]
    """Subsets by name, as positions in ``episodes``: training and validation."""

    @abstractmethod
    def read(self, position: int, names: Sequence[str] | None = None) -> Episode:
        """Return an episode by its position in ``episodes``.

        Args:
            position: from 0.
            names: of arrays, or prefixes that end in ``/``; all if None.

        Raises:
            ConfigurationError: the file lacks one, or is damaged.
        """

    def close(self) -> None:
        """Close files."""

    def known(self) -> Manifest:
        """Return the manifest.

        Raises:
            ConfigurationError: the file contains none.
        """
        if self.manifest is None:
            raise ConfigurationError(
                f"{self.path} holds no manifest, which is required here: ORBIT did not record it, and nothing defines "
                "what its numbers mean"
            )
        return self.manifest


def chosen(name: str, names: Sequence[str] | None) -> bool:
    """Return whether an array is requested, by its name or by a prefix that ends in ``/``."""
    return names is None or name in names or any(each.endswith("/") and name.startswith(each) for each in names)


def check_found(names: Sequence[str] | None, arrays: Collection[str], where: str) -> None:
    """Refuse data that lacks a requested array.

    Args:
        names: requested arrays or prefixes; all if None.
        arrays: names of the arrays that exist.
        where: name of the data in messages.

    Raises:
        ConfigurationError: an array is missing; the message names it.
    """
    for asked in names or ():
        if not any(chosen(found, (asked,)) for found in arrays):
            raise ConfigurationError(f"{where} has no '{asked}', which is required here")


# Limit of an episode's steps, which no real recording reaches.
_LONGEST = 100_000_000
# Bytes of an array that are checked at a time.
_STRETCH = 1 << 24
# Bytes of memory for one EpisodeInfo.
_INFO_BYTES = 512


def check_infos(infos: Sequence[EpisodeInfo], account: ReadAccount) -> None:
    """Refuse impossible lengths, and more episodes than the memory budget allows.

    Args:
        infos: facts of all episodes of a dataset.
        account: account of the opening.

    Raises:
        ConfigurationError: a length is impossible, or the budget is exceeded.
    """
    account.take("all episodes", _INFO_BYTES * len(infos))
    for position, info in enumerate(infos):
        if not 0 < info.length <= _LONGEST:
            raise ConfigurationError(f"episode {position} of {account.where} would have {info.length} steps")
        if info.taught is not None and not 0 <= info.taught <= info.length:
            raise ConfigurationError(
                f"a person would have led {info.taught} of the {info.length} steps of episode {position} of "
                f"{account.where}"
            )


def check_episode(episode: Episode, where: str, whole: bool = True) -> None:
    """Refuse arrays of unequal length or with anything but finite numbers.

    Args:
        episode: episode to check.
        where: name of the episode in messages.
        whole: whether all arrays were read, so that actions must be among them.

    Raises:
        ConfigurationError: an array is invalid; the message names it.
    """
    if whole and ACTIONS not in episode.arrays:
        raise ConfigurationError(f"{where} has no actions")
    for name, array in episode.arrays.items():
        for part in name.split("/"):
            check_name(part, where)
        if array.dtype.kind not in "fiub":
            raise ConfigurationError(f"'{name}' of {where} is of {array.dtype}: an episode holds only numbers")
        if not name.startswith(INITIAL) and (array.ndim < 1 or len(array) != episode.info.length):
            raise ConfigurationError(
                f"'{name}' of {where} has shape {array.shape}, but the episode has {episode.info.length} steps"
            )
        # In stretches: the check of a whole array of pictures would double the memory that it takes.
        if array.dtype.kind == "f" and not all(np.isfinite(rows).all() for rows in _stretches(array)):
            raise ConfigurationError(f"'{name}' of {where} holds NaN or infinity")


def _stretches(array: Array) -> Iterator[Array]:
    """Yield an array some rows at a time, so that computations with them take little memory."""
    rows = array if array.ndim else array[None]
    step = max(1, _STRETCH * len(rows) // max(1, array.nbytes))
    yield from (rows[begin : begin + step] for begin in range(0, len(rows), step))
