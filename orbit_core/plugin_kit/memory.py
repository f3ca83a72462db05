"""Memory of a device, and the refusal of more environments than fit."""

from __future__ import annotations

import os
from pathlib import Path

import torch

from orbit_core.interfaces import ConfigurationError


def check_memory(num_envs: int, each: int, device: torch.device, remedy: str) -> None:
    """Refuse more environments than fit into the memory that is free.

    Args:
        num_envs: number of environments.
        each: bytes that an engine makes arrays of for one environment.
        device: of the arrays.
        remedy: continuation of "ask for fewer", for the message.

    Raises:
        ConfigurationError: says how many fit.
    """
    if num_envs * each > (free := free_bytes(device)):
        raise ConfigurationError(
            f"the engine's arrays for {num_envs} environments take {size_label(num_envs * each)}, and "
            f"{size_label(free)} are free on '{device}': at most {free // each} fit; ask for fewer{remedy}"
        )


def free_bytes(device: torch.device) -> int:
    """Return the bytes that are free for a process on a device."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:"))
    except (OSError, StopIteration):  # no Linux
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def size_label(count: float) -> str:
    """Return a number of bytes for a message, in GiB."""
    return f"{count / 2**30:.3g} GiB"
