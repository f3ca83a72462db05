"""Kernels compiled for a GPU that need not be here, with several modules compiled side by side."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import warp as wp

from orbit_warpkit.start import start

# Of an H100; launches are sized by it, what is compiled is not.
_MULTIPROCESSORS = 132
# Threads in a block on a GPU unless a launch says otherwise.
_BLOCK = 256


class Launches:
    """Modules that are launched, each with the number of threads in a block."""

    def __init__(self) -> None:
        self.found: dict[tuple[Any, int], None] = {}
        """Modules and threads in a block, in the order of the first launches."""
        self.dry = False
        """True while launches are only noted."""
        self._launch, self._launch_tiled = wp.launch, wp.launch_tiled

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        """Note all launches within."""
        wp.launch, wp.launch_tiled = self._noted(self._launch), self._noted(self._launch_tiled)
        try:
            yield
        finally:
            wp.launch, wp.launch_tiled = self._launch, self._launch_tiled

    def _noted(self, launch: Any) -> Any:
        def noted(kernel: Any, *args: Any, **named: Any) -> Any:
            block = named.get("block_dim")
            self.found[kernel.module, _BLOCK if block is None else block] = None
            # A generic kernel has a module for each of its forms, which launching it makes.
            return None if self.dry and not kernel.is_generic else launch(kernel, *args, **named)

        return noted


class _AsGpu:
    """Device that claims to be a GPU."""

    is_cuda, is_cpu, sm_count = True, False, _MULTIPROCESSORS

    def __init__(self, device: Any, arch: int) -> None:
        self._device, self.arch = device, arch

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)


@contextlib.contextmanager
def _as_on_a_gpu(launches: Launches, arch: int) -> Iterator[None]:
    """Let libraries that ask Warp see a GPU, and go through loops on the device once."""
    kept = wp.get_device, wp.capture_while, wp.get_suggested_block_size
    device = _AsGpu(wp.get_device("cpu"), arch)
    wp.get_device = lambda *_: device
    wp.capture_while = lambda condition, while_body, stream=None, **named: while_body(**named)
    wp.get_suggested_block_size = lambda *_: (_BLOCK, _MULTIPROCESSORS)
    launches.dry = True
    try:
        yield
    finally:
        launches.dry = False
        wp.get_device, wp.capture_while, wp.get_suggested_block_size = kept


def compile_modules(launches: Launches, arch: int, threads: int, report: Callable[[str], None]) -> None:
    """Compile what was noted into Warp's cache; what is there already is left.

    Warp generates the source of one module at a time, and NVRTC compiles as many as there are threads.
    """
    begun, count = time.perf_counter(), len(launches.found)
    with ThreadPoolExecutor(threads) as pool:
        compiling = {pool.submit(_compile, module, block, arch): module.name for module, block in launches.found}
        new = 0
        for done, future in enumerate(as_completed(compiling), 1):
            compiled, seconds = future.result()
            new += compiled
            if compiled:
                report(f"{done} of {count}: {compiling[future]} in {seconds:.1f} s")
    report(
        f"sm_{arch}: {new} of {count} modules compiled in {time.perf_counter() - begun:.0f} s, the others were there"
    )


def _compile(module: Any, block: int, arch: int) -> tuple[bool, float]:
    """Return whether a module was not compiled before, and the seconds."""
    begun = time.perf_counter()
    module.get_module_hash(block)
    folder = Path(wp.config.kernel_cache_dir or "") / module.get_module_identifier(block)
    new = module._compile(None, str(folder), output_arch=arch, use_ptx=False, options=module.resolved_options[block])
    return new, time.perf_counter() - begun


class WarpKernels:
    """Compiler of the kernels that this backend launches, for ``orbit cache``.

    Compiling without a driver leaves Warp in a state that it cannot clean up: let the process end by ``os._exit``.
    """

    backend = "warp"
    """Name of the backend."""
    packages = ("warp-lang", "mujoco-warp")
    """Distributions whose versions enter the names of compiled modules: those of others are not found."""

    def __init__(self) -> None:
        start()
        self.cache = Path(wp.config.kernel_cache_dir or "")
        """Folder of compiled modules."""
        self.architectures = tuple(wp.get_cuda_supported_archs())
        """Compute capabilities that can be compiled for, such as 90."""
        self.gpus = frozenset(device.arch for device in wp.get_cuda_devices())
        """Compute capabilities of this machine's GPUs."""
        self._launches = Launches()

    def watching(self) -> contextlib.AbstractContextManager[None]:
        """Note the kernels that environments launch on a CPU within this context."""
        return self._launches.watching()

    def rehearse(self, engine: Any, arch: int) -> None:
        """Go through a physics step as on a GPU, without launching anything, and note its kernels.

        Args:
            engine: of an environment on a CPU that was stepped.
            arch: compute capability.
        """
        with _as_on_a_gpu(self._launches, arch):
            # Under the engine that adds matter's wrenches, if there is any.
            getattr(engine, "_inner", engine)._advance(1.0)

    def compile(self, arch: int, threads: int, report: Callable[[str], None]) -> None:
        """Compile the kernels that were noted, ``threads`` modules at a time, and report each in a line."""
        compile_modules(self._launches, arch, threads, report)
