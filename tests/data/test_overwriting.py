"""Datasets are replaced only by what is whole, and nothing else is replaced by them."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from orbit_core.cli import main
from orbit_core.files import sweep
from orbit_core.interfaces import ConfigurationError
from orbit_data.episodes import Episode, EpisodeInfo
from orbit_data.formats import opened, write_dataset
from orbit_data.hdf5 import write_hdf5
from tests.faults import kills, no_file_beyond, small_disk


def episodes(count: int, spoilt: int | None = None, length: int = 20) -> Iterator[Episode]:
    """Episodes whose numbers tell which they are; one of them holds NaN."""
    for number in range(count):
        actions = np.full((length, 3), number, np.float32)
        if number == spoilt:
            actions[2] = np.nan
        joints = np.random.default_rng(number).normal(size=(length, 7)).astype(np.float32)
        yield Episode(EpisodeInfo(number, length, success=True), {"actions": actions, "obs/joints": joints})


def written(path: Path, count: int, length: int = 20) -> Path:
    write_dataset(path, episodes(count, length=length), None, rate=50.0)
    return path


def counted(path: Path) -> int:
    """The number of episodes in a dataset, all of which are read."""
    with opened(path) as dataset:
        for place in range(len(dataset.episodes)):
            assert (dataset.read(place).arrays["actions"] == place).all()
        return len(dataset.episodes)


def files(folder: Path) -> dict[str, bytes]:
    """What each file within a folder holds, by its path."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


OUTPUTS = ("out", "out.hdf5")
"""A folder in LeRobot's layout, and an HDF5 file."""


@pytest.mark.parametrize("name", OUTPUTS)
def test_a_dataset_is_replaced_by_one_that_is_whole(name: str, tmp_path: Path) -> None:
    source, output = written(tmp_path / "source.hdf5", 5), written(tmp_path / name, 2)
    words = ["data", "convert", str(source), "--output", str(output), "--rate", "50"]
    assert main(words) == 2
    assert counted(output) == 2
    before = {path.name for path in tmp_path.iterdir()}
    assert main([*words, "--overwrite"]) == 0
    assert counted(output) == 5
    assert {path.name for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("command", ["convert", "filter", "merge"])
@pytest.mark.parametrize("name", OUTPUTS)
def test_nan_in_the_source_leaves_the_dataset_that_was_there(command: str, name: str, tmp_path: Path, capsys) -> None:
    output = written(tmp_path / name, 2)
    write_hdf5(tmp_path / "source.hdf5", episodes(5, spoilt=3), None)
    before = files(tmp_path)
    sources = [str(tmp_path / "source.hdf5")] * (2 if command == "merge" else 1)
    assert main(["data", command, *sources, "--output", str(output), "--rate", "50", "--overwrite"]) == 2
    assert "'actions' of demo_3" in capsys.readouterr().err
    assert files(tmp_path) == before


def foreign(kind: str, folder: Path) -> Path:
    """An output that ``--overwrite`` must not replace."""
    output = folder / "out"
    if kind == "no dataset":
        (output / "src").mkdir(parents=True)
        (output / "src" / "thesis.tex").write_text("years")
        return output
    if kind == "file":
        output.write_text("years")
        return output
    if kind == "another's card":
        (folder / "out.md").write_text("# out\n\nmy notes\n")
        return folder / "out.hdf5"
    if kind == "another's file":
        (folder / "out.hdf5").write_text("years")
        return folder / "out.hdf5"
    if kind == "of robomimic":
        write_hdf5(folder / "out.hdf5", episodes(2), None)
        with h5py.File(folder / "out.hdf5", "r+") as file:
            for demo in file["data"].values():  # pyright: ignore[reportAttributeAccessIssue]
                del demo.attrs["orbit_episode"]
        return folder / "out.hdf5"
    written(output, 2)
    if kind == "notes in it":
        (output / "notes.txt").write_text("years")
    elif kind == "a hidden file in it":
        (output / "meta" / ".notes").write_text("years")
    elif kind == "another card in it":
        (output / "README.md").write_text("# my dataset\n")
    elif kind == "a link in it":
        (output / "data" / "more").symlink_to(folder)
    elif kind == "of others":
        (output / "meta" / "orbit_episodes.json").unlink()
    return output


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("no dataset", "it holds src/thesis.tex"),
        ("file", "is a file, which no folder replaces"),
        ("another's card", "out.md is in the place of the card"),
        ("another's file", "out.hdf5 is not a dataset that ORBIT wrote"),
        ("of robomimic", "out.hdf5 is not a dataset that ORBIT wrote"),
        ("notes in it", "it holds notes.txt"),
        ("a hidden file in it", "it holds meta/.notes"),
        ("another card in it", "it holds README.md"),
        ("a link in it", "it holds data/more"),
        ("of others", "is not, or not only, a dataset that ORBIT wrote"),
    ],
)
def test_what_is_no_dataset_of_ours_is_not_replaced(kind: str, message: str, tmp_path: Path, capsys) -> None:
    written(tmp_path / "source.hdf5", 3)
    output = foreign(kind, tmp_path)
    before = files(tmp_path)
    words = ["data", "convert", str(tmp_path / "source.hdf5"), "--output", str(output), "--rate", "50", "--overwrite"]
    assert main(words) == 2
    assert message in capsys.readouterr().err
    assert files(tmp_path) == before


def test_what_is_put_into_a_dataset_while_it_is_being_replaced_stays(tmp_path: Path) -> None:
    output = written(tmp_path / "out", 2)

    def slow() -> Iterator[Episode]:
        yield from episodes(3)
        (output / "notes.txt").write_text("years")

    with pytest.raises(ConfigurationError, match=r"it holds notes\.txt"):
        write_dataset(output, slow(), None, rate=50.0)
    assert (output / "notes.txt").read_text() == "years"
    assert counted(output) == 2


@pytest.mark.parametrize(
    ("output", "message"),
    [
        (".", "holds source.hdf5, which is read"),
        ("..", "which is read"),
        ("../here", "which is read"),
        ("source.hdf5", "is what is read"),
        ("../here/../here/source.hdf5", "is what is read"),
        ("link.hdf5", "is what is read"),
        ("../elsewhere", "is the working folder, or holds it"),
    ],
)
@pytest.mark.parametrize("command", ["convert", "merge"])
def test_an_output_that_is_or_holds_what_is_read_is_refused(
    command: str, output: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "notes.txt").write_text("years")
    source = written(tmp_path / "here" / "source.hdf5", 3)
    (tmp_path / "here" / "link.hdf5").symlink_to(source)
    monkeypatch.chdir(tmp_path / "here")
    name = "source.hdf5"
    if output == "../elsewhere":
        (tmp_path / "elsewhere").mkdir()
        monkeypatch.chdir(tmp_path / "elsewhere")
        name = "../here/source.hdf5"
    before = files(tmp_path)
    sources = [name] * (2 if command == "merge" else 1)
    assert main(["data", command, *sources, "--output", output, "--rate", "50", "--overwrite"]) == 2
    assert message in capsys.readouterr().err
    assert files(tmp_path) == before


def test_a_folder_that_is_read_is_not_written_into(tmp_path: Path, capsys) -> None:
    source = written(tmp_path / "source", 3)
    for name in ("inner.hdf5", "data"):
        assert main(["data", "convert", str(source), "--output", str(source / name), "--overwrite"]) == 2
        assert f"is in {source}, which is read" in capsys.readouterr().err


@pytest.mark.parametrize("name", OUTPUTS)
def test_a_kill_at_any_moment_leaves_the_old_dataset_or_the_new_one(name: str, tmp_path: Path) -> None:
    folder, old, found = tmp_path / "here", tmp_path / "old", set()
    old.mkdir()
    written(old / name, 2)

    def prepare() -> None:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(old, folder)

    for _ in kills(folder, lambda: written(folder / name, 3), prepare):
        found.add(counted(folder / name))
        sweep(folder)
        assert {path.name for path in folder.iterdir()} == {path.name for path in old.iterdir()}
    assert found == {2, 3}


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
@pytest.mark.parametrize(
    ("command", "name"),
    [("convert", "out"), ("convert", "out.hdf5"), ("filter", "out"), ("merge", "out.hdf5"), ("split", "source.hdf5")],
)
def test_a_disk_that_fills_leaves_the_dataset_that_was_there(
    command: str, name: str, share: float, tmp_path: Path, capsys
) -> None:
    """No file may grow beyond a share of the largest one that the command writes."""
    source = written(tmp_path / "source.hdf5", 30)
    output = source if command == "split" else written(tmp_path / name, 2)
    sources = [str(source)] * (2 if command == "merge" else 1)
    words = ["data", command, *sources, *([] if command == "split" else ["--output", str(output), "--overwrite"])]
    words += [] if command == "split" else ["--rate", "50"]
    before = files(tmp_path)
    largest = 6_000 if name == "out" else len(before["source.hdf5"])
    with no_file_beyond(int(share * largest)):
        assert main(words) == 2
    assert f"cannot write {output}" in capsys.readouterr().err
    assert files(tmp_path) == before


def test_a_small_disk_that_fills_leaves_the_dataset_that_was_there(tmp_path: Path, capsys) -> None:
    source = written(tmp_path / "source.hdf5", 40, length=6_000)
    with small_disk(tmp_path / "disk", 8_000_000) as disk:
        for name in OUTPUTS:
            output = written(disk / name, 2)
            before = files(disk)
            assert main(["data", "convert", str(source), "--output", str(output), "--rate", "50", "--overwrite"]) == 2
            assert "No space left on device" in capsys.readouterr().err
            assert files(disk) == before
            shutil.rmtree(output) if output.is_dir() else output.unlink()


def test_an_output_that_is_no_regular_file_is_refused(tmp_path: Path, capsys) -> None:
    source, pipe = written(tmp_path / "source.hdf5", 1), tmp_path / "card.md"
    os.mkfifo(pipe)
    assert main(["data", "info", str(source), "--card", str(pipe), "--overwrite"]) == 2
    assert "card.md: it is no regular file" in capsys.readouterr().err
    assert pipe.is_fifo()
