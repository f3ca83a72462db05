"""Files that name other files, or unpack to more than a machine has: refused before anything of it is done."""

from __future__ import annotations

import bz2
import gzip
import json
import lzma
import shutil
import zlib
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import av
import h5py
import numcodecs
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zarr

from orbit_core.cli import main
from orbit_core.interfaces import ConfigurationError
from orbit_data.cli.read_budget import ReadSettings
from orbit_data.episodes import Episode, EpisodeInfo
from orbit_data.formats import opened, write_dataset
from orbit_data.hdf5 import Hdf5Dataset
from orbit_data.lerobot import LeRobotDataset
from orbit_data.reading.budget import ReadAccount, ReadBudget
from orbit_data.zarr_reader import ZarrDataset
from tests.fuzz.watch import watched

STEPS = 6
ZEROS = 40_000_000
"""Bytes of a bomb, of which some forty thousand are stored."""


def episode(number: int) -> Episode:
    arrays = {
        "actions": np.full((STEPS, 2), 0.1, np.float32),
        "obs/joints": np.zeros((STEPS, 3), np.float32),
        "obs/camera": np.full((STEPS, 32, 32, 3), number, np.uint8),
    }
    return Episode(EpisodeInfo(number, STEPS, success=True), arrays)


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("budget")
    for name in ("whole.hdf5", "folder"):
        write_dataset(folder / name, map(episode, range(3)), None, rate=50.0)
    return folder


def read_all(path: Path) -> None:
    with opened(path) as dataset:
        for place in range(len(dataset.episodes)):
            dataset.read(place)


def packed(group: h5py.Group, stored: bytes, times: int = 1) -> None:
    """An array of 8 numbers, whose only chunk is stored as these bytes."""
    plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plan.set_chunk((STEPS, 2))
    for _ in range(times):
        plan.set_deflate(9)
    space = h5py.h5s.create_simple((STEPS, 2))
    array = h5py.h5d.create(group.id, b"packed", h5py.h5t.IEEE_F32LE, space, plan)
    array.write_direct_chunk((0, 0), stored)


def nested(group: h5py.Group, depth: int) -> None:
    """Groups within each other, each with two names: 2 ** depth paths."""
    for _ in range(depth):
        group["b"] = inner = group.create_group("a")
        group = inner


def big_chunk(group: h5py.Group) -> None:
    group.create_dataset("large", (STEPS, 2), "f4", chunks=(30_000, 30_000), maxshape=(None, None))


def external(group: h5py.Group, path: Path) -> None:
    group.create_dataset("taken", (STEPS,), "u1", external=[(str(path), 0, STEPS)])


BOMB = zlib.compress(bytes(1 << 29), 9)


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda group: nested(group, 10), "by another name"),
        (lambda group: nested(group.create_group("x"), 40), "more than 16 groups|by another name"),
        (big_chunk, "in chunks of 3,600,000,000"),
        (lambda group: packed(group, BOMB), "unpacks to more than its size"),
        (lambda group: packed(group, zlib.compress(BOMB), 2), "packed otherwise than once"),
        (lambda group: group.create_dataset("few", (STEPS,), "f4", chunks=True, scaleoffset=2), "otherwise than once"),
        (lambda group: group.__setitem__("z", np.zeros(STEPS, np.complex64)), "only numbers in the file"),
        (lambda group: group.__setitem__("[link]\x1b[31m", np.zeros(STEPS)), r"'\[link\]\\x1b\[31m', which is no name"),
        (lambda group: group.file.__setitem__("mask/../../x", np.array([b"demo_0"])), r"'\.\.', which is no name"),
        (lambda group: group.__setitem__("x" * 201, np.zeros(STEPS)), "which is no name"),
        (lambda group: group.__setitem__("kind", np.dtype("f4")), "neither a group nor an array"),
        (lambda group: group.parent.__setitem__("demo_9", group), "'/data/demo_0' by another name"),
        (lambda group: group.__setitem__("obs/again", group.parent["demo_1/obs/joints"]), "by another name"),
    ],
)
def test_an_hdf5_file_made_to_do_harm_is_refused(
    harm: Callable[[h5py.Group], None], message: str, sources: Path, tmp_path: Path
) -> None:
    bad = Path(shutil.copy(sources / "whole.hdf5", tmp_path / "bad.hdf5"))
    with h5py.File(bad, "r+") as file:
        harm(file["data/demo_0"])  # pyright: ignore[reportArgumentType]
    with pytest.raises(ConfigurationError, match=message):
        read_all(bad)


@pytest.mark.parametrize("place", ["data", "data/demo_0", "data/demo_0/actions", "orbit", "mask", "orbit/manifest"])
def test_no_other_file_is_opened_through_hdf5(place: str, sources: Path, tmp_path: Path) -> None:
    secret = Path(shutil.copy(sources / "whole.hdf5", tmp_path / "secret.hdf5"))
    for link in (h5py.ExternalLink("secret.hdf5", "/data/demo_1"), h5py.SoftLink("/data/demo_1"), external):
        bad = Path(shutil.copy(sources / "whole.hdf5", tmp_path / "bad.hdf5"))
        with h5py.File(bad, "r+") as file:
            if place in file:
                del file[place]
            if link is external:
                external(file.require_group("/".join(place.split("/")[:-1]) or "/"), secret)
                file.move(f"{'/'.join(place.split('/')[:-1])}/taken", place)
            else:
                file[place] = link
        with watched([secret]) as touched, pytest.raises(ConfigurationError):
            Hdf5Dataset(bad).read(0)
        assert not touched


@pytest.mark.parametrize(
    "name",
    [
        "meta/info.json", "meta/orbit_episodes.json", "meta/orbit_manifest.json", "meta/episodes", "data", "meta",
        "meta/episodes/chunk-000/file-000.parquet", "data/chunk-000/file-000.parquet", "videos",
        "videos/observation.images.camera/chunk-000/file-000.mp4",
    ],
)  # fmt: skip
def test_no_link_within_a_lerobot_folder_is_followed(name: str, sources: Path, tmp_path: Path) -> None:
    bad = shutil.copytree(sources / "folder", tmp_path / "bad")
    outside = tmp_path / "outside"
    if (bad / name).exists():
        (bad / name).rename(outside)
    else:
        outside.write_text("{}")
    (bad / name).symlink_to(outside)
    secrets = [path for path in (outside, *outside.rglob("*")) if path.is_file()]
    with watched(secrets) as touched, pytest.raises(ConfigurationError, match="is a link, which may lead to any file"):
        LeRobotDataset(bad).read(0)
    assert not touched


def test_a_page_of_parquet_that_unpacks_to_more_than_it_should_is_refused(sources: Path, tmp_path: Path) -> None:
    bad = shutil.copytree(sources / "folder", tmp_path / "bad")
    path = bad / "data/chunk-000/file-000.parquet"
    zeros = pa.table({"action": pa.array(np.zeros(ZEROS // 8)), "index": pa.array(np.zeros(ZEROS // 8, np.int8))})
    options: dict[str, Any] = {"data_page_size": 1 << 30, "write_batch_size": ZEROS, "row_group_size": ZEROS}
    options["max_rows_per_page"] = ZEROS
    pq.write_table(zeros, path, compression="zstd", **options)
    assert path.stat().st_size < ZEROS / 2000
    with pytest.raises(ConfigurationError, match="next to nothing is stored"):
        LeRobotDataset(bad).read(0)
    # The end of the file says that there are six numbers, the pages still have millions.
    data = path.read_bytes()
    count, six = (varint(2 * number, 4) for number in (ZEROS // 8, 6))
    end = len(data) - int.from_bytes(data[-8:-4], "little") - 8
    assert count in data[:end]
    assert count in data[end:]
    path.write_bytes(data[:end] + data[end:].replace(count, six))
    assert pq.ParquetFile(path).metadata.num_rows == 6
    with pytest.raises(ConfigurationError, match="next to nothing is stored"):
        LeRobotDataset(bad).read(0)


def varint(value: int, width: int) -> bytes:
    """A number in groups of seven bits, the least first, of that many bytes."""
    return bytes((value >> 7 * place & 127) | (128 if place < width - 1 else 0) for place in range(width))


def test_episodes_that_are_missing_or_overlap_are_told(sources: Path, tmp_path: Path) -> None:
    for name, change, message in (
        ("gap", lambda rows: [rows[0], rows[2]], "has 2 episodes, of which 1 are numbered .* there are 3"),
        ("fewer", lambda rows: rows[:2], "has 2 episodes, of which 2 are numbered .* there are 3"),
        ("twice", lambda rows: [rows[0], rows[0], rows[1]], "of which 1 are numbered"),
        ("same", lambda rows: [{**row, "dataset_from_index": 0} for row in rows], "episode 1 .* would begin before"),
    ):
        bad = shutil.copytree(sources / "folder", tmp_path / name)
        path = bad / "meta/episodes/chunk-000/file-000.parquet"
        rows = change(pq.read_table(path).to_pylist())
        pq.write_table(pa.Table.from_pylist(rows), path)
        (bad / "meta/orbit_episodes.json").unlink()
        with pytest.raises(ConfigurationError, match=message):
            LeRobotDataset(bad)


def test_a_video_is_held_to_the_budget_and_to_its_format(sources: Path, tmp_path: Path) -> None:
    name = "videos/observation.images.camera/chunk-000/file-000.mp4"
    bad = shutil.copytree(sources / "folder", tmp_path / "bad")
    for budget, message in (
        (ReadBudget(pixels=1000), "pictures of 32 x 32, and 1,000 pixels are allowed"),
        (ReadBudget(bytes=20_000), "would take"),
        (ReadBudget(seconds=1e-9), "was not read within"),
    ):
        with pytest.raises(ConfigurationError, match=message):
            _with(bad, budget).read(0)
    secret = tmp_path / "secret.mp4"
    secret.write_bytes((bad / name).read_bytes())
    for text in (f"#EXTM3U\n#EXTINF:1,\n{secret}\n", f"ffconcat version 1.0\nfile {secret}\n"):
        (bad / name).write_text(text)
        with watched([secret]) as touched, pytest.raises(ConfigurationError, match="cannot be read"):
            LeRobotDataset(bad).read(0)
        assert not touched
    for container, codec, pixels, message in (
        ("mp4", "mjpeg", "yuvj420p", "is packed by mjpeg"),
        ("matroska", "libx264", "yuv420p", "cannot be read"),
    ):
        film(bad / name, container, codec, pixels)
        with pytest.raises(ConfigurationError, match=message):
            LeRobotDataset(bad).read(0)


def film(path: Path, container: str, codec: str, pixels: str) -> None:
    with av.open(str(path), "w", format=container) as file:
        stream: Any = file.add_stream(codec, rate=50)
        stream.width = stream.height = 32
        stream.pix_fmt = pixels
        for _ in range(3 * STEPS):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((32, 32, 3), np.uint8), format="rgb24")))
        file.mux(stream.encode())


def test_documents_of_a_lerobot_folder_have_a_bounded_size(sources: Path, tmp_path: Path) -> None:
    for name, most in (("meta/info.json", 1 << 22), ("meta/orbit_episodes.json", 1 << 25)):
        bad = shutil.copytree(sources / "folder", tmp_path / name.replace("/", "_"))
        (bad / name).write_bytes((bad / name).read_bytes() + b" " * most)
        with pytest.raises(ConfigurationError, match=f"larger than {most:,} bytes"):
            LeRobotDataset(bad)


def _with(path: Path, budget: ReadBudget) -> LeRobotDataset:
    """A dataset that was opened within the usual budget, and whose episodes are read within another."""
    dataset = LeRobotDataset(path)
    dataset.budget = budget
    return dataset


def replay_buffer(path: Path, version: Any = 2) -> Path:
    root = zarr.open_group(zarr.storage.LocalStore(path), mode="w", zarr_format=version)
    root.create_array("data/action", data=np.zeros((10, 2), np.float32), chunks=(10, 2), compressors=None)
    root.create_array("meta/episode_ends", data=np.array([4, 10]), compressors=None)
    return path


def described(path: Path, **values: Any) -> None:
    path.write_text(json.dumps({**json.loads(path.read_text()), **values}))


NOTHING = np.zeros(ZEROS, np.uint8)
STREAMED = b"\x28\xb5\x2f\xfd\x00\x58" + b"\x02\x00\x10\x00" * 300 + b"\x01\x00\x00"
"""A frame of Zstandard that does not say its size: blocks of a repeated byte, of 128 KiB each."""


@pytest.mark.parametrize(
    ("codec", "stored"),
    [
        ("gzip", lambda: gzip.compress(NOTHING.tobytes())),
        ("zlib", lambda: zlib.compress(NOTHING.tobytes())),
        ("bz2", lambda: bz2.compress(NOTHING.tobytes())),
        ("lzma", lambda: lzma.compress(NOTHING.tobytes(), preset=0)),
        ("zstd", lambda: numcodecs.Zstd().encode(NOTHING)),
        ("zstd", lambda: STREAMED),
        ("blosc", lambda: numcodecs.Blosc().encode(NOTHING)),
        ("lz4", lambda: numcodecs.LZ4().encode(NOTHING)),
    ],
)
def test_a_chunk_of_zarr_that_unpacks_to_more_than_a_chunk_is_refused(
    codec: str, stored: Callable[[], bytes], tmp_path: Path
) -> None:
    path = replay_buffer(tmp_path / "a.zarr")
    described(path / "data/action/.zarray", compressor={"id": codec})
    (path / "data/action/0.0").write_bytes(stored())
    with pytest.raises(ConfigurationError, match="unpacks to more than the 80 bytes of a chunk"):
        ZarrDataset(path).read(0)


@pytest.mark.parametrize("codec", ["gzip", "zlib", "bz2", "lzma", "zstd", "blosc", "lz4"])
def test_a_chunk_that_is_as_large_as_it_should_be_is_read(codec: str, tmp_path: Path) -> None:
    path = replay_buffer(tmp_path / "a.zarr")
    described(path / "data/action/.zarray", compressor={"id": codec})
    values = np.arange(20, dtype=np.float32).reshape(10, 2)
    (path / "data/action/0.0").write_bytes(numcodecs.get_codec({"id": codec}).encode(values))
    np.testing.assert_array_equal(ZarrDataset(path).read(1).arrays["actions"], values[4:])


def test_descriptions_of_zarr_that_lead_elsewhere_are_refused(tmp_path: Path) -> None:
    consolidated = replay_buffer(tmp_path / "consolidated.zarr")
    pickle = {"zarr_format": 2, "shape": [10, 2], "chunks": [10, 2], "dtype": "|O", "fill_value": "", "order": "C"}
    pickle |= {"filters": [{"id": "vlen-utf8"}], "compressor": {"id": "pickle", "protocol": 5}}
    names = (".zgroup", "data/.zgroup", "meta/.zgroup", "meta/episode_ends/.zarray")
    sound = {name: json.loads((consolidated / name).read_text()) for name in names}
    document = {"zarr_consolidated_format": 1, "metadata": {**sound, "data/action/.zarray": pickle}}
    (consolidated / ".zmetadata").write_text(json.dumps(document))
    assert not ZarrDataset(consolidated).read(0).arrays["actions"].any()  # as the checked description says
    for number, (change, message) in enumerate(
        (
            ({"chunks": [30_000, 30_000]}, "in chunks of 3,600,000,000"),
            ({"shape": [1_000_000, 2], "chunks": [1, 2]}, "lacks 1,000,000 of its chunks"),
            ({"dtype": "<c8"}, "holds <c8, which is not read"),
            ({"filters": [{"id": "gzip"}], "compressor": {"id": "gzip"}}, "packed more than once"),
            ({"compressor": {"id": "lzma", "format": 3, "filters": [{"id": 33}]}}, "'lzma without a header'"),
        )
    ):
        bad = replay_buffer(tmp_path / f"{number}.zarr")
        described(bad / "data/action/.zarray", **change)
        with pytest.raises(ConfigurationError, match=message):
            ZarrDataset(bad)
    newer = replay_buffer(tmp_path / "newer.zarr", 3)
    for codecs, message in (
        (["numcodecs.pickle"], "codec 'pickle'"),
        ([{"name": "bytes"}, {"name": "gzip"}, {"name": "numcodecs.shuffle"}], "packed more than once"),
        ([{"name": "sharding_indexed", "configuration": {}}], "codec 'sharding_indexed'"),
    ):
        described(newer / "data/action/zarr.json", codecs=codecs)
        with pytest.raises(ConfigurationError, match=message):
            ZarrDataset(newer)


def test_ends_that_are_complex_are_not_taken_for_real_ones(tmp_path: Path) -> None:
    path = replay_buffer(tmp_path / "a.zarr")
    described(path / "meta/episode_ends/.zarray", dtype="<c16", shape=[1], chunks=[1])
    with pytest.raises(ConfigurationError, match="holds <c16"):
        ZarrDataset(path)


@pytest.mark.parametrize("name", ["whole.hdf5", "folder", "zarr"])
def test_every_reader_keeps_to_the_budget(name: str, sources: Path, tmp_path: Path) -> None:
    path = replay_buffer(tmp_path / "a.zarr") if name == "zarr" else sources / name
    with opened(path) as dataset:
        for budget, message in (
            (ReadBudget(bytes=10), "ReadBudget.bytes"),
            (ReadBudget(seconds=1e-9), "not read with"),
        ):
            vars(dataset)["budget"] = budget
            with pytest.raises(ConfigurationError, match=message):
                dataset.read(0)
    for budget in (ReadBudget(bytes=10), ReadBudget(seconds=1e-9)):
        with pytest.raises(ConfigurationError, match="ReadBudget"), opened(path, budget):
            pass
    with pytest.raises(ConfigurationError, match="must be above zero"):
        ReadBudget(seconds=0.0)


def test_the_command_line_sets_the_budget(sources: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = {field.name.removeprefix("read_"): field.default for field in fields(ReadSettings)}
    assert options == {field.name: field.default for field in fields(ReadBudget)}
    assert main(["data", "info", str(sources / "whole.hdf5"), "--read-bytes", "2000"]) == 2
    error = capsys.readouterr().err
    assert "raise ReadBudget.bytes (--read-bytes) if you trust it" in error
    assert (
        main(["data", "convert", str(sources / "folder"), "--output", str(tmp_path / "a.hdf5"), "--read-pixels", "9"])
        == 2
    )
    assert "--read-pixels" in capsys.readouterr().err
    assert main(["data", "info", str(sources / "whole.hdf5"), "--read-bytes", "-5"]) == 2


def test_large_files_may_take_longer_to_open() -> None:
    account = ReadAccount(ReadBudget(seconds=1e-6), "it", 1 << 50)
    account.check_time()


def test_names_are_printed_as_they_are(sources: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "[bold]a[/red].hdf5"
    path.parent.mkdir()
    shutil.copy(sources / "whole.hdf5", path)
    with h5py.File(path, "r+") as file:
        file["data/demo_0/[/bold]"] = np.zeros(STEPS)
        told = file["data/demo_0"].attrs
        about = json.loads(str(told["orbit_episode"]))
        told["orbit_episode"] = json.dumps({**about, "metrics": {"[/x]\x1b[31m": 1.0}, "backend": "[/y]:smile:"})
    assert main(["data", "info", str(path)]) == 0
    printed = capsys.readouterr().out
    for text in ("[/bold]", "[/x]\N{REPLACEMENT CHARACTER}[31m", "[/y]:smile:", "red].hdf5"):
        assert text in printed
    assert main(["data", "convert", str(path), "--output", str(path.with_name("b].hdf5"))]) == 0
