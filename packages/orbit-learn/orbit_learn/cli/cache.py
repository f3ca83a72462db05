"""``orbit cache``: kernels compiled ahead of time, and carried to other machines."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from orbit_core.cli.output import console, new_table
from orbit_core.cli.settings import check_output, check_positive, parse_words
from orbit_core.envs.registry import task_entry
from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError
from orbit_learn.kernels.archives import architecture_names, compiled_modules, read_archive, write_archive
from orbit_learn.kernels.compilers import KernelCompiler, compiler_of, kernel_compilers


@dataclass(frozen=True, kw_only=True)
class CacheSettings:
    """Settings of all commands."""

    backend: Annotated[str | None, arg(metavar="NAME")] = None
    """Backend whose kernels they are; may be left out if only one is installed that compiles any."""


@dataclass(frozen=True, kw_only=True)
class BuildSettings(CacheSettings):
    """Compile the kernels of tasks for a GPU, which need not be in this machine, into its cache."""

    tasks: Annotated[Positional[tuple[str, ...]], arg(metavar="TASK")]
    """Tasks, or TASK:ROBOT."""
    arch: int | None = None
    """Compute capability, such as 90 for an H100 or H200; this machine's GPU if left out."""
    threads: int | None = None
    """Modules compiled at a time; the number of cores if left out."""


@dataclass(frozen=True, kw_only=True)
class ExportSettings(CacheSettings):
    """Pack the kernels of the cache into a file for other machines."""

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """Archive to write, .tar.xz."""
    arch: int | None = None
    """Compute capability; all that the cache holds if left out."""
    overwrite: bool = False
    """Replace a file of that name that is there already."""


@dataclass(frozen=True, kw_only=True)
class ImportSettings(CacheSettings):
    """Unpack kernels of 'orbit cache export' into its cache. They run on the GPU: take archives that you trust."""

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """Archive to read."""


@dataclass(frozen=True, kw_only=True)
class ShowSettings(CacheSettings):
    """Show what the cache holds for each architecture."""


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
    run(settings)


def _compiler(settings: CacheSettings) -> KernelCompiler:
    return kernel_compilers().get(compiler_of(settings.backend))()


def _versions(compiler: KernelCompiler) -> dict[str, str]:
    return {name: version(name) for name in compiler.packages}


def _build(settings: BuildSettings) -> None:
    if not settings.tasks:
        raise ConfigurationError("name the tasks whose kernels are compiled, such as: orbit cache build Lift --arch 90")
    for task in settings.tasks:
        task_entry(task.partition(":")[0])
    threads = settings.threads or os.cpu_count() or 1
    check_positive("threads", threads)
    arch = _checked_arch(settings.arch, _compiler(settings))
    words = (compiler_of(settings.backend), str(arch), str(threads), *settings.tasks)
    # A process of its own, because a compiler without a driver may not be able to clean up.
    command = [sys.executable, "-m", "orbit_learn.kernels.ahead", *words]
    if subprocess.run(command, check=False).returncode:
        raise ConfigurationError(f"compiling for sm_{arch} failed; the lines above say why")


def _export(settings: ExportSettings) -> None:
    check_output(settings.file, ".xz", settings.overwrite)
    compiler = _compiler(settings)
    found = compiled_modules(compiler.cache, settings.arch)
    if not found:
        wanted = "" if settings.arch is None else f" for sm_{settings.arch}"
        remedy = f"orbit cache build TASK --arch {settings.arch or 90}"
        raise ConfigurationError(f"{compiler.cache} holds no kernels{wanted}: {remedy}")
    write_archive(settings.file, found, _versions(compiler))
    size = settings.file.stat().st_size / 1e6
    console().print(
        f"{settings.file}: {len(found)} modules for {architecture_names({m.arch for m in found})}, {size:.1f} MB"
    )


def _import(settings: ImportSettings) -> None:
    compiler = _compiler(settings)
    count, archs = read_archive(settings.file, compiler.cache, compiler.gpus, _versions(compiler))
    console().print(f"{count} modules for {architecture_names(archs)} are in {compiler.cache}")


def _show(settings: ShowSettings) -> None:
    cache = _compiler(settings).cache
    table, found = new_table("architecture", "modules", "MB", title=str(cache)), compiled_modules(cache)
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


def _checked_arch(arch: int | None, compiler: KernelCompiler) -> int:
    if arch is None:
        if not compiler.gpus:
            raise ConfigurationError("this machine has no GPU to compile for: name an architecture, such as --arch 90")
        arch = min(compiler.gpus)
    if arch not in compiler.architectures:
        known = ", ".join(map(str, compiler.architectures))
        raise ConfigurationError(f"arch is {arch}: kernels of {compiler.backend} are compiled for {known}")
    return arch
