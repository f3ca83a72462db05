"""Recordings lose no finished episode, whatever ends the program: kills, full disks, and recording over others."""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_core.envs import Environment, make
from orbit_core.envs.actors import Actor, scripted_actor
from orbit_core.interfaces import ConfigurationError, StorageError
from orbit_data.episodes import Episode, EpisodeInfo
from orbit_data.formats import opened
from orbit_data.hdf5 import Hdf5Dataset, write_hdf5
from orbit_data.manifest.manifest import Manifest
from orbit_data.recording import PartFolder, RecordingFile, record
from tests.faults import KILLS, kills

BACKEND = default_backend()
SEED, SHORT = 3, 0.4
STEPS = round(SHORT / 0.02)


def recorded(environment: Environment, path: Path, episodes: int, actor: str = "expert") -> Hdf5Dataset:
    record(environment, lambda: scripted_actor(actor, environment, SEED), RecordingFile(path), "Lift", episodes, SEED)
    return Hdf5Dataset(path)


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    made = make("Lift", 4, BACKEND, seed=SEED, episode_length=SHORT)
    yield made
    made.close()


class Interrupted(Actor):
    """An actor that somebody stops."""

    def __init__(self, environment: Environment, steps: int, name: str = "expert") -> None:
        self._actor, self._left = scripted_actor(name, environment, SEED), steps

    def act(self) -> Tensor:
        self._left -= 1
        if self._left < 0:
            raise KeyboardInterrupt
        return self._actor.act()


def test_random_actions_of_a_resumed_recording_are_those_that_it_lacked(
    environment: Environment, tmp_path: Path
) -> None:
    whole = recorded(environment, tmp_path / "whole.hdf5", 6, "random")
    file = RecordingFile(tmp_path / "lift.hdf5")
    with pytest.raises(KeyboardInterrupt):
        record(environment, lambda: Interrupted(environment, STEPS + 5, "random"), file, "Lift", 6, SEED)
    resumed = recorded(environment, tmp_path / "lift.hdf5", 6, "random")
    assert [*resumed.episodes] == [*whole.episodes]
    actions = [resumed.read(place).arrays["actions"] for place in range(6)]
    for place, own in enumerate(actions):
        np.testing.assert_array_equal(own, whole.read(place).arrays["actions"])
        assert not any(np.array_equal(own, other) for other in actions[:place])
    whole.close()
    resumed.close()


def synthetic(number: int, length: int = 5) -> tuple[list[EpisodeInfo], dict[str, np.ndarray]]:
    """An episode whose numbers tell which it is."""
    values = np.full((length, 2000), number, np.float32)
    return [EpisodeInfo(number, length, success=True)], {"actions": values, "initial/goal": values[:1]}


def in_a_child(work) -> int:
    """Run something in a forked process that touches no tensors; its exit code comes from its end."""
    child = os.fork()
    if child == 0:
        try:
            work()
            os._exit(0)
        except StorageError as error:
            print(error, flush=True)
            os._exit(7)
        finally:
            os._exit(1)
    return child


def all_episodes(file: RecordingFile) -> Iterator[Episode]:
    """Every episode of a recording, gathered or not."""
    if file.path.exists():
        with opened(file.path) as dataset:
            yield from map(dataset.read, range(len(dataset.episodes)))
    yield from file.parts.read()


@pytest.mark.flaky(reruns=2)  # whether a kill comes in the midst of writing is a matter of chance
def test_a_kill_at_random_moments_loses_no_finished_episode(manifest: Manifest, tmp_path: Path) -> None:
    """The child tells each episode that is written; every so often it gathers all into the one file."""
    file = RecordingFile(tmp_path / "x.hdf5")
    chance, begun, gathered, torn = random.Random(0), 0, 0, 0
    for _ in range(KILLS):
        reader, writer = os.pipe()

        def work(begin: int = begun, writer: int = writer) -> None:
            file.parts.begin(manifest)
            for number in range(begin, begin + 10_000):
                if number % 5 == 0 and number > begin:
                    file.gather()
                    file.parts.begin(manifest)
                file.parts.add(*synthetic(number))
                os.write(writer, number.to_bytes(4, "little"))

        child = in_a_child(work)
        os.close(writer)
        with os.fdopen(reader, "rb") as pipe:
            # So many episodes, and a part of the next one's time: however fast the machine is.
            whole, start = chance.randrange(8), time.monotonic()
            told = pipe.read(4 * whole)
            time.sleep(chance.uniform(0.0, 2.0) * (time.monotonic() - start) / max(whole, 1))
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            told += pipe.read()
        finished = [int.from_bytes(told[i : i + 4], "little") for i in range(0, len(told) - 3, 4)]
        numbers = sorted(info.number for info in file.infos().values())
        assert numbers == [*range(len(numbers))]
        assert len(numbers) >= (finished[-1] + 1 if finished else begun)
        for episode in all_episodes(file):
            assert (episode.arrays["actions"] == episode.info.number).all()
        begun = len(numbers)
        gathered += file.path.exists()
        torn += bool([*tmp_path.glob(".orbit-*"), *file.parts.path.glob(".orbit-*")])
    assert begun > KILLS
    assert gathered > 0
    assert torn > 0  # else no kill came in the midst of writing


def synthetic_recording(file: RecordingFile, manifest: Manifest, numbers: range, overwrite: bool = False) -> None:
    """Record synthetic episodes, as the command does."""
    file.check_begun(resume=not overwrite, overwrite=overwrite)
    if overwrite:
        file.begin_anew()
    try:
        file.take_up(manifest)
        for number in sorted({*numbers} - {*file.infos()}):
            file.parts.add(*synthetic(number))
        file.gather()
    finally:
        file.release()


def kept(path: Path) -> list[int]:
    """Numbers of the episodes in a dataset's file."""
    with opened(path) as dataset:
        return [info.number for info in dataset.episodes]


@pytest.mark.parametrize("name", ["x.hdf5", "x"])
def test_a_kill_at_any_moment_of_overwriting_leaves_the_old_dataset_or_the_new_one(
    name: str, manifest: Manifest, tmp_path: Path
) -> None:
    """What was there, a finished dataset and a recording that was cut off, is there until the new one is whole."""
    folder, found = tmp_path / "here", set()
    path = folder / name

    def prepare() -> None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        synthetic_recording(RecordingFile(path), manifest, range(2))
        cut_off = RecordingFile(path)
        cut_off.take_up(manifest)
        cut_off.parts.add(*synthetic(2))
        cut_off.release()

    for _ in kills(folder, lambda: synthetic_recording(RecordingFile(path), manifest, range(10, 14), True), prepare):
        found.add(now := tuple(kept(path)))
        file = RecordingFile(path)
        file.check_begun(resume=True, overwrite=False)
        going_on = sorted(file.infos())
        file.release()
        if now == (0, 1):
            # Either the old recording goes on, or the new one with the episodes that it finished.
            assert going_on == [0, 1, 2] or going_on == [*range(10, 10 + len(going_on))]
            aside = [*folder.glob(f"{name}.parts.replaced-*")]
            assert bool(aside) == (going_on != [0, 1, 2])
            synthetic_recording(RecordingFile(path), manifest, range(10, 14) if aside else range(3, 3))
            assert kept(path) == ([10, 11, 12, 13] if aside else [0, 1, 2])
        else:
            assert going_on == [10, 11, 12, 13]
    assert found == {(0, 1), (10, 11, 12, 13)}


def test_parts_that_were_half_deleted_replace_nothing(
    manifest: Manifest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, unlink = tmp_path / "x.hdf5", Path.unlink

    def interrupted(self: Path, missing_ok: bool = False) -> None:
        if self.name == "part_000001.safetensors":
            raise KeyboardInterrupt
        unlink(self, missing_ok)

    monkeypatch.setattr(Path, "unlink", interrupted)
    with pytest.raises(KeyboardInterrupt):
        synthetic_recording(RecordingFile(path), manifest, range(3), overwrite=True)
    monkeypatch.undo()
    synthetic_recording(RecordingFile(path), manifest, range(3))
    assert kept(path) == [0, 1, 2]


def test_overwriting_that_records_nothing_leaves_everything_as_it_was(
    environment: Environment, manifest: Manifest, tmp_path: Path
) -> None:
    path = tmp_path / "x.hdf5"
    synthetic_recording(RecordingFile(path), manifest, range(2))
    cut_off = RecordingFile(path)
    cut_off.take_up(manifest)
    cut_off.parts.add(*synthetic(2))
    cut_off.release()
    before = {each: each.read_bytes() for each in tmp_path.rglob("*") if each.is_file() and each.name != ".lock"}
    file = RecordingFile(path)
    file.check_begun(resume=False, overwrite=True)
    file.begin_anew()
    with pytest.raises(KeyboardInterrupt):
        record(environment, lambda: Interrupted(environment, 3), file, "Lift", 4, SEED)
    after = {each: each.read_bytes() for each in tmp_path.rglob("*") if each.is_file() and each.name != ".lock"}
    assert after == before


def test_a_recording_that_overwrites_is_resumed_as_one_that_overwrites(
    environment: Environment, manifest: Manifest, tmp_path: Path
) -> None:
    path = tmp_path / "x.hdf5"
    synthetic_recording(RecordingFile(path), manifest, range(100, 102))
    file = RecordingFile(path)
    file.check_begun(resume=False, overwrite=True)
    file.begin_anew()
    with pytest.raises(KeyboardInterrupt):
        record(environment, lambda: Interrupted(environment, STEPS + 5), file, "Lift", 6, SEED)
    assert kept(path) == [100, 101]
    with pytest.raises(ConfigurationError, match=r"an interrupted recording: .* continues with --resume"):
        RecordingFile(path).check_begun(resume=False, overwrite=False)
    recorded(environment, path, 6).close()
    assert sorted(kept(path)) == [0, 1, 2, 3, 4, 5]
    assert {each.name for each in tmp_path.iterdir()} == {"x.hdf5", "x.md"}


def test_a_folder_of_parts_keeps_what_is_no_part_of_it(manifest: Manifest, tmp_path: Path) -> None:
    folder = PartFolder(tmp_path / "x.hdf5.parts")
    folder.begin(manifest)
    folder.add(*synthetic(0))
    (folder.path / "thesis.tex").write_text("years")
    folder.remove()
    assert [path.name for path in folder.path.iterdir()] == ["thesis.tex"]
    assert not folder.begun


@pytest.fixture(scope="module")
def manifest(environment: Environment) -> Manifest:
    return Manifest.of(environment, "Lift", SEED)


def test_a_second_recorder_into_the_same_file_is_refused_whatever_it_asks_for(
    manifest: Manifest, tmp_path: Path
) -> None:
    first, second = RecordingFile(tmp_path / "x.hdf5"), RecordingFile(tmp_path / "x.hdf5")
    first.parts.begin(manifest)
    first.parts.add(*synthetic(0))
    for resume, overwrite in ((False, False), (True, False), (False, True)):
        with pytest.raises(ConfigurationError, match=rf"a run of process {os.getpid()} on .* is writing into folder"):
            second.check_begun(resume, overwrite)
    with pytest.raises(ConfigurationError, match="is writing into folder"):
        second.begin_anew()
    first.parts.release()
    second.check_begun(True, False)
    assert [*second.infos()] == [0]


def test_a_full_disk_is_one_error_and_keeps_what_was_written(manifest: Manifest, tmp_path: Path, capfd) -> None:
    """No file may grow beyond 100 kB in the child, which fails with a sentence."""
    folder, whole = PartFolder(tmp_path / "parts"), tmp_path / "whole.hdf5"
    write_hdf5(whole, [Episode(*_alone(0))], manifest)

    def limited(work):
        def run() -> None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
            work()

        return run

    def add() -> None:
        folder.begin(manifest)
        folder.add(*synthetic(0))
        folder.add(*synthetic(1, length=50))

    def replace() -> None:
        write_hdf5(whole, [Episode(*_alone(number)) for number in range(20)], manifest, size=800_000)

    for work, named in ((add, "part_000001.safetensors"), (replace, "whole.hdf5")):
        child = in_a_child(limited(work))
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
        assert f"{named}: File too large" in capfd.readouterr().out
    assert [info.number for info in folder.infos()] == [0]
    assert len(Hdf5Dataset(whole).episodes) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"parts", "whole.hdf5"}


def _alone(number: int) -> tuple[EpisodeInfo, dict[str, np.ndarray]]:
    (info,), arrays = synthetic(number)
    return info, arrays
