"""A few demonstrations become many, and each that is kept reached its goal somewhere else."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from orbit_core.backends import backend_names, default_backend
from orbit_core.cli import main
from orbit_core.envs import Environment, make
from orbit_core.envs.actors import scripted_actor
from orbit_core.interfaces import ConfigurationError
from orbit_data.augmentation import cut, hand_pose
from orbit_data.formats import opened
from orbit_data.hdf5 import Hdf5Dataset
from orbit_data.recording import RecordingFile, record
from orbit_data.replay import replay

BACKEND = default_backend()
OTHER = next(name for name in backend_names() if name != BACKEND)


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    made = make("Lift", 4, BACKEND, seed=2)
    yield made
    made.close()


@pytest.fixture(scope="module")
def dataset(environment: Environment, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hdf5Dataset]:
    path = tmp_path_factory.mktemp("augmented") / "lift.hdf5"
    record(environment, lambda: scripted_actor("expert", environment, 2), RecordingFile(path), "Lift", 4, 2)
    made = Hdf5Dataset(path)
    yield made
    made.close()


def test_demonstrations_are_cut_where_the_cube_leaves_the_table(dataset: Hdf5Dataset, environment: Environment) -> None:
    pieces = cut(environment, dataset, range(4))
    assert pieces.poses.shape[:2] == (4, 2)
    assert (pieces.lengths > 10).all()
    assert pieces.gripper_open[:, 0, 0].all()
    assert not pieces.gripper_open[:, 1].any()
    assert not pieces.gripper_open[torch.arange(4), 0, pieces.lengths[:, 0] - 1].any()
    # At the end of the first piece the hand is around the cube, and a little higher than where that was.
    last = pieces.poses[torch.arange(4), 0, pieces.lengths[:, 0] - 1]
    assert last[:, :2].abs().max() < 0.03  # as the cube moved while the fingers closed
    assert last[:, 2].abs().max() < 0.03
    assert hand_pose(environment).shape == (4, 7)


@pytest.mark.parametrize("backend", [BACKEND, OTHER])
def test_what_is_kept_succeeded_elsewhere(backend: str, dataset: Hdf5Dataset, tmp_path: Path, capsys) -> None:
    words = ["augment", str(dataset.path), "--output", str(tmp_path / "many.hdf5"), "--backend", backend]
    assert main([*words, "--episodes", "5", "--num-envs", "8", "--most-attempts", "32"]) == 0
    assert f"attempts on {backend} succeeded" in capsys.readouterr().out
    with opened(tmp_path / "many.hdf5") as many:
        assert len(many.episodes) == 5
        assert all(info.success and info.metrics["goal_distance_m"] < 0.02 for info in many.episodes)
        begins = torch.stack([torch.from_numpy(many.read(i).arrays["poses/cube"][0, :3]) for i in range(5)])
        known = torch.stack([torch.from_numpy(dataset.read(i).arrays["poses/cube"][0, :3]) for i in range(4)])
        assert torch.cdist(begins, known).min() > 1e-3
        if backend == BACKEND:
            again = make("Lift", 5, BACKEND)
            assert replay(again, many, range(5)).success.value == 1.0
            again.close()


def test_a_demonstration_of_many_subtasks_is_done_again(tmp_path: Path, capsys) -> None:
    """Stack: the second piece is the way relative to the place, and not to what is put there."""
    one = tmp_path / "one.hdf5"
    shared = ["--num-envs", "4", "--overwrite", "--output"]
    assert (
        main(["record", "Stack", "--backend", BACKEND, "--agent", "expert", "--episodes", "4", *shared, str(one)]) == 0
    )
    assert (
        main(["augment", str(one), "--demonstrations", "2", "--episodes", "3", *shared, str(tmp_path / "x.hdf5")]) == 0
    )
    with opened(tmp_path / "x.hdf5") as dataset:
        assert [info.success for info in dataset.episodes] == [True] * 3


def test_what_cannot_be_augmented_is_refused(dataset: Hdf5Dataset, environment: Environment) -> None:
    with pytest.raises(ConfigurationError, match="metadata of task Reach names no subtasks"):
        cut(make("Reach", 1, BACKEND), dataset, [0])
    few = make("Lift", 1, BACKEND)
    with pytest.raises(ConfigurationError, match="4 episodes do not begin in 1 environments"):
        cut(few, dataset, range(4))
    few.close()


def test_what_was_there_stays_where_no_attempt_succeeds(dataset: Hdf5Dataset, tmp_path: Path, capsys) -> None:
    """A dataset is replaced by one that is whole, and a recording that was cut off by none."""
    output, parts = tmp_path / "many.hdf5", tmp_path / "many.hdf5.parts"
    output.write_bytes(dataset.path.read_bytes())
    words = ["augment", str(dataset.path), "--output", str(output), "--num-envs", "4", "--most-attempts", "1"]
    words += ["--episodes", "1", "--set", "tolerance=1e-9", "--set", "episode_length=0.1"]
    assert main([*words, "--overwrite"]) == 2
    assert "attempts succeeded: use other demonstrations" in capsys.readouterr().err
    assert output.read_bytes() == dataset.path.read_bytes()
    assert not parts.exists()
    cut_off = RecordingFile(output)
    cut_off.take_up(dataset.known())
    cut_off.parts.add([dataset.episodes[0]], dataset.read(0).arrays)
    cut_off.release()
    output.unlink()
    assert main(words) == 2
    assert "many.hdf5.parts holds an interrupted recording" in capsys.readouterr().err
    assert main([*words, "--overwrite"]) == 2
    assert len(cut_off.infos()) == 1
    same = ["augment", str(dataset.path), "--output", str(dataset.path), "--overwrite"]
    assert main(same) == 2
    assert "is what is read" in capsys.readouterr().err


def test_planned_ways_lead_to_pieces_around_what_stands_there(dataset: Hdf5Dataset, tmp_path: Path, capsys) -> None:
    words = ["augment", str(dataset.path), "--output", str(tmp_path / "many.hdf5"), "--method", "skillgen"]
    assert main([*words, "--episodes", "3", "--num-envs", "4", "--most-attempts", "16"]) == 0
    said = capsys.readouterr().out
    planned = re.search(r"(\d+) ways planned around obstacles", said)
    assert planned is not None
    assert int(planned[1]) >= 4, "a way to the cube in each environment, at least"
    with opened(tmp_path / "many.hdf5") as many:
        assert all(info.success for info in many.episodes)
        assert len(many.episodes) == 3


def test_a_piece_that_begins_in_a_grasp_is_whole(dataset: Hdf5Dataset, environment: Environment) -> None:
    """A drawer's way is not cut short where the hand comes near its end."""
    metadata = environment.task.metadata
    reach, carry = metadata.subtasks
    free = cut(environment, dataset, range(4)).lengths
    environment.task.metadata = replace(metadata, subtasks=(reach, replace(carry, free=False)))
    try:
        whole = cut(environment, dataset, range(4)).lengths
    finally:
        environment.task.metadata = metadata
    assert torch.equal(whole[:, 0], free[:, 0])
    assert (whole[:, 1] > free[:, 1]).any()
