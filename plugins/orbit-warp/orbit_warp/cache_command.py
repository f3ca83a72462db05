"""``orbit cache``: kernels compiled ahead of time, and carried to other machines."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
import tarfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import warp as wp
from tyro.conf import Positional, arg

from orbit_core.cli.output import console, new_table
from orbit_core.cli.settings import check_output, check_positive, parse_words
from orbit_core.envs.registry import task_entry
from orbit_core.files import written_whole
from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError
from orbit_warpkit.start import start

FORMAT = 1
_MANIFEST = "manifest.json"
# Distributions whose versions enter the names of compiled modules: with others, nothing of an archive would be found.
_VERSIONED = ("warp-lang", "mujoco-warp")
# A module's folder, and its compiled form for one architecture or the description that goes with it.
_BINARY = re.compile(r"(?P<folder>wp_\w+)/(?P<file>wp_\w+)\.sm(?P<arch>\d+)a?\.cubin")
_META = re.compile(r"wp_\w+/wp_\w+\.meta")
# Limits of what an archive may unpack to; all tasks together take some 50 MB for an architecture.
_MOST_BYTES, _MOST_FILES = 1 << 30, 20_000


@dataclass(frozen=True, kw_only=True)
class BuildSettings:
    """Compile the kernels of tasks for a GPU, which need not be in this machine, into Warp's cache."""

    tasks: Annotated[Positional[tuple[str, ...]], arg(metavar="TASK")]
    """Tasks, or TASK:ROBOT."""
    arch: int | None = None
    """Compute capability, such as 90 for an H100 or H200; this machine's GPU if left out."""
    threads: int | None = None
    """Modules compiled at a time; the number of cores if left out."""


@dataclass(frozen=True, kw_only=True)
class ExportSettings:
    """Pack the kernels of Warp's cache into a file for other machines."""

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """Archive to write, .tar.xz."""
    arch: int | None = None
    """Compute capability; all that the cache holds if left out."""
    overwrite: bool = False
    """Replace a file of that name that is there already."""


@dataclass(frozen=True, kw_only=True)
class ImportSettings:
    """Unpack kernels of 'orbit cache export' into Warp's cache. They run on the GPU: take archives that you trust."""

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """Archive to read."""


@dataclass(frozen=True, kw_only=True)
class ShowSettings:
    """Show what Warp's cache holds for each architecture."""


def main(words: Sequence[str]) -> None:
    """Run a command of ``orbit cache``.

    Raises:
        UnknownNameError: the command does not exist.
    """
    if not words or words[0] in ("-h", "--help"):
        listed = "\n".join(
            f"  {name:<8} {(kind.__doc__ or '').splitlines()[0]}" for name, (_, kind) in _COMMANDS.items()
        )
        print(f"usage: orbit cache COMMAND ...\n\n{listed}\n\n'orbit cache COMMAND --help' describes its options.")
        return
    if words[0] not in _COMMANDS:
        raise UnknownNameError("command of orbit cache", words[0], _COMMANDS)
    run, kind = _COMMANDS[words[0]]
    settings = parse_words(kind, words[1:], f"orbit cache {words[0]}")
    start()
    run(settings)


def _build(settings: BuildSettings) -> None:
    if not settings.tasks:
        raise ConfigurationError("name the tasks whose kernels are compiled, such as: orbit cache build Lift --arch 90")
    for task in settings.tasks:
        task_entry(task.partition(":")[0])
    threads = settings.threads or os.cpu_count() or 1
    check_positive("threads", threads)
    arch = _checked_arch(settings.arch)
    command = [sys.executable, "-m", "orbit_warp.ahead", str(arch), str(threads), *settings.tasks]
    if subprocess.run(command, check=False).returncode:
        raise ConfigurationError(f"compiling for sm_{arch} failed; the lines above say why")


def _export(settings: ExportSettings) -> None:
    check_output(settings.file, ".xz", settings.overwrite)
    found = compiled_modules(Path(wp.config.kernel_cache_dir or ""), settings.arch)
    if not found:
        wanted = "" if settings.arch is None else f" for sm_{settings.arch}"
        remedy = f"orbit cache build TASK --arch {settings.arch or 90}"
        raise ConfigurationError(f"{wp.config.kernel_cache_dir} holds no kernels{wanted}: {remedy}")
    write_archive(settings.file, found)
    size = settings.file.stat().st_size / 1e6
    console().print(f"{settings.file}: {len(found)} modules for {_names({m.arch for m in found})}, {size:.1f} MB")


def _import(settings: ImportSettings) -> None:
    gpus = {device.arch for device in wp.get_cuda_devices()}
    count, archs = read_archive(settings.file, Path(wp.config.kernel_cache_dir or ""), gpus)
    console().print(f"{count} modules for {_names(archs)} are in {wp.config.kernel_cache_dir}")


def _show(settings: ShowSettings) -> None:
    table = new_table("architecture", "modules", "MB", title=str(wp.config.kernel_cache_dir))
    found = compiled_modules(Path(wp.config.kernel_cache_dir or ""))
    for arch in sorted({module.arch for module in found}):
        own = [module for module in found if module.arch == arch]
        size = sum(module.binary.stat().st_size for module in own) / 1e6
        table.add_row(f"sm_{arch}", str(len(own)), f"{size:.1f}")
    console().print(table)


_COMMANDS: dict[str, tuple[Any, type[Any]]] = {
    "build": (_build, BuildSettings),
    "export": (_export, ExportSettings),
    "import": (_import, ImportSettings),
    "show": (_show, ShowSettings),
}


def _checked_arch(arch: int | None) -> int:
    supported = wp.get_cuda_supported_archs()
    if arch is None:
        gpus = wp.get_cuda_devices()
        if not gpus:
            raise ConfigurationError("this machine has no GPU to compile for: name an architecture, such as --arch 90")
        arch = gpus[0].arch
    if arch not in supported:
        raise ConfigurationError(f"arch is {arch}: this Warp compiles for {', '.join(map(str, supported))}")
    return arch


# Archives of compiled modules ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CompiledModule:
    """Module of kernels, compiled for one architecture."""

    arch: int
    """Compute capability, such as 90."""
    binary: Path
    """Compiled code."""
    meta: Path
    """Description that Warp reads with it."""


def compiled_modules(cache: Path, arch: int | None = None) -> list[CompiledModule]:
    """Return the modules in a cache that are compiled for a GPU.

    Args:
        cache: Warp's cache of one version.
        arch: compute capability; any if None.
    """
    found: list[CompiledModule] = []
    for path in sorted(cache.glob("wp_*/*.cubin")):
        match = _BINARY.fullmatch(f"{path.parent.name}/{path.name}")
        meta = path.parent / f"{path.parent.name}.meta"
        if match and meta.exists() and arch in (None, int(match["arch"])):
            found.append(CompiledModule(int(match["arch"]), path, meta))
    return found


def write_archive(path: Path, modules: Sequence[CompiledModule]) -> None:
    """Write modules, with the versions and architectures that they fit, as .tar.xz."""
    manifest = {"kernels": FORMAT, "versions": _versions(), "architectures": sorted({m.arch for m in modules})}
    with written_whole(path) as written, tarfile.open(written, "w:xz") as archive:
        content = json.dumps(manifest).encode()
        entry = tarfile.TarInfo(_MANIFEST)
        entry.size = len(content)
        archive.addfile(entry, io.BytesIO(content))
        for file in dict.fromkeys(file for module in modules for file in (module.meta, module.binary)):
            archive.add(file, f"{file.parent.name}/{file.name}")


def read_archive(path: Path, cache: Path, gpus: set[int]) -> tuple[int, set[int]]:
    """Unpack an archive into a cache, and return the number of modules and their architectures.

    Args:
        path: archive of :func:`write_archive`.
        cache: Warp's cache.
        gpus: compute capabilities of this machine's GPUs; with none, kernels of any are taken, for another machine.

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
            archs = _checked_manifest(path, json.loads(content.read(1 << 16)), gpus)
            return _unpack(path, archive, entries, cache), archs
    except (OSError, EOFError, tarfile.TarError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{path} is no archive of 'orbit cache export' ({error})") from None


def _checked_manifest(path: Path, manifest: dict[str, Any], gpus: set[int]) -> set[int]:
    """Return the architectures of an archive that fits this machine."""
    if manifest["kernels"] != FORMAT:
        raise ConfigurationError(f"{path} has format {manifest['kernels']}, and {FORMAT} is read: export it again")
    theirs, ours = {name: str(manifest["versions"][name]) for name in _VERSIONED}, _versions()
    if theirs != ours:
        raise ConfigurationError(
            f"{path} holds kernels of {_words(theirs)}, which {_words(ours)} would not find: build them with the "
            "versions that are installed here"
        )
    archs = {int(arch) for arch in manifest["architectures"]}
    if missing := gpus - archs:
        raise ConfigurationError(
            f"{path} holds kernels for {_names(archs)}, and this machine's GPU is {_names(missing)}: "
            f"orbit cache build TASK --arch {min(missing)}"
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


def _versions() -> dict[str, str]:
    return {name: version(name) for name in _VERSIONED}


def _words(versions: dict[str, str]) -> str:
    return " and ".join(f"{name} {number}" for name, number in versions.items())


def _names(archs: set[int]) -> str:
    return ", ".join(f"sm_{arch}" for arch in sorted(archs))
