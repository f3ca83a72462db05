"""A disk that is full while anything is written: one error that names the file, and all that was there stays."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from orbit_assets.mjcf import write_mjcf
from orbit_assets.urdf import write_urdf
from orbit_assets.usd import write_usd
from orbit_conformance.recording import Recording
from orbit_core.cli import main
from orbit_core.cli.bench import Throughput, _plot
from orbit_core.cli.output import write_json
from orbit_core.files import append_line
from orbit_core.interfaces import StorageError
from orbit_core.scene import Articulation, Link, Mesh, Pose, Shape
from orbit_data.card import write_card
from orbit_data.episodes import Episode, EpisodeInfo
from orbit_data.formats import write_dataset
from orbit_data.recording import PartFolder
from orbit_learn.actuators.networks import NetworkDescription, write_network
from orbit_learn.description import Part, PolicyDescription
from orbit_learn.networks import Perceptron
from orbit_learn.policy import Policy
from orbit_learn.training import write_checkpoint
from orbit_viewer.video import VideoFile
from tests.faults import no_file_beyond, small_disk

CORNERS = np.random.default_rng(0).normal(size=(8, 3))
BODY = Articulation(
    "body",
    (
        Link(
            "base",
            1.0,
            Pose().position,
            np.eye(3),
            collisions=(Shape(Mesh(CORNERS, np.array([[0, 1, 2], [3, 4, 5]]))),),
        ),
    ),
)
POLICY = PolicyDescription(
    "Reach", "a_robot", "joint_position", (Part("seen", 3),), (Part("moved", 2),), 0.02, "an_engine", "a_library", 1
)


def episodes(picture: bool = False) -> Iterator[Episode]:
    for number in range(2):
        arrays = {"actions": np.random.default_rng(number).normal(size=(50, 7))}
        if picture:
            arrays["obs/front"] = np.random.default_rng(number).integers(0, 255, (50, 32, 48, 3), np.uint8)
        yield Episode(EpisodeInfo(number, 50), arrays)


def policy() -> Policy:
    network = Perceptron((4,))
    return Policy(network.build(POLICY.observation_size, POLICY.action_size), network, POLICY)


def film(path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="the capability is videos, which need an encoder")
    with VideoFile(path, 64, 48, 25.0) as video:
        for number in range(20):
            video.add(np.random.default_rng(number).integers(0, 255, (48, 64, 3), np.uint8))


def part(path: Path) -> None:
    path.mkdir(exist_ok=True)
    PartFolder(path).add([EpisodeInfo(0, 50)], next(episodes()).arrays)


def recording(path: Path) -> None:
    actions = np.random.default_rng(0).normal(size=(50, 2, 7)).astype(np.float32)
    Recording("Reach", "an_engine", 0, {}, 0.02, actions, np.array([50, 50]), {"hand": actions}).save(path)


WRITERS: dict[str, Callable[[Path], object]] = {
    "result.json": lambda path: write_json(path, [*range(1000)]),
    "curve.jsonl": lambda path: append_line(path, "0" * 4000),
    "plot.png": lambda path: _plot([Throughput(n, 1.0, 1.0, 1.0) for n in (1, 2)], "Reach", path),
    "film.mp4": film,
    "recording.parts": part,
    "numbers.hdf5": lambda path: write_dataset(path, episodes(), None),
    "numbers.md": lambda path: write_card(path.with_suffix(".hdf5")),
    "lerobot": lambda path: write_dataset(path, episodes(picture=True), None, rate=50.0),
    "recording.npz": recording,
    "policy.safetensors": lambda path: policy().save(path),
    "policy.onnx": lambda path: policy().export_onnx(path),
    "checkpoint.safetensors": lambda path: write_checkpoint(path, "a_library", {"weights": torch.randn(100)}),
    "actuator.safetensors": lambda path: write_network(
        path, NetworkDescription(kind="mlp", hidden_sizes=(5, 5), rate=200.0, scales=(0.5, 2.0, 3.0)).build()
    ),
    "body.urdf": lambda path: write_urdf(BODY, path),
    "body.xml": lambda path: write_mjcf(BODY, path),
    "body.usda": lambda path: write_usd(BODY, path),
    "body.usdc": lambda path: write_usd(BODY, path),
}
"""Everything that commands write, by the name of an example."""


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@contextlib.contextmanager
def filled(disk: Path) -> Iterator[None]:
    """The disk with nothing left on it."""
    with contextlib.suppress(OSError), (disk / "rest").open("wb", buffering=0) as file:
        while True:
            file.write(bytes(1024))
    yield
    (disk / "rest").unlink()


def refused(name: str, path: Path) -> None:
    with pytest.raises(StorageError, match=rf"cannot write .*{name.partition('.')[0]}"):
        WRITERS[name](path)


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_that_cannot_grow_leaves_what_was_there(name: str, tmp_path: Path) -> None:
    if name == "numbers.md":
        write_dataset(tmp_path / "numbers.hdf5", episodes(), None)
    WRITERS[name](tmp_path / name)
    before = files(tmp_path)
    with no_file_beyond(50):
        refused(name, tmp_path / name)
    assert files(tmp_path) == before
    assert not [*tmp_path.rglob(".orbit-*")]


def test_a_disk_without_room_leaves_what_was_there(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 8_000_000) as disk:
        for name, write in WRITERS.items():
            write(disk / name)
        before = files(disk)
        with filled(disk):
            for name in WRITERS:
                refused(name, disk / name)
        assert files(disk) == before
        assert not [*disk.rglob(".orbit-*")]


def test_a_command_says_in_one_line_that_there_is_no_room_for_temporary_files(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(words: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("orbit_core.cli._dispatch", full)
    assert main(["run", "Lift"]) == 2
    assert "cannot write a temporary file: No space left on device" in capsys.readouterr().err
