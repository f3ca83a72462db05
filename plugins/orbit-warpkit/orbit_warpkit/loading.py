"""Loading kernels before they are needed, and saying so where they are compiled first, which takes many seconds."""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import warp as wp


def load_kernels(what: str, modules: Sequence[ModuleType], device: wp.Device) -> None:
    """Load the kernels of some modules for a device, from Warp's cache or by compiling them.

    Args:
        what: whose kernels they are, for the lines on standard error that report what is compiled and how long it took.
        modules: that define kernels.
        device: on which they will run, in Warp's own blocks: of 256 threads on a GPU, of one on a CPU.
    """
    block = 1 if device.is_cpu else 256
    new = [module for module in modules if not _is_cached(module, block)]
    for module in modules:
        # Cached modules load in milliseconds, so that only compilation is worth a line.
        if module not in new:
            wp.load_module(module, device=device, block_dim=block)
            continue
        name, begin = module.__name__, time.perf_counter()
        tell(f"{what}: compiling kernels, once on this machine: {name} ({new.index(module) + 1} of {len(new)}) ... ")
        wp.load_module(module, device=device, block_dim=block)
        tell(f"{time.perf_counter() - begin:.0f} s\n")


def _is_cached(module: ModuleType, block: int) -> bool:
    """Return True if Warp's cache holds the current module for blocks of that many threads."""
    # Warp names the cache's folder by a hash of the module's source and options: a changed kernel counts as new.
    folder = wp.get_module(module.__name__).get_module_identifier(block)
    return Path(wp.config.kernel_cache_dir or "", folder).is_dir()


def tell(words: str) -> None:
    """Write to standard error at once: what takes long, and how far it is."""
    sys.stderr.write(words)
    sys.stderr.flush()
