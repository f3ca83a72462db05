"""The machine and the versions with which a run was made."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from pathlib import Path

import torch

from orbit_core import __version__


@dataclass(frozen=True)
class Hardware:
    """The processor, cores and memory of a machine."""

    processor: str
    """Model of the processor."""
    cores: int
    """The number of cores that this process may use."""
    memory_gib: float
    """GiB of memory."""
    gpus: tuple[str, ...]
    """Models of the GPUs."""
    system: str
    """Operating system and its version."""

    @staticmethod
    def here() -> Hardware:
        """The machine on which this process runs."""
        gpus = tuple(torch.cuda.get_device_name(index) for index in range(torch.cuda.device_count()))
        return Hardware(_processor(), cores(), round(_memory(), 1), gpus, platform.platform(terse=True))

    @property
    def label(self) -> str:
        """Processor and number of cores, in words."""
        return f"{self.processor}, {self.cores} core{'s' if self.cores > 1 else ''}"


def device_label(device: torch.device) -> str:
    """Return the name of the GPU, or of the processor with its number of cores."""
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    return Hardware.here().label


def versions() -> dict[str, str]:
    """Return versions of the software that all backends share; each backend reports its own."""
    return {"orbit": __version__, "python": platform.python_version(), "torch": str(torch.__version__)}


def cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _processor() -> str:
    """Return the processor's trade name where the system has it."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text().splitlines() if information.exists() else []
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def _memory() -> float:
    """Return the memory in GiB; 0 where it is unknown."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    except (AttributeError, ValueError, OSError):
        return 0.0
