"""Archives of kernels that were compiled for GPUs, with the versions and architectures that they fit."""

from __future__ import annotations

import io
import json
import re
import tarfile
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orbit_core.files import written_whole
from orbit_core.interfaces import ConfigurationError

FORMAT = 1
_MANIFEST = "manifest.json"
# A module's folder, and its compiled form for one architecture or the description that goes with it.
_BINARY = re.compile(r"\w+/\w+\.sm(?P<arch>\d+)a?\.cubin")
_META = re.compile(r"\w+/\w+\.meta")
# Limits of what an archive may unpack to; all tasks together take some 50 MB for an architecture.
_MOST_BYTES, _MOST_FILES = 1 << 30, 20_000


@dataclass(frozen=True)
class CompiledModule:
    """Module of kernels, compiled for one architecture."""

    arch: int
    """Compute capability, such as 90."""
    binary: Path
    """Compiled code."""
    meta: Path
    """Description that is read with it."""


def compiled_modules(cache: Path, arch: int | None = None) -> list[CompiledModule]:
    """Return the modules in a cache that are compiled for a GPU.

    Args:
        cache: folder of compiled modules.
        arch: compute capability; any if None.
    """
    found: list[CompiledModule] = []
    for path in sorted(cache.glob("*/*.cubin")):
        match = _BINARY.fullmatch(f"{path.parent.name}/{path.name}")
        meta = path.parent / f"{path.parent.name}.meta"
        if match and meta.exists() and arch in (None, int(match["arch"])):
            found.append(CompiledModule(int(match["arch"]), path, meta))
    return found


def write_archive(path: Path, modules: Sequence[CompiledModule], versions: Mapping[str, str]) -> None:
    """Write modules, with the versions and architectures that they fit, as .tar.xz."""
    manifest = {"kernels": FORMAT, "versions": dict(versions), "architectures": sorted({m.arch for m in modules})}
    with written_whole(path) as written, tarfile.open(written, "w:xz") as archive:
        content = json.dumps(manifest).encode()
        entry = tarfile.TarInfo(_MANIFEST)
        entry.size = len(content)
        archive.addfile(entry, io.BytesIO(content))
        for file in dict.fromkeys(file for module in modules for file in (module.meta, module.binary)):
            archive.add(file, f"{file.parent.name}/{file.name}")


def read_archive(path: Path, cache: Path, gpus: Set[int], versions: Mapping[str, str]) -> tuple[int, set[int]]:
    """Unpack an archive into a cache, and return the number of modules and their architectures.

    Args:
        path: archive of :func:`write_archive`.
        cache: folder of compiled modules.
        gpus: compute capabilities of this machine's GPUs; with none, kernels of any are taken, for another machine.
        versions: of the distributions here that decide whether a module is found.

    Raises:
        ConfigurationError: the file is no such archive, or of other versions or architectures.
    """
    try:
        with tarfile.open(path, "r:xz") as archive:
            entries = iter(archive)
            entry = next(entries, None)
            content = archive.extractfile(entry) if entry is not None and entry.name == _MANIFEST else None
            if content is None:
                raise ConfigurationError(f"{path} is no archive of 'orbit cache export'")
            archs = _checked_manifest(path, json.loads(content.read(1 << 16)), gpus, versions)
            return _unpack(path, archive, entries, cache), archs
    except (OSError, EOFError, tarfile.TarError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{path} is no archive of 'orbit cache export' ({error})") from None


def _checked_manifest(path: Path, manifest: dict[str, Any], gpus: Set[int], versions: Mapping[str, str]) -> set[int]:
    """Return the architectures of an archive that fits this machine."""
    if manifest["kernels"] != FORMAT:
        raise ConfigurationError(f"{path} has format {manifest['kernels']}, and {FORMAT} is read: export it again")
    theirs, ours = {name: str(manifest["versions"][name]) for name in versions}, dict(versions)
    if theirs != ours:
        raise ConfigurationError(
            f"{path} holds kernels of {_words(theirs)}, which {_words(ours)} would not find: build them with the "
            "versions that are installed here"
        )
    archs = {int(arch) for arch in manifest["architectures"]}
    if missing := gpus - archs:
        raise ConfigurationError(
            f"{path} holds kernels for {architecture_names(archs)}, and this machine's GPU is "
            f"{architecture_names(missing)}: orbit cache build TASK --arch {min(missing)}"
        )
    return archs


def _unpack(path: Path, archive: tarfile.TarFile, entries: Iterator[tarfile.TarInfo], cache: Path) -> int:
    """Write the entries that are compiled modules, and return the number of binaries."""
    size, count, binaries = 0, 0, 0
    for entry in entries:
        size, count = size + entry.size, count + 1
        if size > _MOST_BYTES or count > _MOST_FILES:
            raise ConfigurationError(f"{path} unpacks to more than {_MOST_BYTES >> 20} MiB or {_MOST_FILES:,} files")
        binary = _BINARY.fullmatch(entry.name) is not None
        # Names of this form hold no path out of the cache.
        if not entry.isfile() or not (binary or _META.fullmatch(entry.name)):
            raise ConfigurationError(f"{path} holds {entry.name[:80]!r}, which is no compiled module")
        content, place = archive.extractfile(entry), cache / entry.name
        assert content is not None
        place.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(place) as written:
            written.write_bytes(content.read())
        binaries += binary
    return binaries


def _words(versions: Mapping[str, str]) -> str:
    return " and ".join(f"{name} {number}" for name, number in versions.items())


def architecture_names(archs: Set[int]) -> str:
    """Return architectures as the compiler names them, such as sm_90."""
    return ", ".join(f"sm_{arch}" for arch in sorted(archs))
