"""Datasets from one format into another and back, put together, taken apart, and refused where they do not fit."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.envs import make
from orbit_core.envs.actors import scripted_actor
from orbit_core.interfaces import ConfigurationError
from orbit_data.episodes import Episode, EpisodeInfo
from orbit_data.formats import common_manifest, divided, opened, write_dataset
from orbit_data.hdf5 import Hdf5Dataset, write_hdf5
from orbit_data.lerobot import LeRobotDataset, write_lerobot
from orbit_data.recording import RecordingFile, record

BACKEND = default_backend()
STEPS = 10


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = make("Lift", 4, BACKEND, episode_length=0.02 * STEPS)
    path = tmp_path_factory.mktemp("formats") / "lift.hdf5"
    record(made, lambda: scripted_actor("expert", made, 0), RecordingFile(path), "Lift", 8, 0)
    made.close()
    return path


@pytest.fixture(scope="module")
def lerobot(path: Path) -> Path:
    folder = path.with_name("lerobot")
    with opened(path) as dataset:
        left_out = write_dataset(folder, map(dataset.read, range(8)), dataset.manifest)
    assert {"poses/cube", "next_obs/goal", "initial/Lift.goal"} <= left_out
    return folder


def pictured(number: int, length: int = 7) -> Episode:
    """An episode whose pictures tell episode and step by their brightness."""
    shade = np.arange(length) * 20 + number * 5
    pictures = np.broadcast_to(shade[:, None, None, None], (length, 32, 48, 3)).astype(np.uint8)
    arrays = {"actions": np.full((length, 2), 0.1 * number, np.float32), "obs/front": pictures}
    return Episode(EpisodeInfo(number, length), {**arrays, "obs/joints": np.zeros((length, 3), np.float32)})


def test_the_folder_is_what_lerobots_documentation_says(lerobot: Path) -> None:
    info = json.loads((lerobot / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["robot_type"]) == ("v3.0", 50, "franka_panda")
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (8, 8 * STEPS, 1)
    assert info["splits"] == {"train": "0:8"}
    assert info["features"]["action"] == {"dtype": "float32", "shape": [8], "names": None}
    state = info["features"]["observation.state"]
    assert state["shape"] == [18]
    assert state["names"][0] == "joint_positions.0"
    seen = info["features"]["observation.environment_state"]
    assert seen["shape"] == [21]
    assert seen["names"][0] == "cube_pose.0"
    assert not [name for name in info["features"] if "/" in name]
    data = pyarrow.parquet.read_table(lerobot / info["data_path"].format(chunk_index=0, file_index=0))
    assert {*data.column_names} == {*info["features"]}
    assert data["index"].to_pylist() == [*range(8 * STEPS)]
    assert data["episode_index"].to_pylist() == [i for i in range(8) for _ in range(STEPS)]
    np.testing.assert_allclose(data["timestamp"].to_numpy()[:STEPS], np.arange(STEPS) / 50, atol=1e-6)
    episodes = pyarrow.parquet.read_table(lerobot / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(row["dataset_from_index"], row["dataset_to_index"]) for row in episodes][:2] == [(0, 10), (10, 20)]
    assert episodes[0]["tasks"] == ["Lift"]
    assert len(episodes[0]["stats/action/mean"]) == 8
    tasks = pyarrow.parquet.read_table(lerobot / "meta/tasks.parquet")
    assert tasks.to_pylist() == [{"task_index": 0, "__index_level_0__": "Lift"}]
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["__index_level_0__"]
    told = json.loads((lerobot / "meta/stats.json").read_text())["action"]
    actions = np.stack(data["action"].to_pylist())
    np.testing.assert_allclose(told["std"], actions.std(0), atol=1e-5)
    assert told["count"] == [8 * STEPS]


def test_the_way_to_lerobot_and_back_loses_nothing_that_it_holds(path: Path, lerobot: Path) -> None:
    with opened(path) as ours, opened(lerobot) as theirs:
        assert theirs.episodes == ours.episodes
        assert theirs.known().encode() == ours.known().encode()
        for place in (0, 7):
            before, after = ours.read(place).arrays, theirs.read(place).arrays
            assert {*after} == {n for n in before if n.startswith("obs/")} | {"actions", "rewards", "dones", "states"}
            for name, array in after.items():
                np.testing.assert_array_equal(array, before[name], err_msg=name)


def test_each_episode_keeps_its_words_in_every_format(tmp_path: Path) -> None:
    told = ["lift the cube", "open the drawer", "lift the cube", ""]
    episodes = [replace(pictured(i), info=EpisodeInfo(i, 7, instruction=words)) for i, words in enumerate(told)]
    write_lerobot(tmp_path / "words", [replace(e, arrays=numbers(e)) for e in episodes], None, 50.0)
    info = json.loads((tmp_path / "words/meta/info.json").read_text())
    assert info["total_tasks"] == 3
    data = pyarrow.parquet.read_table(tmp_path / "words/data/chunk-000/file-000.parquet")
    assert data["task_index"].to_pylist()[::7] == [0, 1, 0, 2]
    with opened(tmp_path / "words") as dataset:
        assert [each.instruction for each in dataset.episodes] == told
        assert dataset.instructions == ["lift the cube", "open the drawer", "words"]
        write_dataset(tmp_path / "words.hdf5", map(dataset.read, range(4)), None)
    with opened(tmp_path / "words.hdf5") as dataset:
        assert [each.instruction for each in dataset.episodes] == told
    # A dataset of another program states the words in its own files only.
    (tmp_path / "words/meta/orbit_episodes.json").unlink()
    with opened(tmp_path / "words") as dataset:
        assert [each.instruction for each in dataset.episodes] == [*told[:3], "words"]


def test_disturbed_episodes_keep_what_was_chosen_and_what_was_executed(tmp_path: Path) -> None:
    episode = pictured(3)
    arrays = {**numbers(episode), "clean_actions": np.full((7, 2), 0.9, np.float32)}
    assert write_lerobot(tmp_path / "a", [replace(episode, arrays=arrays)], None, 50.0) == set()
    data = pyarrow.parquet.read_table(tmp_path / "a/data/chunk-000/file-000.parquet")
    np.testing.assert_allclose(data["action"].to_pylist(), arrays["clean_actions"])
    read = LeRobotDataset(tmp_path / "a").read(0).arrays
    np.testing.assert_array_equal(read["clean_actions"], arrays["clean_actions"])
    np.testing.assert_array_equal(read["actions"], arrays["actions"])


def numbers(episode: Episode) -> dict[str, np.ndarray]:
    return {name: array for name, array in episode.arrays.items() if name != "obs/front"}


def test_words_of_a_task_that_are_too_long_or_too_many_are_refused(tmp_path: Path) -> None:
    episode = pictured(0)
    write_lerobot(tmp_path / "a", [replace(episode, arrays=numbers(episode))], None, 50.0)
    tasks = tmp_path / "a/meta/tasks.parquet"
    for words, message in ((["x" * 2_000], "2,000 characters"), (["x"] * 20_000, "20,000 texts")):
        index = pyarrow.array(range(len(words)), pyarrow.int64())
        pyarrow.parquet.write_table(pyarrow.table({"task_index": index, "task": words}), tasks)
        with pytest.raises(ConfigurationError, match=message):
            LeRobotDataset(tmp_path / "a")


def test_a_dataset_goes_on_without_encoding_its_pictures_again(tmp_path: Path) -> None:
    pytest.importorskip("av", reason="the capability is videos in datasets, which needs PyAV")
    told = [EpisodeInfo(number, 7, instruction=f"task {number % 2}") for number in range(5)]
    episodes = [replace(pictured(info.number), info=info) for info in told]
    write_lerobot(tmp_path / "half", episodes[:3], None, 50.0)
    write_lerobot(tmp_path / "whole", episodes, None, 50.0)
    first = LeRobotDataset(tmp_path / "half")
    write_lerobot(tmp_path / "on", episodes[3:], None, 50.0, first)
    film = "videos/observation.images.front/chunk-000/file-000.mp4"
    assert (tmp_path / "on" / film).samefile(tmp_path / "half" / film)
    on, whole = LeRobotDataset(tmp_path / "on"), LeRobotDataset(tmp_path / "whole")
    assert on.episodes == whole.episodes
    for place in range(5):
        for name, array in whole.read(place).arrays.items():
            near = np.abs(on.read(place).arrays[name].astype(float) - array.astype(float))
            assert near.max() <= 2, name
    stats = [json.loads((tmp_path / name / "meta/stats.json").read_text()) for name in ("on", "whole")]
    assert stats[0].keys() == stats[1].keys()
    for name, table in stats[0].items():
        for kind, values in table.items():
            np.testing.assert_allclose(values, stats[1][name][kind], atol=1e-6, err_msg=f"{name} {kind}")
    (rows, _), (others, _) = on.index(), whole.index()
    assert [row.keys() for row in rows] == [row.keys() for row in others]
    assert rows[4]["videos/observation.images.front/file_index"] == 1


def test_pictures_become_video_and_pictures_again(tmp_path: Path) -> None:
    pytest.importorskip("av", reason="the capability is videos in datasets, which needs PyAV")
    episodes = [pictured(number) for number in range(5)]
    assert write_lerobot(tmp_path / "films", episodes, None, 50.0) == set()
    dataset = LeRobotDataset(tmp_path / "films")
    for place in (4, 0, 2):
        read = dataset.read(place)
        assert read.arrays["obs/front"].shape == (7, 32, 48, 3)
        difference = read.arrays["obs/front"].astype(int) - episodes[place].arrays["obs/front"]
        assert np.abs(difference).max() <= 2
        np.testing.assert_array_equal(read.arrays["obs/state"], np.zeros((7, 3)))
    assert dataset.read(1, ["actions"]).arrays.keys() == {"actions"}


def test_pictures_are_compressed_and_read_again(tmp_path: Path) -> None:
    write_hdf5(tmp_path / "a.hdf5", [pictured(number) for number in range(3)], None)
    with h5py.File(tmp_path / "a.hdf5") as file:
        assert file["data/demo_0/obs/front"].compression == "lzf"
        assert file["data/demo_0/actions"].compression is None
    with opened(tmp_path / "a.hdf5") as dataset:
        write_dataset(tmp_path / "b.hdf5", map(dataset.read, range(3)), None, compression="gzip")
    with opened(tmp_path / "b.hdf5") as dataset:
        np.testing.assert_array_equal(dataset.read(2).arrays["obs/front"], pictured(2).arrays["obs/front"])


def test_the_command_converts_filters_splits_merges_and_tells(path: Path, tmp_path: Path, capsys) -> None:
    few, both = tmp_path / "few.hdf5", tmp_path / "both.hdf5"
    assert main(["data", "filter", str(path), "--first", "4", "--most-steps", "10", "--output", str(few)]) == 0
    assert main(["data", "split", str(few), "--valid", "0.25"]) == 0
    assert main(["data", "merge", str(few), str(path), "--output", str(both)]) == 0
    with opened(few) as dataset:
        assert sorted((*dataset.masks["train"], *dataset.masks["valid"])) == [0, 1, 2, 3]
        assert len(dataset.masks["valid"]) == 1
    with opened(both) as dataset:
        assert len(dataset.episodes) == 12
        assert dataset.known().task == "Lift"
    card = tmp_path / "told.md"
    assert main(["data", "info", str(both), "--card", str(card)]) == 0
    assert "| robot | franka_panda |" in card.read_text()
    assert "| `obs/cube_pose` | 7 | float32 | m, quaternion (w, x, y, z) |" in card.read_text()
    capsys.readouterr()
    for words, message in (
        (["data", "filter", str(path), "--least-return", "1e6", "--output", str(both)], "no episode of"),
        (["data", "filter", str(few), "--subset", "tain", "--output", str(tmp_path / "x")], "did you mean 'train'"),
        (["data", "convert", str(path), "--output", str(path), "--overwrite"], "is what is read"),
        (["data", "convert", str(path), "--output", str(few)], "is there already"),
        (["data", "convert", str(path), "--output", "x.zip"], "of no format that is written"),
        (
            ["data", "convert", str(path), "--output", str(tmp_path / "x"), "--compression", "lzf"],
            "has no compression",
        ),
        (["data", "merge", str(path), "--output", "x.hdf5"], "at least two datasets"),
        (["data", "infos"], "did you mean 'info'"),
        (["data", "info", str(tmp_path)], "it has no meta/info.json"),
    ):
        assert main(words) == 2
        assert message in capsys.readouterr().err


def test_datasets_of_several_tasks_are_put_together_with_their_words(path: Path, tmp_path: Path, capsys) -> None:
    made = make("Reach", 2, BACKEND, episode_length=0.02 * STEPS)
    reach = tmp_path / "reach.hdf5"
    told = "touch the marker"
    record(made, lambda: scripted_actor("expert", made, 0), RecordingFile(reach), "Reach", 2, 0, instruction=told)
    made.close()
    both = tmp_path / "both"
    assert main(["data", "merge", str(path), str(reach), "--output", str(both)]) == 2
    assert "not of one kind" in capsys.readouterr().err
    assert main(["data", "merge", str(path), str(reach), "--output", str(both), "--shared"]) == 0
    assert json.loads((both / "meta/info.json").read_text())["total_tasks"] == 2
    with opened(both) as dataset, opened(path) as lift:
        assert dataset.known().task == "Lift, Reach"
        assert [each.instruction for each in dataset.episodes] == ["Lift"] * 8 + [told] * 2
        terms = {*dataset.known().observations["policy"].terms}
        assert {"joint_positions", "joint_velocities", "last_action"} <= terms
        assert "cube_pose" not in terms
        arrays = dataset.read(0).arrays
        assert {*arrays} == {f"obs/{term}" for term in terms} | {"actions", "rewards", "dones"}
        np.testing.assert_array_equal(arrays["actions"], lift.read(0).arrays["actions"])
    other = make("Reach", 2, BACKEND, robot="ur10", episode_length=0.02 * STEPS)
    ur10 = tmp_path / "ur10.hdf5"
    record(other, lambda: scripted_actor("zero", other, 0), RecordingFile(ur10), "Reach", 2, 0)
    other.close()
    words = ["data", "merge", str(path), str(ur10), "--output", str(tmp_path / "no"), "--shared"]
    assert main(words) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "share no robot or action" in told
    assert "action_terms" in told


def test_datasets_of_two_kinds_do_not_merge(path: Path, tmp_path: Path) -> None:
    with opened(path) as dataset:
        manifest = dataset.known()
        robot = replace(manifest.robots["robot"], joint_names=(*reversed(manifest.robots["robot"].joint_names),))
        write_hdf5(tmp_path / "b.hdf5", [dataset.read(0)], replace(manifest, robots={"robot": robot}))
    expected = pytest.raises(ConfigurationError, match=r"robots\.robot\.joint_names was panda_joint1")
    with opened(path) as dataset, opened(tmp_path / "b.hdf5") as other, expected:
        common_manifest([dataset, other])
    with pytest.raises(ConfigurationError, match="none or all of them"):
        divided(4, 0.05, 0)


@pytest.mark.parametrize(
    ("place", "message"),
    [
        (("codebase_version", "v2.1"), "version v2.1"),
        (("data_path", "../../lift.hdf5"), "outside of it"),
        (("features", 3), "cannot be read as a LeRobot dataset"),
    ],
)
def test_bad_lerobot_folders_are_refused(
    place: tuple[str, object], message: str, lerobot: Path, tmp_path: Path
) -> None:
    for part in lerobot.rglob("*"):
        if part.is_file():
            target = tmp_path / "bad" / part.relative_to(lerobot)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(part.read_bytes())
    info = json.loads((tmp_path / "bad/meta/info.json").read_text())
    (tmp_path / "bad/meta/info.json").write_text(json.dumps({**info, place[0]: place[1]}))
    with pytest.raises(ConfigurationError, match=message):
        LeRobotDataset(tmp_path / "bad").read(0)


def test_a_rate_that_lerobot_cannot_hold_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"whole number of steps per second, not 33\.3"):
        write_lerobot(tmp_path / "x", [pictured(0)], None, 100 / 3)
    with pytest.raises(ConfigurationError, match="at least one episode"):
        write_lerobot(tmp_path / "x", [], None, 50)
    assert [*tmp_path.iterdir()] == []


def test_what_a_dataset_lacks_is_named(path: Path) -> None:
    with opened(path) as dataset:
        assert isinstance(dataset, Hdf5Dataset)
        with pytest.raises(ConfigurationError, match=r"demo_0 of .* has no 'obs/picture'"):
            dataset.read(0, ["actions", "obs/picture"])
