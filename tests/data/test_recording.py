"""Recordings: what is written is what happened, whatever ends the program, and nothing but numbers is read."""

from __future__ import annotations

import json
import os
import random
import resource
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_core.data.compare import check_manifest
from orbit_core.data.episodes import Episode, EpisodeInfo
from orbit_core.data.hdf5 import Hdf5Dataset, write_hdf5
from orbit_core.data.manifest import Manifest
from orbit_core.data.parts import PartFolder
from orbit_core.data.recording import RecordingFile, record
from orbit_core.envs import Environment, TerminationTerm, make
from orbit_core.envs.actors import Actor, scripted_actor
from orbit_core.interfaces import ConfigurationError, StorageError, UnknownNameError
from orbit_tasks.reach import Reach
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


@pytest.fixture(scope="module")
def dataset(environment: Environment, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hdf5Dataset]:
    made = recorded(environment, tmp_path_factory.mktemp("recorded") / "lift.hdf5", 6)
    yield made
    made.close()


def test_the_file_reads_as_robomimic_reads_it(dataset: Hdf5Dataset) -> None:
    with h5py.File(dataset.path, "r") as file:
        demos = sorted(file["data"], key=lambda name: int(name[5:]))
        assert demos == [f"demo_{i}" for i in range(6)]
        assert file["data"].attrs["total"] == 6 * STEPS
        env_args = json.loads(file["data"].attrs["env_args"])
        assert (env_args["env_name"], env_args["type"]) == ("orbit/Lift-v0", 2)
        for name in demos:
            demo = file["data"][name]
            assert demo.attrs["num_samples"] == STEPS
            assert np.abs(demo["actions"][()]).max() <= 1.0
            assert demo["actions"].shape == (STEPS, 8)
            assert demo["rewards"].shape == demo["dones"].shape == (STEPS,)
            assert demo["dones"][()].tolist() == [False] * (STEPS - 1) + [True]
            for term in demo["obs"]:
                np.testing.assert_array_equal(demo["obs"][term][1:], demo["next_obs"][term][:-1])
    assert dataset.known().task == "Lift"
    assert (dataset.path.with_suffix(".md")).read_text().startswith("# lift")
    assert not dataset.path.with_name("lift.hdf5.parts").exists()


def test_what_is_recorded_is_what_happened(dataset: Hdf5Dataset, environment: Environment) -> None:
    """The same seed and the recorded actions lead through the recorded observations, states and rewards."""
    first = [dataset.read(i) for i in range(4)]
    assert [(e.info.env_id, e.info.episode) for e in first] == [(0, 0), (1, 0), (2, 0), (3, 0)]
    observation, _ = environment.reset(SEED)
    columns = environment.observation["policy"].columns
    cube = environment.world.objects["cube"]
    for step in range(STEPS):
        for name, own in columns.items():
            seen = torch.stack([torch.from_numpy(e.arrays[f"obs/{name}"][step]) for e in first])
            torch.testing.assert_close(observation["policy"][:, own], seen, atol=1e-6, rtol=0.0)
        poses = np.stack([e.arrays["poses/cube"][step] for e in first])
        np.testing.assert_allclose(cube.root_pose.numpy(), poses, atol=1e-6)
        action = torch.stack([torch.from_numpy(e.arrays["actions"][step]) for e in first])
        observation, reward, *_, info = environment.step(action)
        np.testing.assert_allclose(reward.numpy(), [e.arrays["rewards"][step] for e in first], atol=1e-5)
    end = info["final"]
    last = np.stack([e.arrays["next_obs/cube_pose"][-1] for e in first])
    np.testing.assert_allclose(end.observation["policy"][:, columns["cube_pose"]].numpy(), last, atol=1e-6)
    returns = torch.stack(list(end.rewards.values())).sum(0).tolist()
    assert [e.info.episode_return for e in first] == pytest.approx(returns)
    assert [e.info.success for e in first] == end.success.tolist()


@dataclass
class OneAfterTheOther:
    """Environment i ends after 3 + i steps."""

    late: TerminationTerm | None = TerminationTerm(
        lambda world, task: task.episode_step >= 3 + torch.arange(world.num_envs, device=world.device)
    )


def test_environments_that_end_at_different_times_are_told_apart(tmp_path: Path) -> None:
    environment = Environment(Reach(terminations=OneAfterTheOther(), episode_length=SHORT), 3, BACKEND, seed=SEED)
    dataset = recorded(environment, tmp_path / "reach.hdf5", 7, "random")
    found = {(info.env_id, info.episode): dataset.read(i) for i, info in enumerate(dataset.episodes)}
    assert {key: e.info.length for key, e in found.items()} == {
        (i, number): 3 + i for i, number in ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (2, 0), (2, 1))
    }
    observation, _ = environment.reset(SEED)
    actor = scripted_actor("random", environment, SEED)
    columns = environment.observation["policy"].columns["goal"]
    for step in range(6):
        action = actor.act()
        for env_id in range(3):
            own, number = step % (3 + env_id), step // (3 + env_id)
            if (env_id, number) in found:
                arrays = found[env_id, number].arrays
                np.testing.assert_array_equal(arrays["actions"][own], action[env_id].numpy())
                np.testing.assert_allclose(arrays["obs/goal"][own], observation["policy"][env_id, columns], atol=1e-6)
        observation, *_ = environment.step(action)
    dataset.close()
    environment.close()


class _Interrupted(Actor):
    """An actor that somebody stops."""

    def __init__(self, environment: Environment, steps: int, name: str = "expert") -> None:
        self._actor, self._left = scripted_actor(name, environment, SEED), steps

    def act(self) -> Tensor:
        self._left -= 1
        if self._left < 0:
            raise KeyboardInterrupt
        return self._actor.act()


def test_a_recording_that_was_cut_off_goes_on_to_the_same_episodes(
    environment: Environment, dataset: Hdf5Dataset, tmp_path: Path
) -> None:
    file = RecordingFile(tmp_path / "lift.hdf5")
    with pytest.raises(KeyboardInterrupt):
        record(environment, lambda: _Interrupted(environment, STEPS + 5), file, "Lift", 6, SEED)
    assert len(file.infos()) == 4
    half = file.parts.path / ".orbit-01234567.partial"
    half.mkdir()
    (half / "part_000001.safetensors").write_bytes(b"half")
    resumed = recorded(environment, tmp_path / "lift.hdf5", 6)
    whole = {info.number: dataset.read(i) for i, info in enumerate(dataset.episodes)}
    assert [*whole] == [info.number for info in resumed.episodes]
    for place, info in enumerate(resumed.episodes):
        for name, array in resumed.read(place).arrays.items():
            if name != "initial/Lift.action_before":  # the first step writes it before anyone reads it
                np.testing.assert_allclose(array, whole[info.number].arrays[name], atol=1e-5, err_msg=name)
    longer = recorded(environment, tmp_path / "lift.hdf5", 9)
    assert sorted(info.number for info in longer.episodes) == [0, 1, 2, 3, 4, 5, 6, 7, 8]
    resumed.close()
    longer.close()


def test_random_actions_of_a_resumed_recording_are_those_that_it_lacked(
    environment: Environment, tmp_path: Path
) -> None:
    whole = recorded(environment, tmp_path / "whole.hdf5", 6, "random")
    file = RecordingFile(tmp_path / "lift.hdf5")
    with pytest.raises(KeyboardInterrupt):
        record(environment, lambda: _Interrupted(environment, STEPS + 5, "random"), file, "Lift", 6, SEED)
    resumed = recorded(environment, tmp_path / "lift.hdf5", 6, "random")
    assert [*resumed.episodes] == [*whole.episodes]
    actions = [resumed.read(place).arrays["actions"] for place in range(6)]
    for place, own in enumerate(actions):
        np.testing.assert_array_equal(own, whole.read(place).arrays["actions"])
        assert not any(np.array_equal(own, other) for other in actions[:place])
    whole.close()
    resumed.close()


def test_another_environment_does_not_go_on_with_it(dataset: Hdf5Dataset) -> None:
    other = make("Lift", 4, BACKEND, seed=SEED, episode_length=SHORT, tolerance=0.5)
    with pytest.raises(ConfigurationError, match=r"configuration\.tolerance was 0\.02 and is 0\.5"):
        recorded(other, dataset.path, 7)
    with pytest.raises(ConfigurationError, match="seed was 3 and is 4"):
        RecordingFile(dataset.path).take_up(Manifest.of(make("Lift", 4, BACKEND, episode_length=SHORT), "Lift", 4))
    other.close()


def test_a_missing_h5py_is_told_before_anything_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'orbit-core\[data\]'"):
        RecordingFile(tmp_path / "lift.hdf5").check_begun(resume=False, overwrite=False)


def test_an_unknown_group_is_named(environment: Environment, tmp_path: Path) -> None:
    file = RecordingFile(tmp_path / "x.hdf5")
    with pytest.raises(UnknownNameError, match="unknown observation group 'critc'"):
        record(environment, lambda: scripted_actor("zero", environment, 0), file, "Lift", 4, 0, groups=("critc",))


# Whatever ends the program ---------------------------------------------------------------------------------------


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
                    write_hdf5(file.path, file._episodes(), manifest)
                    file.parts.remove()
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
        for episode in file._episodes():
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
    dataset = Hdf5Dataset(path)
    dataset.close()
    return [info.number for info in dataset.episodes]


def test_a_kill_at_any_moment_of_overwriting_leaves_the_old_dataset_or_the_new_one(
    manifest: Manifest, tmp_path: Path
) -> None:
    """What was there, a finished dataset and a recording that was cut off, is there until the new one is whole."""
    folder, found = tmp_path / "here", set()
    path = folder / "x.hdf5"

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
            aside = [*folder.glob("x.hdf5.parts.replaced-*")]
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

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(Path, "unlink", interrupted)
        synthetic_recording(RecordingFile(path), manifest, range(3), overwrite=True)
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
        record(environment, lambda: _Interrupted(environment, 3), file, "Lift", 4, SEED)
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
        record(environment, lambda: _Interrupted(environment, STEPS + 5), file, "Lift", 6, SEED)
    assert kept(path) == [100, 101]
    with pytest.raises(ConfigurationError, match="was cut off: 'orbit record --resume' goes on with it"):
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


# Bad files -----------------------------------------------------------------------------------------------------------


def spoilt(kind: str, source: Path, target: Path) -> None:
    """A copy of a dataset with something wrong in it."""
    data = source.read_bytes()
    target.write_bytes(data[: len(data) // 2] if kind == "truncated" else b"no HDF5" if kind == "foreign" else data)
    if kind in ("truncated", "foreign"):
        return
    with h5py.File(target, "r+") as file:
        if kind == "other layout":
            del file["data"]
        elif kind == "wrong version":
            del file["orbit/manifest"]
            file["orbit/manifest"] = np.frombuffer(b'{"format": 99}', np.uint8)
        elif kind == "objects":
            file["data/demo_0"].create_dataset("pickled", data=["cos\nsystem"], dtype=h5py.string_dtype())
        elif kind == "link":
            file["data/demo_0/passwords"] = h5py.ExternalLink("/etc/passwd", "/")
        elif kind == "NaN":
            file["data/demo_0/actions"][3, 2] = np.nan
        elif kind == "shorter":
            del file["data/demo_0/rewards"]
            file["data/demo_0/rewards"] = np.zeros(3)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("truncated", "truncated"),
        ("foreign", "truncated, damaged or no HDF5"),
        ("other layout", "has no group 'data'"),
        ("wrong version", "manifest of format 99"),
        ("objects", "pickled.*only numbers"),
        ("link", "passwords.*is a link"),
        ("NaN", "'actions' of demo_0 .* NaN"),
        ("shorter", "'rewards' of demo_0 .* shape"),
    ],
)
def test_bad_files_are_refused_in_one_sentence(kind: str, message: str, dataset: Hdf5Dataset, tmp_path: Path) -> None:
    spoilt(kind, dataset.path, tmp_path / "bad.hdf5")
    with pytest.raises(ConfigurationError, match=message):
        Hdf5Dataset(tmp_path / "bad.hdf5").read(0)


def test_another_robot_does_not_fit_the_dataset(dataset: Hdf5Dataset) -> None:
    other = make("Lift", 1, BACKEND, robot="ur5+robotiq_2f85")
    with pytest.raises(ConfigurationError, match=r"robots\.robot\.joint_names was panda_joint1"):
        check_manifest(dataset.known(), other, str(dataset.path))
    other.close()


def test_a_foreign_file_of_robomimics_needs_no_manifest(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "theirs.hdf5", "w") as file:
        for number in (10, 2):
            demo = file.create_group(f"data/demo_{number}")
            demo.attrs["num_samples"] = number
            demo["actions"] = np.full((number, 3), number / 10)
            demo["obs/robot0_eef_pos"] = np.zeros((number, 3))
        file["mask/train"] = np.array([b"demo_10"])
    dataset = Hdf5Dataset(tmp_path / "theirs.hdf5")
    assert [info.length for info in dataset.episodes] == [2, 10]
    assert dataset.masks == {"train": [1]}
    assert dataset.read(1, ["obs/"]).arrays.keys() == {"obs/robot0_eef_pos"}
    with pytest.raises(ConfigurationError, match="holds no manifest"):
        dataset.known()
    dataset.close()
