"""Files that are damaged or made to do harm, and words that cannot be: one sentence each, and nothing is lost."""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.envs import make
from orbit_core.interfaces import ConfigurationError
from orbit_data.episodes import Episode, EpisodeInfo
from orbit_data.formats import opened, write_dataset
from orbit_data.hdf5 import Hdf5Dataset
from orbit_data.lerobot import LeRobotDataset
from orbit_data.manifest.manifest import Manifest

STEPS = 6


def episode(number: int) -> Episode:
    arrays = {"actions": np.full((STEPS, 2), 0.1, np.float32), "rewards": np.ones(STEPS, np.float32)}
    return Episode(EpisodeInfo(number, STEPS, success=True), {**arrays, "obs/joints": np.zeros((STEPS, 3), np.float32)})


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hostile") / "whole.hdf5"
    write_dataset(path, map(episode, range(3)), None)
    return path


@pytest.fixture(scope="module")
def folder(whole: Path) -> Path:
    write_dataset(whole.with_name("folder"), map(episode, range(3)), None, rate=50.0)
    return whole.with_name("folder")


def told(file: h5py.File, **changes: Any) -> None:
    attributes = file["data/demo_0"].attrs
    attributes["orbit_episode"] = json.dumps({**json.loads(attributes["orbit_episode"]), **changes})


def replaced(file: h5py.File, **options: Any) -> None:
    del file["data/demo_0/rewards"]
    file["data/demo_0"].create_dataset("rewards", **options)


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda file: told(file, length=-3), "-3 steps"),
        (lambda file: told(file, length=10**15), "1000000000000000 steps"),
        (lambda file: told(file, length=0), "0 steps"),
        (lambda file: told(file, taught=-3), "led -3 of the"),
        (lambda file: told(file, taught=10**13), "led 10000000000000 of the"),
        (lambda file: file["data/demo_0"].attrs.__setitem__("orbit_episode", "[" * 30_000), "cannot be read"),
        (lambda file: replaced(file, shape=(10**12,), dtype="f8", chunks=(10**6,)), "made to fill the memory"),
        (lambda file: replaced(file, shape=(3 * 10**9,), dtype="f8", chunks=(10**7,), compression="gzip"), "fill the"),
        (lambda file: replaced(file, shape=(6,), dtype="u1", external=[("/etc/passwd", 0, 6)]), "other files"),
        (lambda file: replaced(file, data=1.0), r"shape \(\)"),
        (lambda file: file["data/demo_0"].__setitem__("again", file["data"]), "by another name"),
        (lambda file: file["data"].__setitem__("demo_9", h5py.SoftLink("/data/demo_0")), "is a link"),
        (lambda file: file.create_dataset("orbit/manifest", data=np.frombuffer(b"[" * 99_999, "u1")), "no manifest"),
    ],
)
def test_a_file_that_would_do_harm_is_refused(
    harm: Callable[[h5py.File], None], message: str, whole: Path, tmp_path: Path
) -> None:
    bad = Path(shutil.copy(whole, tmp_path / "bad.hdf5"))
    with h5py.File(bad, "r+") as file:
        harm(file)
    with pytest.raises(ConfigurationError, match=message):
        Hdf5Dataset(bad).read(0)


def test_noise_in_a_file_is_one_error_or_none(whole: Path, folder: Path, tmp_path: Path) -> None:
    refused = 0
    sources = [whole, *sorted(path for path in folder.rglob("*") if path.is_file() and path.suffix != ".md")]
    for draw in range(60):
        generator, source = np.random.default_rng(draw), sources[draw % len(sources)]
        data = bytearray(source.read_bytes())
        for place in generator.integers(0, min(len(data), 4000), 12):
            data[place] = generator.integers(256)
        bad = tmp_path / "bad.hdf5"
        if source is not whole:
            bad = shutil.copytree(folder, tmp_path / "bad", dirs_exist_ok=True)
        (bad if source is whole else bad / source.relative_to(folder)).write_bytes(data)
        try:
            with opened(bad) as dataset:
                for place in range(len(dataset.episodes)):
                    dataset.read(place)
        except ConfigurationError:
            refused += 1
    assert refused > 30


def rows_told(folder: Path, **changes: Any) -> None:
    path = next((folder / "meta/episodes").rglob("*.parquet"))
    pq.write_table(pa.Table.from_pylist([{**row, **changes} for row in pq.read_table(path).to_pylist()]), path)


def bomb(folder: Path) -> None:
    """A few kilobytes that are ten million numbers."""
    path = next((folder / "data").rglob("*.parquet"))
    zeros = pa.table({"action": pa.array(np.zeros(10**7))})
    pq.write_table(
        zeros, path, compression="zstd", data_page_size=1 << 30, write_batch_size=10**7, row_group_size=10**7
    )
    assert path.stat().st_size < 50_000


def info_told(folder: Path, **changes: Any) -> None:
    path = folder / "meta/info.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda folder: rows_told(folder, length=-5), "other episodes than|-5 steps"),
        (lambda folder: (rows_told(folder, length=10**12), (folder / "meta/orbit_episodes.json").unlink()), "steps"),
        (lambda folder: rows_told(folder, length=None), "cannot be read|other episodes"),
        (lambda folder: rows_told(folder, dataset_from_index=-(10**9)), "begin before the end"),
        (lambda folder: info_told(folder, data_path="{chunk_index:9999999999}"), "not a supported pattern"),
        (lambda folder: info_told(folder, data_path=None), "cannot be read"),
        (lambda folder: (folder / "meta/info.json").write_text("[" * 99_999), "cannot be read"),
        (lambda folder: (folder / "meta/orbit_episodes.json").write_text("[]"), "other episodes"),
        (bomb, "fill the memory"),
    ],
)
def test_a_folder_that_would_do_harm_is_refused(
    harm: Callable[[Path], None], message: str, folder: Path, tmp_path: Path
) -> None:
    bad = shutil.copytree(folder, tmp_path / "bad")
    harm(bad)
    with pytest.raises(ConfigurationError, match=message):
        LeRobotDataset(bad).read(0)


def test_a_manifest_that_cannot_be_is_refused() -> None:
    made = make("Reach", 1, default_backend())
    document = Manifest.of(made, "Reach", 0).document()
    made.close()
    for name in ("step_dt", "physics_dt", "decimation", "episode_length"):
        for value in (0, -1, 10**30, 1e300):
            with pytest.raises(ConfigurationError, match=f"{name}"):
                Manifest.decode({**document, name: value}, "it")
    for name in document:
        for value in (None, "text", [], {"a": 1}, 5):
            with suppress(ConfigurationError):
                Manifest.decode({**document, name: value}, "it")
    wrong: tuple[Any, ...] = (None, 5, 1.5, True, [1], b"\xff", "[" * 99_999, b" " * 5_000_000)
    for value in wrong:
        with pytest.raises(ConfigurationError, match="it holds"):
            Manifest.decode(value, "it")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("data split {whole} --valid nan", "none or all"),
        ("data split {whole} --seed -1", "seed"),
        ("data filter {whole} --first -1 --output {new}", "first"),
        ("data filter {whole} --most-steps 0 --output {new}", "most_steps"),
        ("data convert {whole} --rate 0 --output {folder}", "rate"),
        ("data convert {whole} --rate nan --output {folder}", "rate"),
        ("augment {whole} --overwrite --output {whole}", "is what is read"),
        ("augment {whole} --most-attempts 0 --output {new}", "most_attempts"),
        ("teleop Lift --port 99999 --output {new}", "port must be"),
        ("teleop Lift --leader-port -1 --output {new}", "leader_port must be"),
        ("teleop Lift --max-steps 0 --output {new}", "max_steps"),
        ("record Lift --output /proc/none/x.hdf5", "cannot write"),
        ("record Lft --overwrite --output {whole}", "unknown task"),
        ("record Lift --overwrite --num-envs 1 --group nothing --output {whole}", "unknown observation group"),
        ("teleop Lift --robot nobody --overwrite --output {whole}", "unknown robot"),
    ],
)
def test_words_that_cannot_be_are_one_error_and_nothing_is_lost(
    words: str, message: str, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = whole.read_bytes()
    names = {"whole": whole, "new": tmp_path / "new.hdf5", "folder": tmp_path / "folder"}
    assert main(words.format(**names).split()) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert whole.read_bytes() == before
    assert [*tmp_path.iterdir()] == []


def test_an_address_that_is_nobodys_is_told(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = ["--backend", default_backend(), "--host", "nobody.invalid", "--output", str(tmp_path / "x.hdf5")]
    assert main(["teleop", "Reach", *words]) == 2
    assert "cannot listen at 'nobody.invalid'" in capsys.readouterr().err


def test_a_file_that_may_not_grow_is_one_error(whole: Path, tmp_path: Path) -> None:
    words = ["data", "convert", str(whole), "--rate", "50", "--output", str(tmp_path / "folder")]
    code = f"from orbit_core.cli import main; raise SystemExit(main({words!r}))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000)),
    )  # fmt: skip
    assert done.returncode == 2
    assert "cannot write" in done.stderr
    assert done.stderr.count("\n") == 1
    assert [*tmp_path.iterdir()] == []
