"""Compiles what environments launch for a GPU that is not there, so that it need not be compiled where it is.

    python plugins/orbit-warp/benchmarks/gpu/precompile.py Velocity-Rough:unitree_go2 Stack --arch 90

Each task is made on the CPU and stepped twice; then a physics step is gone through once more as on a GPU, without
launching anything. What was launched is compiled for that architecture (NVRTC needs no GPU) into Warp's cache, or
``--output``: copy that to the other machine's cache of the same version of Warp. What this misses is compiled there.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import torch
import warp as wp

from orbit_core.envs import make

MULTIPROCESSORS = 132
"""Of an H100; launches are sized by it, not what is compiled."""

BLOCK = 256
"""Threads in a block on a GPU unless a launch says otherwise."""


class Launches:
    """Takes note of each kernel's module and the number of threads in a block with which it is launched."""

    def __init__(self) -> None:
        self.found: dict[tuple[Any, int], None] = {}
        self.dry = False
        """Whether nothing is launched."""
        self._launch, self._launch_tiled = wp.launch, wp.launch_tiled

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        wp.launch, wp.launch_tiled = self._noted(self._launch), self._noted(self._launch_tiled)
        try:
            yield
        finally:
            wp.launch, wp.launch_tiled = self._launch, self._launch_tiled

    def _noted(self, launch: Any) -> Any:
        def noted(kernel: Any, *args: Any, **named: Any) -> Any:
            block = named.get("block_dim")
            self.found[kernel.module, BLOCK if block is None else block] = None
            return None if self.dry and not kernel.is_generic else launch(kernel, *args, **named)

        return noted


class AsGpu:
    """A device that says that it is a GPU."""

    is_cuda, is_cpu, sm_count = True, False, MULTIPROCESSORS

    def __init__(self, device: Any, arch: int) -> None:
        self._device, self.arch = device, arch

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)


@contextlib.contextmanager
def as_on_a_gpu(launches: Launches, arch: int) -> Iterator[None]:
    """Libraries that ask Warp see a GPU, and loops on the device are gone through once."""
    kept = wp.get_device, wp.capture_while, wp.get_suggested_block_size
    device = AsGpu(wp.get_device("cpu"), arch)
    wp.get_device = lambda *_: device
    wp.capture_while = lambda condition, while_body, stream=None, **named: while_body(**named)
    wp.get_suggested_block_size = lambda *_: (256, MULTIPROCESSORS)
    launches.dry = True
    try:
        yield
    finally:
        launches.dry = False
        wp.get_device, wp.capture_while, wp.get_suggested_block_size = kept


def note(task: str, launches: Launches, arch: int) -> None:
    """Go through all that a task's environments launch."""
    name, _, robot = task.partition(":")
    with launches.watching():
        environment = make(name, num_envs=2, backend="warp", **({"robot": robot} if robot else {}))
        for _ in range(2):
            environment.step(torch.zeros(2, environment.action_size))
        environment.reset(env_ids=torch.tensor([0]))
        with as_on_a_gpu(launches, arch):
            engine = environment.world.engine
            # Under the engine that adds matter's wrenches, if there is any.
            getattr(engine, "_inner", engine)._advance(1.0)
        environment.close()


def compile_for(module: Any, block: int, arch: int) -> tuple[bool, float]:
    """Compile one module for blocks of that many threads; whether it was not compiled before, and seconds."""
    begun = time.perf_counter()
    module.get_module_hash(block)
    folder = os.path.join(wp.config.kernel_cache_dir, module.get_module_identifier(block))
    new = module._compile(None, folder, output_arch=arch, use_ptx=False, options=module.resolved_options[block])
    return new, time.perf_counter() - begun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="+", help="TASK or TASK:ROBOT")
    parser.add_argument("--arch", type=int, default=90, help="compute capability, such as 90 for an H100 or H200")
    parser.add_argument("--output", type=Path, help="cache that is written; Warp's own if left out")
    parser.add_argument("--threads", type=int, default=1, help="that compile side by side")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    launches = Launches()
    for task in arguments.tasks:
        note(task, launches, arguments.arch)
        print(f"{task}: {len(launches.found)} modules so far", flush=True)
    if arguments.output:
        wp.config.kernel_cache_dir = str(arguments.output.resolve())
    with ThreadPoolExecutor(arguments.threads) as pool:
        compiling = [
            (module, block, pool.submit(compile_for, module, block, arguments.arch)) for module, block in launches.found
        ]
        results = [(f"{module.name}, blocks of {block}", *future.result()) for module, block, future in compiling]
    for name, new, taken in sorted(results, key=lambda result: -result[2])[:10]:
        print(f"{taken:6.1f} s {'compiled' if new else 'was there'} {name}")
    print(f"{sum(new for _, new, _ in results)} of {len(results)} compiled, {sum(r[2] for r in results):.0f} s in all")
    sys.stdout.flush()
    os._exit(0)  # compiling without a driver leaves Warp in a state that it cannot clean up


if __name__ == "__main__":
    main()
