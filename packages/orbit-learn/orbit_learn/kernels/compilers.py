"""Compilers of backends' kernels. Plugins add theirs by the entry-point group ``orbit.kernels``."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path
from typing import Any, Protocol

from orbit_core.interfaces import ConfigurationError
from orbit_core.registry import Registry


class KernelCompiler(Protocol):
    """Compiler of the kernels that environments of a backend launch on a GPU."""

    backend: str
    """Name of the backend."""
    packages: tuple[str, ...]
    """Distributions whose versions decide whether a compiled module is found."""
    cache: Path
    """Folder of compiled modules: NAME/NAME.smARCH.cubin, each with NAME/NAME.meta."""
    architectures: tuple[int, ...]
    """Compute capabilities that can be compiled for, such as 90."""
    gpus: frozenset[int]
    """Compute capabilities of this machine's GPUs."""

    def watching(self) -> AbstractContextManager[None]:
        """Note the kernels that environments launch on a CPU within this context."""
        ...

    def rehearse(self, engine: Any, arch: int) -> None:
        """Note the kernels of a physics step on a GPU, without launching them."""
        ...

    def compile(self, arch: int, threads: int, report: Callable[[str], None]) -> None:
        """Compile the kernels that were noted, ``threads`` modules at a time, and report each in a line."""
        ...


@cache
def kernel_compilers() -> Registry[Callable[[], KernelCompiler]]:
    """Return all compilers by name."""
    return Registry["Callable[[], KernelCompiler]"]("compiler of kernels", "orbit.kernels")


def compiler_of(name: str | None) -> str:
    """Return the name of a compiler; the only one that is installed if none is given.

    Raises:
        ConfigurationError: none is installed, or several are and none was named.
    """
    names = kernel_compilers().names
    if name is None and len(names) != 1:
        known = f"name one of {', '.join(names)} by --backend" if names else "install a backend that runs on a GPU"
        raise ConfigurationError(f"{len(names)} installed backends compile kernels: {known}")
    return names[0] if name is None else name
