"""Cache of parsed models on disk: a JSON file per model, and its meshes as arrays that are checked on reading.

A folder of the cache may be copied to a machine that has none of the packages the models come from.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import os
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from orbit_assets import sources
from orbit_core import preparation, scene
from orbit_core.files import written_whole
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import AssetError, StorageError
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import validate
from orbit_core.scene import Articulation, Mesh, MeshCollision

# Numbers of an array that the JSON file itself holds, if they are no picture's.
_INLINE = 64
# Modules and folders whose code does not affect what is read from a file.
_NO_READERS = {"decomposition.py", "object_kinds.py", "objects.py", "robot_parts.py", "robots", "audit", "cli"}


@dataclass(frozen=True)
class Model:
    """A recipe for an articulation from the files of installed packages.

    ``build`` runs where the cache holds no copy made by the same recipe from the same versions of ``packages``.
    ``parts`` are functions of other modules that the recipe uses: a change there counts as a change of the recipe.
    """

    name: str
    """Name of the cached copy."""
    build: Callable[[], Articulation]
    packages: tuple[str, ...]
    licence: str
    """Licence of the model, as its source states it."""
    parts: tuple[Callable[..., Articulation], ...] = ()

    def fingerprint(self) -> str:
        """Return a digest that changes with the code of the recipe's module, of a part's or of a reader."""
        recipe = (Path(function.__code__.co_filename) for function in (self.build, *self.parts))
        return _digest_files(*recipe, *_reader_files())


def cache_folder() -> Path:
    """``ORBIT_CACHE_DIR``, or ``orbit`` in the user's cache folder (``XDG_CACHE_HOME``, else ``~/.cache``)."""
    if chosen := os.environ.get("ORBIT_CACHE_DIR"):
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "orbit"


def cached_articulation(model: Model) -> Articulation:
    """Return the model's articulation, merged and validated; from the cache where that holds a current copy.

    Where a package is not installed, the copy at hand is used; if an older recipe made it, its notes say so.

    Raises:
        AssetError: there is neither a usable copy nor the package.
    """
    path = cache_folder() / "models" / f"{model.name}.json"
    versions = {package: sources.installed_version(package) for package in model.packages}
    missing = [package for package, version in versions.items() if version is None]
    fingerprint = model.fingerprint()
    if missing and not path.exists():
        raise sources.missing_package(missing[0])
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        current = manifest["fingerprint"] == fingerprint
        if missing or (current and manifest["packages"] == versions):
            articulation = _decode(manifest["articulation"], cache_folder())
            return articulation if current else _with_note(articulation, missing[0])
    # JSON of any shape may be in a damaged file: all errors that decoding can raise mean the same.
    except (OSError, EOFError, ValueError, KeyError, TypeError, AttributeError) as error:
        if missing:
            raise AssetError(
                f"the cached model '{path}' is damaged ({error}) and package '{missing[0]}' is not there to rebuild "
                f"it: copy the cache folder again, or {install_extra('robots')}"
            ) from error
    articulation = validate(merge_fixed_links(validate(model.build())))
    _store(path, articulation, {"fingerprint": fingerprint, "packages": versions, "licence": model.licence})
    return articulation


# The copy is used although it is not current: the user has no other, and must know.
def _with_note(articulation: Articulation, package: str) -> Articulation:
    note = f"cached copy made by another version of its recipe; package '{package}' is not installed to rebuild it"
    return replace(articulation, notes=(*articulation.notes, note))


def _store(path: Path, articulation: Articulation, manifest: dict[str, Any]) -> None:
    try:
        # Meshes first: a process that finds the description finds all meshes that it names.
        manifest["articulation"] = _encode(articulation, cache_folder())
        write_cached(path, lambda file: file.write_text(json.dumps(manifest), encoding="utf-8"))
    except (StorageError, OSError) as error:
        warnings.warn(
            f"the model '{articulation.name}' could not be cached ({error}); set ORBIT_CACHE_DIR to a folder that can "
            "be written, or every start reads its source files again",
            stacklevel=3,
        )


def write_cached(path: Path, write: Callable[[Path], Any]) -> None:
    """Write the whole file or nothing; other processes may be writing the same one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as written:
        write(written)


def _encode(value: Any, folder: Path) -> Any:
    """Return scene data as plain JSON; a value equal to its field's default is left out."""
    if isinstance(value, Mesh):
        return _store_mesh(value, folder)
    if isinstance(value, Enum):
        return {"is": type(value).__name__, "value": value.value}
    if dataclasses.is_dataclass(value):
        fields = ((field, getattr(value, field.name)) for field in dataclasses.fields(value))
        kept = {field.name: _encode(item, folder) for field, item in fields if not _is_default(field, item)}
        return {"is": type(value).__name__, **kept}
    if isinstance(value, np.ndarray):
        # Inertias and the like are read more quickly with their body than from a file of their own.
        if value.size <= _INLINE and value.dtype.kind == "f":
            return {"is": "array", "value": value.tolist()}
        return _store_array(value, folder)
    if isinstance(value, tuple):
        return [_encode(item, folder) for item in value]
    return value


def _is_default(field: dataclasses.Field[Any], value: Any) -> bool:
    # Arrays do not compare to one truth value, and are never defaults.
    if isinstance(value, np.ndarray):
        return False
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory() == value
    return field.default is not dataclasses.MISSING and field.default == value


def _decode(value: Any, folder: Path) -> Any:
    if isinstance(value, list):
        return tuple(_decode(item, folder) for item in value)
    if not isinstance(value, dict):
        return value
    fields = dict(value)
    kind = fields.pop("is")
    if kind == "stored mesh":
        return _load_mesh(folder, **fields)
    if kind == "array":
        return np.array(fields["value"], dtype=np.float64)
    if kind == "stored array":
        return _load_arrays(folder, fields["key"], [fields["shape"]], ["array"])[0]
    return getattr(scene, kind)(**{name: _decode(item, folder) for name, item in fields.items()})


def _store_array(array: np.ndarray, folder: Path) -> dict[str, Any]:
    (array,) = _written(folder, {"array": array})
    return {"is": "stored array", "key": digest_arrays(array), "shape": array.shape}


def _store_mesh(mesh: Mesh, folder: Path) -> dict[str, Any]:
    named = {"vertices": mesh.vertices, "faces": mesh.faces}
    if mesh.coordinates is not None:
        named["coordinates"] = mesh.coordinates
    arrays = _written(folder, named)
    return {
        "is": "stored mesh",
        "key": digest_arrays(*arrays),
        "collision": mesh.collision.value,
        "shapes": [array.shape for array in arrays],
    }


def _written(folder: Path, arrays: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """Write arrays, a file for each, under the key of their contents; return them as they are in memory order."""
    contiguous = [np.ascontiguousarray(array) for array in arrays.values()]
    key = digest_arrays(*contiguous)
    for name, array in zip(arrays, contiguous, strict=True):
        write_cached(_array_path(folder, key, name), functools.partial(np.save, arr=array, allow_pickle=False))
    return contiguous


def _load_mesh(folder: Path, key: str, collision: str, shapes: list[list[int]]) -> Mesh:
    # Meshes of models without pictures have two arrays, those with coordinates on a picture three.
    vertices, faces, *rest = _load_arrays(folder, key, shapes, ["vertices", "faces", "coordinates"][: len(shapes)])
    return Mesh(vertices, faces, MeshCollision(collision), *rest)


def _load_arrays(folder: Path, key: str, shapes: list[list[int]], names: list[str]) -> list[np.ndarray]:
    # Mapping them would take longer than reading, as the digest touches every page.
    arrays = [np.load(_array_path(folder, key, name), allow_pickle=False) for name in names]
    for array in arrays:
        # Arrays are shared between all articulations that use them: nobody may write to them.
        array.flags.writeable = False
    if [list(array.shape) for array in arrays] != shapes:
        raise ValueError(f"array {key} has another size than its model says")
    if digest_arrays(*arrays) != key:
        raise ValueError(f"array {key} has other contents than when it was stored")
    return arrays


def digest_arrays(*arrays: np.ndarray) -> str:
    """Return a key that changes with the arrays' types, shapes and contents."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(array.data)
    return digest.hexdigest()[:32]


def _array_path(folder: Path, key: str, name: str) -> Path:
    return folder / "meshes" / f"{key}.{name}.npy"


@functools.cache
def _reader_files() -> tuple[Path, ...]:
    files = (*Path(__file__).parent.rglob("*.py"), *Path(preparation.__file__).parent.glob("*.py"))
    return tuple(sorted(path for path in files if not {path.name, path.parent.name} & _NO_READERS))


def _digest_files(*paths: Path) -> str:
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:32]
