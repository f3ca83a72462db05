"""Replay buffers in Zarr, of both formats and as archives, read; and those that would harm, refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import zarr
import zarr.storage

from orbit_core.cli import main
from orbit_core.interfaces import ConfigurationError
from orbit_data.formats import opened, write_dataset
from orbit_data.zarr_reader import ZarrDataset

ACTION = np.arange(20, dtype=np.float32).reshape(10, 2)
PICTURES = np.arange(10 * 4 * 4 * 3, dtype=np.uint8).reshape(10, 4, 4, 3)


def write(path: Path, version: Literal[2, 3] = 3) -> Path:
    """Two episodes, of 4 and 6 steps, as Diffusion Policy writes them."""
    store = zarr.storage.ZipStore(path, mode="w") if path.suffix == ".zip" else zarr.storage.LocalStore(path)
    root = zarr.open_group(store, mode="w", zarr_format=version)
    root.create_array("data/action", data=ACTION, chunks=(3, 2))
    root.create_array("data/img", data=PICTURES, chunks=(2, 4, 4, 3))
    root.create_array("meta/episode_ends", data=np.array([4, 10]))
    store.close()
    return path


@pytest.mark.parametrize(("name", "version"), [("a.zarr", 2), ("b.zarr", 3), ("c.zarr.zip", 2)])
def test_episodes_are_read_and_converted(name: str, version: Literal[2, 3], tmp_path: Path) -> None:
    path = write(tmp_path / name, version)
    assert main(["data", "convert", str(path), "--output", str(tmp_path / "x.hdf5")]) == 0
    for each in (path, tmp_path / "x.hdf5"):
        with opened(each) as dataset:
            assert [info.length for info in dataset.episodes] == [4, 6]
            second = dataset.read(1).arrays
            np.testing.assert_array_equal(second["actions"], ACTION[4:])
            np.testing.assert_array_equal(second["obs/img"], PICTURES[4:])
            assert dataset.read(0, ["actions"]).arrays.keys() == {"actions"}
            with pytest.raises(ConfigurationError, match="holds no manifest"):
                dataset.known()


def changed(path: Path, **values: object) -> None:
    """Change the description of the actions."""
    described = json.loads(path.read_text())
    path.write_text(json.dumps(described | values))


def test_what_would_run_code_or_fill_the_memory_is_refused(tmp_path: Path) -> None:
    pickled = write(tmp_path / "pickled.zarr", 2)
    changed(pickled / "data/action/.zarray", filters=[{"id": "pickle"}])
    with pytest.raises(ConfigurationError, match="the codec 'pickle', which is not read"):
        ZarrDataset(pickled)
    objects = write(tmp_path / "objects.zarr", 2)
    changed(objects / "data/action/.zarray", dtype="|O")
    with pytest.raises(ConfigurationError, match=r"holds \|O, which is not read"):
        ZarrDataset(objects)
    newer = write(tmp_path / "newer.zarr")
    changed(newer / "data/action/zarr.json", codecs=[{"name": "numcodecs.pickle", "configuration": {}}])
    with pytest.raises(ConfigurationError, match="the codec 'pickle'"):
        ZarrDataset(newer)
    huge = write(tmp_path / "huge.zarr")
    changed(huge / "data/action/zarr.json", shape=[10**12, 2])
    with pytest.raises(ConfigurationError, match=r"would be 8e\+03 GB, of which next to nothing is stored"):
        ZarrDataset(huge)
    linked = write(tmp_path / "linked.zarr")
    (linked / "data/action/c/0/0").unlink()
    (linked / "data/action/c/0/0").symlink_to("/etc/hostname")
    with pytest.raises(ConfigurationError, match="is a link"):
        ZarrDataset(linked)


def test_what_is_no_replay_buffer_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.zarr")
    (path / "meta/episode_ends/zarr.json").unlink()
    with pytest.raises(ConfigurationError, match="cannot be read as a Zarr replay buffer"):
        ZarrDataset(path)
    falling = write(tmp_path / "b.zarr")
    zarr.open_array(falling / "meta/episode_ends", mode="r+")[:] = np.array([10, 4])
    with pytest.raises(ConfigurationError, match="not the rising ends"):
        ZarrDataset(falling)
    (tmp_path / "c.zarr.zip").write_bytes(b"no archive")
    with pytest.raises(ConfigurationError, match="cannot be read as a Zarr replay buffer"):
        ZarrDataset(tmp_path / "c.zarr.zip")
    with pytest.raises(ConfigurationError, match="there is no file or folder"):
        ZarrDataset(tmp_path / "d.zarr")
    truncated = write(tmp_path / "e.zarr")
    chunk = truncated / "data/action/c/1/0"
    chunk.write_bytes(chunk.read_bytes()[:-8])
    with pytest.raises(ConfigurationError, match="cannot be read as a Zarr replay buffer"):
        ZarrDataset(truncated).read(0)
    with pytest.raises(ConfigurationError, match="is read and not written"):
        write_dataset(tmp_path / "f.zarr", [], None)
