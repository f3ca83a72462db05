"""Opening and writing of datasets in all formats; the path determines the format."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from orbit_core.envs.observation_layout import POLICY
from orbit_core.files import as_path, sweep, written_whole
from orbit_core.interfaces import ConfigurationError
from orbit_data.card import CARD, card, check_card, write_card
from orbit_data.episodes import ACTIONS, DONES, NEXT, OBSERVED, REWARDS, TAUGHT, Dataset, Episode
from orbit_data.hdf5 import SUFFIX, Hdf5Dataset, write_hdf5
from orbit_data.hdf5 import check_replaceable as check_replaceable_file
from orbit_data.lerobot import INFO, LeRobotDataset, check_replaceable, write_lerobot
from orbit_data.lerobot import check_recordable as check_lerobot
from orbit_data.manifest.manifest import Kind, Manifest, differences
from orbit_data.noise import CLEAN
from orbit_data.reading.budget import TRUSTED, ReadBudget
from orbit_data.reading.hdf5 import hdf5_module
from orbit_data.reading.parquet import arrow_modules
from orbit_data.zarr_reader import SUFFIXES as ZARR
from orbit_data.zarr_reader import ZarrDataset, is_zarr

_SUFFIXES = (SUFFIX, ".h5")


@contextmanager
def opened(path: Path | str, budget: ReadBudget = ReadBudget()) -> Iterator[Dataset]:
    """Open a dataset: an HDF5 file, a folder of LeRobot's, or a Zarr replay buffer.

    Args:
        path: path of the file or folder.
        budget: limits of memory and time for opening it, and for reading each episode.

    Raises:
        ConfigurationError: no dataset is there, or it cannot be read.
    """
    path = as_path(path)
    reader = ZarrDataset if is_zarr(path) else LeRobotDataset if path.is_dir() else Hdf5Dataset
    dataset = reader(path, budget)
    try:
        yield dataset
    finally:
        dataset.close()


def write_dataset(
    path: Path | str,
    episodes: Iterable[Episode],
    manifest: Manifest | None,
    rate: float | None = None,
    masks: Mapping[str, Sequence[int]] | None = None,
    compression: str | None = None,
) -> set[str]:
    """Write a dataset with its card: HDF5 if the name ends in .hdf5 or .h5, otherwise a LeRobot folder.

    The dataset is written next to its place, opened again to check it, and only then takes its place.

    Args:
        path: path of the file or folder, which is replaced once the new one is complete.
        episodes: episodes in their order.
        manifest: manifest of the environment, if it is known.
        rate: steps per second, if no manifest states it.
        masks: subsets by name, as positions; only HDF5 can store them.
        compression: compression of all arrays of an HDF5 file: ``"gzip"`` or ``"lzf"``.

    Returns:
        Names of arrays that the format cannot store.

    Raises:
        ConfigurationError: LeRobot needs a rate that is unknown, the format does not support an argument, or the
            folder or card that would be replaced was not written by ORBIT.
        StorageError: the disk is full, or the folder cannot be written.
    """
    path = as_path(path)
    check_target(path)
    sweep(path.resolve().parent)
    if path.suffix in _SUFFIXES:
        write_hdf5(path, episodes, manifest, masks, compression)
        write_card(path)
        return set()
    if compression is not None or masks:
        raise ConfigurationError(f"{path} would be a LeRobot dataset, which has no compression and no subsets")
    step_rate = rate if manifest is None else 1.0 / manifest.step_dt
    if step_rate is None:
        raise ConfigurationError("the number of steps per second is unknown: give --rate, which LeRobot needs")
    return _write_folder(path, episodes, manifest, step_rate, None)


def _write_folder(
    path: Path, episodes: Iterable[Episode], manifest: Manifest | None, rate: float, continued: LeRobotDataset | None
) -> set[str]:
    # The path behind a link, so that the link stays and its target is replaced.
    with written_whole(path.resolve()) as written:
        left_out = write_lerobot(written, episodes, manifest, rate, continued)
        with opened(written, TRUSTED) as dataset:
            (written / CARD).write_text(card(dataset), encoding="utf-8")
        check_replaceable(path)  # again, because a person may have put something there in the meantime
    return left_out


def gather_dataset(path: Path, episodes: Iterable[Episode], manifest: Manifest, size: int, continued: bool) -> set[str]:
    """Write the episodes of a recording, in its format, with their card.

    Args:
        path: path of the file or folder, which is replaced once the new one is complete.
        episodes: episodes in their order.
        manifest: manifest of the environment.
        size: estimate of the episodes' bytes.
        continued: whether the episodes of the dataset that is there come first.

    Returns:
        Names of arrays that the format cannot store.

    Raises:
        StorageError: the disk is full, or the folder cannot be written.
    """
    if path.suffix not in _SUFFIXES:
        # Pictures of earlier episodes are linked, not encoded again.
        before = LeRobotDataset(path, TRUSTED) if continued else None
        return _write_folder(path, episodes, manifest, 1.0 / manifest.step_dt, before)
    if continued:
        size += path.stat().st_size
        with opened(path, TRUSTED) as dataset:
            write_hdf5(path, itertools.chain(read_all((dataset,)), episodes), manifest, size=size)
    else:
        write_hdf5(path, episodes, manifest, size=size)
    write_card(path)
    return set()


def is_dataset(path: Path) -> bool:
    """Return True if a dataset is at a path, and not an empty folder."""
    return (path / INFO).is_file() if path.is_dir() else path.exists()


def check_installed(path: Path) -> None:
    """Check that the package of a new dataset's format is installed.

    Raises:
        ConfigurationError: it is not.
    """
    hdf5_module() if path.suffix in _SUFFIXES else arrow_modules()


def check_recordable(path: Path, manifest: Manifest) -> None:
    """Check that the format of a new dataset can store an environment's episodes, before any is recorded.

    Raises:
        ConfigurationError: it cannot; the message says why.
    """
    if path.suffix not in _SUFFIXES:
        check_lerobot(manifest)


def check_target(path: Path) -> None:
    """Reject the path of a new dataset that has no known format, or where something else would be lost.

    Raises:
        ConfigurationError: the suffix belongs to no format that can be written, the file or folder is anything but a
            dataset that ORBIT wrote, or a file in the place of the card is not a card.
    """
    if path.suffix in _SUFFIXES:
        if path.is_dir():
            raise ConfigurationError(f"cannot write {path}: it is a folder")
        check_replaceable_file(path)
        return check_card(path)
    if path.name.endswith(ZARR):
        raise ConfigurationError(f"{path} would be Zarr, which is read and not written: name it *.hdf5, or a folder")
    if path.suffix:
        raise ConfigurationError(f"{path} is of no format that is written: name it *.hdf5, or a folder, for LeRobot")
    return check_replaceable(path)


def read_all(datasets: Iterable[Dataset]) -> Iterator[Episode]:
    """Yield all episodes of some datasets, one after the other."""
    for dataset in datasets:
        yield from map(dataset.read, range(len(dataset.episodes)))


def common_manifest(datasets: Sequence[Dataset]) -> Manifest | None:
    """Return the manifest of datasets that can be merged: the first one's, if they differ only in notes.

    Raises:
        ConfigurationError: numbers mean different things in them; the message names every difference.
    """
    first, *others = datasets
    for other in others:
        if (first.manifest is None) != (other.manifest is None):
            raise ConfigurationError(
                f"only one of {first.path} and {other.path} has a manifest: convert each by itself"
            )
        if first.manifest is None or other.manifest is None:
            continue
        graver = [d for d in differences(first.manifest, other.manifest) if d.kind is not Kind.NOTE]
        if graver:
            listed = "; ".join(str(difference) for difference in graver)
            raise ConfigurationError(f"{first.path} and {other.path} are not of one kind: {listed}")
    return None if first.manifest is None else _of_all(first.manifest, [each.known() for each in others])


def _of_all(first: Manifest, others: Sequence[Manifest]) -> Manifest:
    """Return a manifest without facts of its recording that others do not share."""
    differing = [name for name in ("noise", "stray") if any(getattr(first, name) != getattr(o, name) for o in others)]
    return replace(first, **dict.fromkeys(differing))


def shared_manifest(datasets: Sequence[Dataset]) -> Manifest:
    """Return a manifest of what datasets of several tasks have alike: robot, action, rate, and the policy's terms.

    It names all tasks and describes no environment, for there is none of all of them.

    Raises:
        ConfigurationError: one has no manifest, their robots, actions or rates differ, or no term is shared.
    """
    first, *others = manifests = [dataset.known() for dataset in datasets]
    for dataset, other in zip(datasets[1:], others, strict=True):
        found = differences(_acting(first), _acting(other), ())
        wrong = [str(each) for each in found if each.kind is Kind.ERROR]
        if wrong:
            raise ConfigurationError(
                f"{datasets[0].path} and {dataset.path} share no robot or action: {'; '.join(wrong)}"
            )
    seen = [manifest.observations[POLICY].terms if POLICY in manifest.observations else {} for manifest in manifests]
    terms = {name: term for name, term in seen[0].items() if all(each.get(name) == term for each in seen[1:])}
    if not terms:
        told = "; ".join(", ".join(each) or "none" for each in seen)
        raise ConfigurationError(f"no term that the policy sees is the same in all datasets ({told})")
    return replace(
        _of_all(_acting(first), others),
        task=", ".join(dict.fromkeys(manifest.task for manifest in manifests)),
        configuration={},
        observations={POLICY: replace(first.observations[POLICY], terms=terms)},
        assets={},
    )


def _acting(manifest: Manifest) -> Manifest:
    """Return a manifest with the robots that act only."""
    return replace(manifest, robots={name: robot for name, robot in manifest.robots.items() if robot.agent})


_SHARED = (ACTIONS, CLEAN, REWARDS, DONES, TAUGHT)


def read_shared(datasets: Iterable[Dataset], manifest: Manifest) -> Iterator[Episode]:
    """Yield all episodes of some datasets with what all of them have, each with its task's words.

    Args:
        datasets: to read.
        manifest: of what they share, :func:`shared_manifest`.
    """
    terms = manifest.observations[POLICY].terms
    wanted = {*_SHARED, *(prefix + name for name in terms for prefix in (OBSERVED, NEXT))}
    for dataset in datasets:
        for place, info in enumerate(dataset.episodes):
            episode = dataset.read(place)
            told = replace(info, instruction=info.instruction or dataset.known().task)
            yield Episode(told, {name: array for name, array in episode.arrays.items() if name in wanted})


def divided(count: int, share: float, seed: int) -> dict[str, list[int]]:
    """Divide positions randomly into ``train`` and ``valid``.

    Args:
        count: number of episodes.
        share: share of them that ``valid`` gets.
        seed: seed of the random choice.

    Raises:
        ConfigurationError: one of the two would be empty.
    """
    # NaN and infinity cannot be rounded, and count as an empty share.
    held_out = round(share * count) if math.isfinite(share) else 0
    if not 0 < held_out < count:
        raise ConfigurationError(f"{share:g} of {count} episodes is none or all of them: give another share")
    order = np.random.default_rng(seed).permutation(count)
    return {"train": sorted(order[held_out:].tolist()), "valid": sorted(order[:held_out].tolist())}
