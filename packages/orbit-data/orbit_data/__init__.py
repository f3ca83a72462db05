"""Demonstrations: what environments do, recorded, kept in files that the field reads, replayed and multiplied."""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbit_core.exports import lazy_names

if TYPE_CHECKING:
    from orbit_data.augmentation import augment
    from orbit_data.episodes import Dataset, Episode, EpisodeInfo
    from orbit_data.formats import opened, write_dataset
    from orbit_data.hdf5 import Hdf5Dataset, write_hdf5
    from orbit_data.lerobot import LeRobotWriter, write_lerobot
    from orbit_data.recording import DemonstrationRecorder, record
    from orbit_data.replay import ReplayResult
    from orbit_data.zarr_reader import ZarrDataset

__all__ = [
    "Dataset",
    "DemonstrationRecorder",
    "Episode",
    "EpisodeInfo",
    "Hdf5Dataset",
    "LeRobotWriter",
    "ReplayResult",
    "ZarrDataset",
    "augment",
    "opened",
    "record",
    "write_dataset",
    "write_hdf5",
    "write_lerobot",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "augmentation": ("augment",),
        "episodes": (
            "Dataset",
            "Episode",
            "EpisodeInfo",
        ),
        "formats": (
            "opened",
            "write_dataset",
        ),
        "hdf5": (
            "Hdf5Dataset",
            "write_hdf5",
        ),
        "lerobot": (
            "LeRobotWriter",
            "write_lerobot",
        ),
        "recording": ("DemonstrationRecorder", "record"),
        "replay": ("ReplayResult",),
        "zarr_reader": ("ZarrDataset",),
    },
)
