"""Recordings: what is written is what happened, whatever ends the program, and nothing but numbers is read."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_core.envs import Environment, TerminationTerm, make
from orbit_core.envs.actors import Actor, scripted_actor
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_data.formats import opened
from orbit_data.hdf5 import Hdf5Dataset
from orbit_data.manifest.manifest import Manifest, check_manifest
from orbit_data.recording import RecordingFile, record
from orbit_tasks.reach import Reach

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
        lambda env: env.state.episode_step >= 3 + torch.arange(env.num_envs, device=env.device)
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
    """An expert that somebody stops."""

    def __init__(self, environment: Environment, steps: int) -> None:
        self._expert, self._left = scripted_actor("expert", environment, SEED), steps

    def act(self) -> Tensor:
        self._left -= 1
        if self._left < 0:
            raise KeyboardInterrupt
        return self._expert.act()


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


def test_a_recording_of_lerobots_goes_on_and_grows(
    environment: Environment, dataset: Hdf5Dataset, tmp_path: Path
) -> None:
    path = tmp_path / "lift"
    file = RecordingFile(path)
    with pytest.raises(KeyboardInterrupt):
        record(environment, lambda: _Interrupted(environment, STEPS + 5), file, "Lift", 6, SEED)
    assert not path.exists()
    assert len(file.infos()) == 4
    for episodes in (6, 9):
        file = RecordingFile(path)
        record(environment, lambda: scripted_actor("expert", environment, SEED), file, "Lift", episodes, SEED)
        assert {"poses/cube", "next_obs/goal", "initial/Lift.goal"} <= file.left_out
    with opened(path) as grown:
        assert sorted(info.number for info in grown.episodes) == [*range(9)]
        assert {each.instruction for each in grown.episodes} == {""}
        whole = {info.number: dataset.read(i) for i, info in enumerate(dataset.episodes)}
        for place, info in enumerate(grown.episodes):
            if info.number in whole:
                for name, array in grown.read(place).arrays.items():
                    np.testing.assert_allclose(array, whole[info.number].arrays[name], atol=1e-5, err_msg=name)
    assert {each.name for each in tmp_path.iterdir()} == {"lift"}


def test_a_rate_that_lerobot_cannot_hold_is_told_before_anything_is_recorded(
    environment: Environment, tmp_path: Path
) -> None:
    manifest = replace(Manifest.of(environment, "Lift", SEED), step_dt=0.03)
    with pytest.raises(ConfigurationError, match="whole number of steps per second"):
        RecordingFile(tmp_path / "lift").take_up(manifest)
    RecordingFile(tmp_path / "lift.hdf5").take_up(manifest)


def test_another_environment_does_not_go_on_with_it(dataset: Hdf5Dataset) -> None:
    other = make("Lift", 4, BACKEND, seed=SEED, episode_length=SHORT, tolerance=0.5)
    with pytest.raises(ConfigurationError, match=r"configuration\.tolerance was 0\.02 and is 0\.5"):
        recorded(other, dataset.path, 7)
    with pytest.raises(ConfigurationError, match="seed was 3 and is 4"):
        RecordingFile(dataset.path).take_up(Manifest.of(make("Lift", 4, BACKEND, episode_length=SHORT), "Lift", 4))
    other.close()


def test_a_recording_does_not_go_on_with_another_noise(environment: Environment, tmp_path: Path) -> None:
    path = tmp_path / "lift.hdf5"

    def disturbed(noise: float, stray: float) -> int:
        actor = scripted_actor("zero", environment, SEED)
        record(environment, lambda: actor, RecordingFile(path), "Lift", 4, SEED, noise=noise, stray=stray)
        with opened(path) as dataset:
            return len(dataset.episodes)

    assert disturbed(0.01, 0.0) == 4
    for noise, stray, told in ((0.0, 0.0, r"noise was 0\.01 and is 0"), (0.01, 0.02, r"stray was 0 and is 0\.02")):
        with pytest.raises(ConfigurationError, match=f"{told}; give the same, or another --output"):
            disturbed(noise, stray)
    assert disturbed(0.01, 0.0) == 4
    # Files that are older than these facts go on as before.
    manifest = Manifest.of(environment, "Lift", SEED)
    RecordingFile(path).take_up(manifest)


@pytest.mark.parametrize("name", ["lift.hdf5", "lift"])
def test_a_recording_does_not_go_on_with_another_instruction(
    name: str, environment: Environment, tmp_path: Path
) -> None:
    """Nor is an interrupted recording left behind, which would be in the way of the next command."""

    def shown(instruction: str, episodes: int) -> int:
        actor, file = scripted_actor("zero", environment, SEED), RecordingFile(tmp_path / name)
        record(environment, lambda: actor, file, "Lift", episodes, SEED, instruction=instruction)
        assert not file.parts.path.exists()
        with opened(file.path) as dataset:
            return len(dataset.episodes)

    assert shown("lift the cube", 4) == 4
    told = r"instruction was 'lift the cube' and is 'raise it'; give the same, or another --output"
    with pytest.raises(ConfigurationError, match=told):
        shown("raise it", 5)
    RecordingFile(tmp_path / name).check_begun(resume=False, overwrite=False)
    assert shown("lift the cube", 5) == 5


def test_a_missing_h5py_is_told_before_anything_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(ConfigurationError, match=r"pip install .*\[data\]"):
        RecordingFile(tmp_path / "lift.hdf5").check_begun(resume=False, overwrite=False)


def test_an_unknown_group_is_named(environment: Environment, tmp_path: Path) -> None:
    file = RecordingFile(tmp_path / "x.hdf5")
    with pytest.raises(UnknownNameError, match="unknown observation group 'critc'"):
        record(environment, lambda: scripted_actor("zero", environment, 0), file, "Lift", 4, 0, groups=("critc",))


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
