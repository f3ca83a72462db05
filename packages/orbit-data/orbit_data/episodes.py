"""Episodes as data: what one holds by name, what is known of it, and what every file format gives and takes."""

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
OBSERVED, NEXT, POSES, CONTACTS, INITIAL = "obs/", "next_obs/", "poses/", "contacts/", "initial/"
"""What the names of arrays begin with: observations before a step and after it, poses (T, 7) of end effectors and
objects, forces on links, and what the task remembered when the episode began, without the dimension of time."""


@dataclass(frozen=True)
class EpisodeInfo:
    """What is known of an episode besides its arrays."""

    number: int
    """Its place among all that were begun."""
    length: int
    """T, steps."""
    success: bool | None = None
    """None where nobody said."""
    episode_return: float = 0.0
    """Sum of the rewards."""
    metrics: dict[str, float] = field(default_factory=dict)
    """The task's, at the end."""
    seed: int | None = None
    """Of the environment's random stream; with the next two it says how the episode began."""
    env_id: int | None = None
    episode: int | None = None
    """Which of the environment's episodes it was."""
    backend: str = ""
    """The engine that it ran on."""


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode: arrays by name, (T, ...) each but for those of ``initial/``; row t is before action t."""

    info: EpisodeInfo
    arrays: Mapping[str, Array]

    def named(self, prefix: str) -> dict[str, Array]:
        """Return the arrays whose names begin so, by the rest of their names."""
        return {name.removeprefix(prefix): array for name, array in self.arrays.items() if name.startswith(prefix)}


class Dataset(ABC):
    """Recorded episodes, in whatever format. Reading executes nothing that a file holds."""

    path: Path
    manifest: Manifest | None
    """Of the environment that they were recorded in; None in foreign files."""
    episodes: Sequence[EpisodeInfo]
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
            ConfigurationError: the file holds none.
        """
        if self.manifest is None:
            raise ConfigurationError(
                f"{self.path} holds no manifest, which this needs: it was not recorded by ORBIT, and nothing says what "
                "its numbers mean"
            )
        return self.manifest


def chosen(name: str, names: Sequence[str] | None) -> bool:
    """Whether an array is asked for, by its name or by a prefix that ends in ``/``."""
    return names is None or name in names or any(each.endswith("/") and name.startswith(each) for each in names)


def check_found(names: Sequence[str] | None, arrays: Collection[str], where: str) -> None:
    """Refuse what lacks an array that is asked for.

    Raises:
        ConfigurationError: names the array.
    """
    for asked in names or ():
        if not any(chosen(found, (asked,)) for found in arrays):
            raise ConfigurationError(f"{where} has no '{asked}', which this needs")


# Steps of an episode; no recording comes near.
_LONGEST = 100_000_000
# Bytes of an array that are checked at a time.
_STRETCH = 1 << 24
# Memory of what is known of an episode.
_INFO_BYTES = 512


def check_infos(infos: Sequence[EpisodeInfo], account: ReadAccount) -> None:
    """Refuse lengths that no episode has, and more episodes than memory is allowed for.

    Args:
        infos: of all episodes of a dataset.
        account: of its opening.

    Raises:
        ConfigurationError: names the episode.
    """
    account.take("all episodes", _INFO_BYTES * len(infos))
    for position, info in enumerate(infos):
        if not 0 < info.length <= _LONGEST:
            raise ConfigurationError(f"episode {position} of {account.where} would have {info.length} steps")


def check_episode(episode: Episode, where: str, whole: bool = True) -> None:
    """Refuse arrays of unequal length, of other than numbers, or without actions if it is ``whole``.

    Raises:
        ConfigurationError: names the array.
    """
    if whole and ACTIONS not in episode.arrays:
        raise ConfigurationError(f"{where} has no actions")
    for name, array in episode.arrays.items():
        for part in name.split("/"):
            check_name(part, where)
        if array.dtype.kind not in "fiub":
            raise ConfigurationError(f"'{name}' of {where} is of {array.dtype}: an episode holds numbers alone")
        if not name.startswith(INITIAL) and (array.ndim < 1 or len(array) != episode.info.length):
            raise ConfigurationError(
                f"'{name}' of {where} has shape {array.shape}, but the episode has {episode.info.length} steps"
            )
        if array.dtype.kind == "f" and not all(np.isfinite(rows).all() for rows in _stretches(array)):
            raise ConfigurationError(f"'{name}' of {where} holds NaN or infinity")


def _stretches(array: Array) -> Iterator[Array]:
    """Yield an array some rows at a time, so that what is computed of them takes little memory."""
    rows = array if array.ndim else array[None]
    step = max(1, _STRETCH * len(rows) // max(1, array.nbytes))
    yield from (rows[begin : begin + step] for begin in range(0, len(rows), step))
