"""Spoilt datasets, policies and recordings, read and judged: refused in our own words, or read soundly."""

from __future__ import annotations

import copy
import functools
import json
import random
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import torch
import zarr

from orbit_conformance.recording import Recording
from orbit_core.interfaces import OrbitError
from orbit_data.episodes import Episode, EpisodeInfo
from orbit_data.formats import opened, write_dataset
from orbit_learn.actuators.networks import NetworkDescription, read_network, write_network
from orbit_learn.actuators.recordings import QUANTITIES, read_recording
from orbit_learn.description import Part, PolicyDescription
from orbit_learn.networks import Perceptron
from orbit_learn.policy import Policy, load_policy
from orbit_learn.training import read_checkpoint, write_checkpoint
from tests.fuzz.mutations import bytes_flipped, cut, mutate, words_written
from tests.fuzz.watch import contents, watched

STEPS = 8
SECRET = "secret"
"""A file next to what is read, which links and references of spoilt files lead to."""


def _episode(number: int) -> Episode:
    random_numbers = np.random.default_rng(number)
    arrays = {
        "actions": random_numbers.normal(size=(STEPS, 2)).astype(np.float32),
        "rewards": np.ones(STEPS, np.float32),
        "obs/joints": random_numbers.normal(size=(STEPS, 3)).astype(np.float32),
        "obs/camera": random_numbers.integers(0, 255, (STEPS, 32, 32, 3)).astype(np.uint8),
    }
    return Episode(EpisodeInfo(number, STEPS, success=True, metrics={"distance": 0.1}), arrays)


def _zarr(path: Path, version: int) -> None:
    store = zarr.storage.ZipStore(path, mode="w") if path.suffix == ".zip" else zarr.storage.LocalStore(path)
    root = zarr.open_group(store, mode="w", zarr_format=version)  # pyright: ignore[reportArgumentType]
    root.create_array("data/action", data=np.arange(20, dtype=np.float32).reshape(10, 2), chunks=(3, 2))
    root.create_array("data/img", data=np.zeros((10, 8, 8, 3), np.uint8), chunks=(2, 8, 8, 3))
    root.create_array("meta/episode_ends", data=np.array([4, 10]))
    store.close()


def _joint_data() -> dict[str, Any]:
    generator = np.random.default_rng(0)
    return {
        "time": np.arange(200) / 200.0,
        "joints": np.array(["knee", "hip"]),
        **{name: generator.normal(size=(200, 2)) for name in QUANTITIES},
    }


@functools.cache
def corpus() -> Path:
    """Sound files of every kind, in a folder that is made once."""
    folder = Path(tempfile.mkdtemp())
    for name in ("set.hdf5", "packed.hdf5", "folder"):
        options = {"compression": "gzip"} if name == "packed.hdf5" else {}
        write_dataset(folder / name, map(_episode, range(3)), None, rate=50.0, **options)
    for name, version in (("two.zarr", 2), ("three.zarr", 3), ("two.zarr.zip", 2)):
        _zarr(folder / name, version)
    data = _joint_data()
    np.savez_compressed(folder / "joints.npz", **data)
    with h5py.File(folder / "joints.h5", "w") as file:
        for name, values in data.items():
            file[name] = values.astype("S") if name == "joints" else values
    columns = [f"{joint}.{quantity}" for joint in data["joints"] for quantity in QUANTITIES]
    values = [data[quantity][:, joint] for joint in range(2) for quantity in QUANTITIES]
    rows = np.column_stack([data["time"], *values])
    np.savetxt(folder / "joints.csv", rows, "%.4g", ",", header=",".join(["time", *columns]), comments="")
    Recording(
        "Reach", "an_engine", 0, {}, 0.02, np.zeros((9, 2, 3), np.float32), np.array([9, 4]),
        {"robot/hand": np.zeros((9, 2, 7), np.float32)},
    ).save(folder / "episodes.npz")  # fmt: skip
    description = PolicyDescription(
        "Reach", "a_robot", "joints", (Part("seen", 3),), (Part("moved", 2),), 0.02, "an_engine", "a_library", 1
    )
    network = Perceptron((4,))
    policy = Policy(network.build(3, 2), network, description)
    policy.save(folder / "policy_1.safetensors")
    policy.export_onnx(folder / "policy.onnx")
    write_network(
        folder / "actuator.safetensors", NetworkDescription(kind="mlp", hidden_sizes=(4,), rate=200.0).build()
    )
    write_checkpoint(folder / "checkpoint_1.safetensors", "a_library", {"weights": torch.ones(3), 1: [2, None, "x"]})
    return folder


def _read_dataset(path: Path) -> Iterator[Any]:
    with opened(path) as dataset:
        for place in range(len(dataset.episodes)):
            yield from dataset.read(place).arrays.values()


def _read_joints(path: Path) -> Iterator[Any]:
    recording = read_recording(path)
    yield from (recording.inputs.numpy(), recording.efforts.numpy())


def _read_policy(path: Path) -> Iterator[Any]:
    policy = load_policy(path)
    yield policy.module(policy.description.zeros(2)).numpy()


def _read_network(path: Path) -> Iterator[Any]:
    network = read_network(path)
    yield network.sequence(torch.zeros(5, 2, 2)).numpy()


def _read_checkpoint(path: Path) -> Iterator[Any]:
    read_checkpoint(path, "a_library")
    yield np.zeros(0)


def _read_episodes(path: Path) -> Iterator[Any]:
    yield Recording.load(path).actions


READERS: dict[str, Callable[[Path], Iterator[Any]]] = {
    **dict.fromkeys(("set.hdf5", "packed.hdf5", "folder", "two.zarr", "three.zarr", "two.zarr.zip"), _read_dataset),
    **dict.fromkeys(("joints.npz", "joints.h5", "joints.csv"), _read_joints),
    **dict.fromkeys(("policy_1.safetensors", "policy.onnx"), _read_policy),
    "actuator.safetensors": _read_network,
    "checkpoint_1.safetensors": _read_checkpoint,
    "episodes.npz": _read_episodes,
}
KINDS = {
    "hdf5": ("set.hdf5", "packed.hdf5"),
    "lerobot": ("folder",),
    "zarr": ("two.zarr", "three.zarr", "two.zarr.zip"),
    "policies": ("policy_1.safetensors", "policy.onnx", "actuator.safetensors", "checkpoint_1.safetensors"),
    "recordings": ("joints.npz", "joints.h5", "joints.csv", "episodes.npz"),
}
KINDS["data"] = tuple(READERS)
"""Files by what is fuzzed."""


def warm() -> None:
    """Load the libraries, whose memory is not the files'."""
    for name in READERS:
        judge(corpus() / name)


def spoil(folder: Path, seed: str, kind: str) -> tuple[Path, str]:
    """Write a file or folder of a kind, spoilt as the seed has it: what to read, and what was done."""
    rng = random.Random(seed)
    name = rng.choice(KINDS[kind])
    folder.mkdir()
    source, path = corpus() / name, folder / name
    (folder / SECRET).write_bytes(bytes(1000))
    (shutil.copytree if source.is_dir() else shutil.copy)(source, path)
    files = sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]
    target = rng.choice(files)
    if path.suffix in (".hdf5", ".h5") and rng.random() < 0.5:
        return path, f"{name}: {_restructured(path, rng)}"
    if path.is_dir() and rng.random() < 0.05:
        (folder / SECRET).write_bytes(target.read_bytes())
        target.unlink()
        target.symlink_to(folder / SECRET)
        return path, f"{name}: {target.name} linked"
    data = target.read_bytes()
    if target.suffix == ".json" or target.name.startswith(".z"):
        data, how = _other_value(data, rng), "other value"
    elif target.suffix in (".csv", ".md") or rng.random() < 0.3:
        how, data = mutate(data, rng)
    else:
        # Where headers are: at the beginning and the end.
        size = rng.choice((200, 1000, 8000, len(data)))
        change = rng.choice((bytes_flipped, bytes_flipped, words_written, words_written, cut))
        how = f"{change.__name__} of {size}"
        data = (
            change(data[:size], rng) + data[size:] if rng.random() < 0.6 else data[:-size] + change(data[-size:], rng)
        )
    target.write_bytes(data)
    return path, f"{name}: {target.name}: {how}"


def judge(path: Path) -> tuple[str, str]:
    """Read a file: whether it was ``accepted``, ``refused`` or ``failed``, and why."""
    before = contents(path.parent)
    with watched([each] if (each := path.parent / SECRET).exists() else []) as opened_files:
        verdict, why = _judged(path)
    if opened_files:
        return "failed", f"opened {opened_files[0]}: {why}"
    if contents(path.parent) != before:
        return "failed", f"wrote into its folder: {why}"
    return verdict, why


def _judged(path: Path) -> tuple[str, str]:
    try:
        for array in READERS[path.name](path):
            if array.dtype.kind not in "fiub" or not np.isfinite(array).all():
                return "failed", f"accepted with {array.dtype} that is not finite"
    except OrbitError as error:
        return ("failed", f"its message is not one line: {error}") if "\n" in str(error) else ("refused", str(error))
    except BaseException as error:
        return "failed", f"{type(error).__name__}: {error}"
    return "accepted", ""


_VALUES = (
    None, -1, 0, 1, 2**31, 2**63, 10**30, 1e308, -0.5, True, "", "x" * 5000, "../../etc/passwd", "/etc/passwd",
    "[/bold]", "\x1b[31m", [], {}, [[]], [1, 2], {"id": "pickle"}, {"name": "numcodecs.pickle"}, "|O", "<c8", "<f8",
    {"id": "gzip"}, {"id": "lzma", "format": 3}, "{chunk_index:999999999}", "v2.1", "default",
)  # fmt: skip


def _other_value(data: bytes, rng: random.Random) -> bytes:
    """JSON with another value in one to three places, or without one."""
    document = json.loads(data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        places = [*_places(document)]
        if not places:
            break
        owner, key = rng.choice(places)
        if rng.random() < 0.15:
            del owner[key]
        else:
            owner[key] = copy.deepcopy(rng.choice(_VALUES))
    return json.dumps(document).encode()


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    for key in value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield value, key
        yield from _places(value[key])


def _restructured(path: Path, rng: random.Random) -> str:
    """Change the structure of an HDF5 file in one to three places, as its library lets anyone do."""
    done: list[str] = []
    with h5py.File(path, "r+") as file:
        for _ in range(rng.choice((1, 1, 2, 3))):
            names: list[str] = []
            file.visit(names.append)
            if not names:
                break
            name = rng.choice(names)
            change = rng.choice(_CHANGES)
            done.append(f"{change.__name__} {name}")
            try:
                change(file, name, rng)
            except (ValueError, TypeError, RuntimeError, KeyError, OSError):
                done[-1] += " (could not)"
    return ", ".join(done)


def _dropped(file: h5py.File, name: str, rng: random.Random) -> None:
    del file[name]


def _linked(file: h5py.File, name: str, rng: random.Random) -> None:
    link = rng.choice(
        (
            h5py.SoftLink("/data"),
            h5py.SoftLink(name),
            h5py.ExternalLink(f"../{SECRET}", "/"),
            h5py.ExternalLink(SECRET, "/"),
            file["/"],
            file[name],
        )
    )
    place = rng.choice((f"{name}_too", name))
    if place in file:
        del file[place]
    file[place] = link


def _replaced(file: h5py.File, name: str, rng: random.Random) -> None:
    del file[name]
    options: list[dict[str, Any]] = [
        {"data": rng.choice((1.0, "text", np.zeros(STEPS, "c8"), np.full(STEPS, np.nan), np.zeros((0, 3)), b"\0\1"))},
        {"shape": (STEPS, 10**9), "dtype": "f4", "chunks": (STEPS, 1000)},
        {"shape": (STEPS, 3), "maxshape": (None, None), "dtype": "f4", "chunks": (30_000, 30_000)},
        {"shape": (10**9,), "dtype": "u1", "chunks": (1,)},
        {"shape": (STEPS,), "dtype": "u1", "external": [(str(Path(file.filename).with_name(SECRET)), 0, STEPS)]},
        {"data": np.zeros((STEPS, 3_000_000), np.float32), "chunks": (1, 3_000_000), "compression": "gzip"},
        {"shape": (STEPS,), "dtype": h5py.vlen_dtype(np.float32)},
        {"shape": (STEPS,), "dtype": h5py.ref_dtype},
        {"shape": (STEPS, 2), "dtype": "f4", "chunks": (STEPS, 2), "scaleoffset": 2},
    ]
    file.create_dataset(name, **rng.choice(options))


def _grouped(file: h5py.File, name: str, rng: random.Random) -> None:
    del file[name]
    group = file.create_group(name)
    for _ in range(rng.choice((1, 5, 40))):
        group["b"] = inner = group.create_group("a")
        group = inner
    group["x"] = np.zeros(STEPS)


def _attributed(file: h5py.File, name: str, rng: random.Random) -> None:
    values = (-1, 10**15, "[" * 5000, '{"number":0,"length":1e400}', np.zeros(5), "x" * 60_000, b"\xff", 1.5, np.nan)
    key = rng.choice(("num_samples", "orbit_episode", "total"))
    file[name].attrs[key] = rng.choice(values)


_CHANGES = (_dropped, _linked, _replaced, _replaced, _grouped, _attributed, _attributed)


def clean() -> None:
    """Delete the sound files."""
    if corpus.cache_info().currsize:
        shutil.rmtree(corpus(), ignore_errors=True)
