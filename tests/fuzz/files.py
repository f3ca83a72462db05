"""Spoilt files of every format, read and judged: refused in our own words, or accepted with sound numbers alone."""

from __future__ import annotations

import math
import random
import shutil
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbit_assets import load_articulation
from orbit_assets.meshes import load_mesh, load_parts
from orbit_core.interfaces.errors import AssetError
from tests.fuzz.mutations import mutate

CORPUS = Path(__file__).parent / "corpus"
MODELS = ("arm.urdf", "arm.xml", "arm.usda", "arm.sdf", "arm.xacro")
MESHES = ("box.obj", "ascii.stl", "binary.stl", "box.dae", "box.glb", "box.ply", "box.off", "box.mtl", "material_0.png")
FORMATS = (
    ("arm.urdf",), ("arm.xml", "arm.xml", "parts.xml"), ("arm.usda", "arm.usda", "layer.usda"), ("arm.sdf",),
    ("arm.xacro", "arm.xacro", "rods.xacro", "sizes.yaml"), MESHES,
)  # fmt: skip
"""Files of each format, which are spoilt equally often."""
_READ_BY = {
    "layer.usda": "arm.usda", "box.mtl": "box.obj", "material_0.png": "box.obj", "parts.xml": "arm.xml",
    "rods.xacro": "arm.xacro", "sizes.yaml": "arm.xacro",
}  # fmt: skip
"""Files that others of the corpus name; a spoilt one is read by way of those."""
SECRETS = {
    "secret.obj": "box.obj", "secret.usda": "layer.usda", "secret.xml": "parts.xml", "secret.xacro": "rods.xacro",
    "secret.yaml": "sizes.yaml", "secret.png": "material_0.png", "secret.mtl": "box.mtl", "secret.sdf": "arm.sdf",
}  # fmt: skip
"""Files next to the model's folder, which nothing may open."""
_UNLIMITED = ("effort_limit", "velocity_limit", "lower_limit", "upper_limit")
_NOT_NEGATIVE = (
    "mass", "radius", "half_length", "half_extents", "damping", "friction", "armature", "stiffness", "effort_limit",
    "velocity_limit", "static_friction", "dynamic_friction", "torsional_friction", "rolling_friction", "restitution",
    "color",
)  # fmt: skip


def spoil(folder: Path, seed: str) -> tuple[Path, str]:
    """Write the corpus to a folder with one file spoilt, as the seed has it: the file to read, and what was done."""
    rng = random.Random(seed)
    shutil.copytree(CORPUS, folder)
    for secret, source in SECRETS.items():
        shutil.copyfile(CORPUS / source, folder.parent / secret)
    name = rng.choice(rng.choice(FORMATS))
    how, data = mutate((CORPUS / name).read_bytes(), rng)
    # Other programs open the machine's own files, too, so that an absolute path leads to one that is watched.
    (folder / name).write_bytes(data.replace(b"/etc/passwd", bytes(folder.parent / "secret.obj")))
    return folder / _READ_BY.get(name, name), f"{name}: {how}"


def judge(path: Path) -> tuple[str, str]:
    """Read a file: whether it was ``accepted``, ``refused`` or ``failed``, and why."""
    try:
        read = _read(path)
    except AssetError as error:
        return _judged_refusal(error, path)
    except BaseException as error:
        return "failed", f"{type(error).__name__}: {error}"
    fault = "".join(_faults(read, ""))
    return ("failed", f"accepted with {fault}") if fault else ("accepted", "")


def _read(path: Path) -> Any:
    if path.name in MODELS:
        return load_articulation(path)
    load_parts(path)
    return load_mesh(path)


def _judged_refusal(error: AssetError, path: Path) -> tuple[str, str]:
    text = str(error)
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return "failed", f"it asked for too much memory: {text}"
        cause = cause.__cause__ or cause.__context__
    if "\n" in text or not text:
        return "failed", f"its message is not one line: {text!r}"
    if str(path.parent) not in text:
        return "failed", f"its message names no file: {text}"
    return "refused", text


def _faults(value: Any, place: str) -> list[str]:
    """The first number that may not be, with its place; the fuzz's own judgement, apart from the readers' checks."""
    name = place.rpartition(".")[2].partition("[")[0]
    if is_dataclass(value):
        parts = [(f"{place}.{field.name}", getattr(value, field.name)) for field in fields(value)]
        return next((found for where, part in parts if (found := _faults(part, where))), [])
    if isinstance(value, tuple):
        return next((found for index, part in enumerate(value) if (found := _faults(part, f"{place}[{index}]"))), [])
    if isinstance(value, np.ndarray):
        if not np.isfinite(value).all():
            return [f"{place} not finite"]
        return [f"{place} negative"] if name == "faces" and value.size and value.min() < 0 else []
    if isinstance(value, float):
        if math.isnan(value) or (math.isinf(value) and name not in _UNLIMITED):
            return [f"{place} = {value}"]
        return [f"{place} = {value}"] if value < 0 and name in _NOT_NEGATIVE else []
    return []
