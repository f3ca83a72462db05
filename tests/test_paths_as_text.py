"""Whoever takes a path takes text, and refuses anything else in one sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from orbit_assets import load_articulation
from orbit_assets.audit.audit import audit_file
from orbit_conformance.merge import merge
from orbit_conformance.recording import Recording
from orbit_conformance.report.page import write_report
from orbit_conformance.results import load
from orbit_conformance.tasks import compare_recordings
from orbit_core.files import as_path, read_bytes
from orbit_core.interfaces import ArgumentError, OrbitError
from orbit_data.card import write_card
from orbit_data.episodes import Episode, EpisodeInfo
from orbit_data.formats import opened, write_dataset
from orbit_data.hdf5 import Hdf5Dataset, write_hdf5
from orbit_data.lerobot import LeRobotDataset, read_video, write_lerobot, write_video
from orbit_data.reading.budget import ReadAccount, ReadBudget
from orbit_data.recording import PartFolder, RecordingFile
from orbit_data.tensor_file import read_tensors, write_tensors
from orbit_data.zarr_reader import ZarrDataset, is_zarr
from orbit_learn.actuators.networks import NetworkDescription, read_network, write_network
from orbit_learn.actuators.recordings import read_recording
from orbit_learn.description import Part, PolicyDescription
from orbit_learn.networks import Perceptron
from orbit_learn.onnx_file import read_onnx
from orbit_learn.policy import Policy, load_policy
from orbit_learn.policy_file import newest_file, read_policy
from orbit_learn.pretrained import policy_path
from orbit_learn.training import read_checkpoint, write_checkpoint
from orbit_viewer.video import VideoFile


def episodes() -> list[Episode]:
    return [Episode(EpisodeInfo(0, 4), {"actions": np.zeros((4, 2), np.float32)})]


def policy() -> Policy:
    description = PolicyDescription(
        "Reach", "a_robot", "joints", (Part("seen", 3),), (Part("moved", 2),), 0.02, "an_engine", "a_library", 1
    )
    return Policy(Perceptron((4,)).build(3, 2), Perceptron((4,)), description)


def network() -> Any:
    return NetworkDescription(kind="mlp", hidden_sizes=(4,), rate=200.0).build()


def account() -> ReadAccount:
    return ReadAccount(ReadBudget(), "it")


WRITERS: dict[str, Callable[[Any], Any]] = {
    "a.hdf5": lambda path: write_hdf5(path, episodes(), None),
    "b.hdf5": lambda path: write_dataset(path, episodes(), None),
    "folder": lambda path: write_lerobot(path, episodes(), None, 50.0),
    "policy_1.safetensors": lambda path: policy().save(path),
    "policy.onnx": lambda path: policy().export_onnx(path),
    "tensors.safetensors": lambda path: write_tensors(path, {}, {"a": torch.ones(2)}),
    "checkpoint_1.safetensors": lambda path: write_checkpoint(path, "a_library", [1]),
    "actuator.safetensors": lambda path: write_network(path, network()),
    "video.mp4": lambda path: write_video(path, [np.zeros((2, 32, 32, 3), np.uint8)], 50),
}
READERS: dict[str, tuple[Callable[[Any], Any], ...]] = {
    "a.hdf5": (Hdf5Dataset, write_card, RecordingFile),
    "folder": (LeRobotDataset, is_zarr),
    "policy_1.safetensors": (load_policy, read_policy, read_tensors, read_bytes, policy_path),
    "policy.onnx": (load_policy, read_onnx),
    "checkpoint_1.safetensors": (lambda path: read_checkpoint(path, "a_library"),),
    "actuator.safetensors": (read_network,),
    "video.mp4": (lambda path: read_video(path, 0, 1, account()),),
    "": (lambda path: newest_file(path, "policy"), load_policy, PartFolder),
}
REFUSING: tuple[Callable[[Any], Any], ...] = (
    read_recording, ZarrDataset, Recording.load, load, lambda path: merge([path], path), write_report,
    audit_file, load_articulation, lambda path: compare_recordings(path, path),
)  # fmt: skip


def test_text_is_a_path_for_writers_and_readers(tmp_path: Path) -> None:
    for name, write in WRITERS.items():
        write(str(tmp_path / name))
        assert (tmp_path / name).exists()
    for name, readers in READERS.items():
        for read in readers:
            read(str(tmp_path / name))
    with opened(str(tmp_path / "folder")) as dataset:
        assert len(dataset.episodes) == 1
    VideoFile(str(tmp_path / "film.mp4"), 32, 32, 10.0).discard()


@pytest.mark.parametrize("read", REFUSING)
def test_text_that_names_nothing_is_one_error_of_ours(read: Callable[[Any], Any], tmp_path: Path) -> None:
    (tmp_path / "other.txt").write_text("{}")
    for name in ("missing.npz", "missing", "other.txt"):
        with pytest.raises(OrbitError):
            read(str(tmp_path / name))


@pytest.mark.parametrize("wrong", [None, 5, b"bytes", "", "a\0b", ["a"]])
def test_what_is_no_path_is_told_so(wrong: Any) -> None:
    with pytest.raises(ArgumentError, match="is no path of a file or folder"):
        as_path(wrong)
    for read in (load_policy, Hdf5Dataset, read_recording, read_network, Recording.load, load, VideoFile):
        with pytest.raises(ArgumentError, match="is no path of a file or folder"):
            read(wrong, 32, 32, 10.0) if read is VideoFile else read(wrong)
