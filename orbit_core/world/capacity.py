"""Whether as many environments as are asked for can fit into memory, before anything is made."""

from __future__ import annotations

import os
from pathlib import Path

import torch

from orbit_core.interfaces import ConfigurationError, SceneLayout
from orbit_core.scene import CameraSpec, Channel

_PER_BODY = 2048
"""Bytes that an engine takes at least per link or joint of an environment: its state, the core's, and contacts."""
_PER_PARTICLE = 128
"""Bytes of a particle of matter: position, displacement, velocity, what it is held by and what it is near."""
_PER_PIXEL = {
    Channel.RGB: 3,
    Channel.DEPTH: 4,
    Channel.POSITION: 4,  # made from depth
    Channel.NORMALS: 12,
    Channel.ALBEDO: 3,
    Channel.INSTANCE: 4,
    Channel.SEMANTIC: 4,
}
_COPIES = 2  # what the renderer draws into, and what the sensor holds


def check_capacity(layout: SceneLayout, num_envs: int, device: torch.device) -> None:
    """Refuse more environments than can fit; what engines take beyond the least is not known here.

    Raises:
        ConfigurationError: says how many fit, which part is pictures, and how many particles would fit.
    """
    pictures = sum(_picture_bytes(spec) for spec in layout.scene.sensors if isinstance(spec, CameraSpec))
    particles = sum(len(spec.rest_positions) for spec in layout.scene.deformables)
    each = pictures + _PER_BODY * (len(layout.links) + len(layout.joints) + 1) + _PER_PARTICLE * particles
    free = free_bytes(device)
    if num_envs * each > free:
        cameras = f", {_size(num_envs * pictures)} of it for the cameras' pictures" if pictures else ""
        remedy = " or smaller pictures" if pictures else ""
        matter = _PER_PARTICLE * particles
        if matter > 0.5 * each:
            fitting = max(0, free // num_envs - each + matter) // _PER_PARTICLE
            remedy += f", or for coarser meshes: {particles:,} particles in each, of which {fitting:,} fit"
        raise ConfigurationError(
            f"{num_envs} environments take {_size(num_envs * each)} or more{cameras}, and {_size(free)} are free on "
            f"'{device}': at most {free // each} fit; ask for fewer{remedy}"
        )


def free_bytes(device: torch.device) -> int:
    """Memory that is free for a process on a device."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:"))
    except (OSError, StopIteration):  # no Linux
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _picture_bytes(spec: CameraSpec) -> int:
    held = 1 + round(spec.delay * spec.rate) if spec.rate else 1
    return spec.width * spec.height * sum(_PER_PIXEL[channel] for channel in spec.channels) * (_COPIES + held - 1)


def _size(count: float) -> str:
    return f"{count / 2**30:.3g} GiB"
