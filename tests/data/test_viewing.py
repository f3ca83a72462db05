"""Episodes as recordings for viewers, opened again by the formats' own readers."""

from __future__ import annotations

import base64
import io
import json
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.interfaces import ConfigurationError
from orbit_data.episodes import Episode, EpisodeInfo
from orbit_data.formats import opened, write_dataset
from orbit_data.hdf5 import Hdf5Dataset
from orbit_data.viewing import write_for_viewer

BACKEND = default_backend()
STEPS = 10


@pytest.fixture(scope="module")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes of Reach, to which pictures and depth were added."""
    folder = tmp_path_factory.mktemp("viewing")
    line = f"record Reach --backend {BACKEND} --num-envs 2 --episodes 2 --set episode_length=0.2"
    assert main([*line.split(), "--output", str(folder / "plain.hdf5")]) == 0
    pictures = np.random.default_rng(0).integers(0, 256, (STEPS, 12, 16, 3), np.uint8)
    added = {"obs/front": pictures, "obs/depth": np.ones((STEPS, 12, 16, 1), np.float32)}
    with opened(folder / "plain.hdf5") as dataset:
        read = [dataset.read(place) for place in range(2)]
        made = [Episode(each.info, {**each.arrays, **added}) for each in read]
        write_dataset(folder / "demos.hdf5", made, dataset.manifest)
    return folder / "demos.hdf5"


def test_mcap_holds_what_was_recorded(demos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    reader = pytest.importorskip(
        "mcap.reader", reason="capability 'mcap' is not installed: pip install 'orbit-data[mcap]'"
    )
    image = pytest.importorskip("PIL.Image")
    assert main(["data", "show", str(demos), "--output", str(tmp_path / "demo.mcap")]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "not shown: dones, initial/, next_obs/, obs/depth, states" in printed
    topics: dict[str, list[tuple[float, dict[str, object]]]] = defaultdict(list)
    with (tmp_path / "demo.mcap").open("rb") as file:
        for schema, channel, message in reader.make_reader(file).iter_messages():
            topics[channel.topic].append((message.log_time * 1e-9, json.loads(message.data)))
            assert schema.encoding == "jsonschema"
            assert json.loads(schema.data)["properties"].keys() >= topics[channel.topic][-1][1].keys()
    dataset = Hdf5Dataset(demos)
    first, second = dataset.read(0), dataset.read(1)
    dataset.close()
    times, actions = zip(*topics["/actions"], strict=True)
    # The second episode follows a second after the first one's last step.
    np.testing.assert_allclose(times, [*(0.02 * np.arange(STEPS)), *(1.18 + 0.02 * np.arange(STEPS))], atol=1e-6)
    assert [*actions[0]][:2] == ["panda_joint1", "panda_joint2"]
    np.testing.assert_allclose([[*row.values()] for row in actions[STEPS:]], second.arrays["actions"], rtol=1e-6)
    (name, poses), *_ = first.named("poses/").items()
    transform = topics["/tf"][3][1]
    assert transform["child_frame_id"] == name
    assert transform["translation"] == pytest.approx(dict(zip("xyz", poses[3, :3].tolist(), strict=True)))
    assert transform["rotation"] == pytest.approx(dict(zip("wxyz", poses[3, 3:].tolist(), strict=True)))
    shown = topics["/obs/front"][4][1]
    picture = image.open(io.BytesIO(base64.b64decode(str(shown["data"]))))
    np.testing.assert_array_equal(np.asarray(picture), first.arrays["obs/front"][4])
    assert [facts["number"] for _, facts in topics["/episode"]] == [first.info.number, second.info.number]
    assert topics["/episode"][0][1]["instruction"] == first.info.instruction


def test_rerun_holds_what_was_recorded(demos: Path, tmp_path: Path) -> None:
    chunks = pytest.importorskip(
        "rerun.chunk", reason="capability 'rerun' is not installed: pip install 'orbit-data[rerun]'"
    )
    assert main(["data", "show", str(demos), "--output", str(tmp_path / "demo.rrd"), "--first", "1"]) == 0
    columns: dict[tuple[str, str], list[Any]] = {}
    for chunk in chunks.RrdReader(tmp_path / "demo.rrd").stream():
        batch = chunk.to_record_batch()
        # Others are times and row numbers.
        for name in (each for each in batch.schema.names if ":" in each):
            columns.setdefault((chunk.entity_path, name), []).extend(batch.column(name).to_pylist())
    dataset = Hdf5Dataset(demos)
    episode = dataset.read(0)
    dataset.close()
    np.testing.assert_allclose(columns["/actions", "Scalars:scalars"], episode.arrays["actions"], rtol=1e-6)
    names = columns["/actions", "SeriesLines:names"]
    assert names[0][:2] == ["panda_joint1", "panda_joint2"]
    (name, poses), *_ = episode.named("poses/").items()
    moved = columns[f"/environment/{name}", "Transform3D:translation"]
    np.testing.assert_allclose(np.squeeze(np.array(moved, float)), poses[:, :3], rtol=1e-6)
    turned = np.squeeze(np.array(columns[f"/environment/{name}", "Transform3D:quaternion"], float))
    np.testing.assert_allclose(turned, np.roll(poses[:, 3:], -1, axis=1), rtol=1e-6)
    assert len(columns["/obs/front", "EncodedImage:blob"]) == STEPS


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--output {folder}/demo.bag", "must end in .mcap or .rrd"),
        ("--output {folder}/taken.mcap", "is there already"),
        ("--output {folder}/demo.mcap --first 0", "first must be at least 1"),
    ],
)
def test_files_that_cannot_be_are_refused(
    words: str, told: str, demos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken.mcap").touch()
    assert main(["data", "show", str(demos), *words.format(folder=tmp_path).split()]) != 0
    assert told in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(("suffix", "package"), [(".mcap", "mcap"), (".rrd", "rerun")])
def test_missing_packages_are_named_and_leave_no_file(
    suffix: str, package: str, demos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    refused = pytest.raises(ConfigurationError, match=rf"needs {package}.*\[viewers\]")
    with opened(demos) as dataset, refused:
        write_for_viewer(tmp_path / f"demo{suffix}", [dataset.read(0)], dataset.known())
    assert not [*tmp_path.iterdir()]


def test_a_dataset_without_a_manifest_is_refused(tmp_path: Path) -> None:
    episode = Episode(EpisodeInfo(0, 3), {"actions": np.zeros((3, 2), np.float32)})
    write_dataset(tmp_path / "foreign.hdf5", [episode], None)
    assert main(["data", "show", str(tmp_path / "foreign.hdf5"), "--output", str(tmp_path / "demo.mcap")]) != 0
