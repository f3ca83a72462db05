"""Arrays of single precision in memory that several processes map."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]
Shapes = Mapping[str, tuple[int, ...]]
"""Shape of each array by name."""

SHARED_FOLDER = Path("/dev/shm") if Path("/dev/shm").is_dir() else None
"""Folder in memory where the system has one: a file on a disk would be written back again and again."""


def shared_arrays(shapes: Shapes, path: Path) -> dict[str, FloatArray]:
    """Map a file as arrays, and create it where it does not exist.

    The file may be removed as soon as every process has mapped it; the last of them frees its memory.

    Args:
        shapes: of the arrays, in the order in which they lie in the file.
        path: of the file, zeros where it is new.

    Returns:
        The arrays by name, which all processes read and write.
    """
    size = sum(int(np.prod(shape)) for shape in shapes.values())
    # A mapping of length zero is an error, and a scene may have nothing to share.
    block = np.memmap(path, dtype=np.float32, mode="r+" if path.exists() else "w+", shape=(max(size, 1),))
    arrays, start = {}, 0
    for name, shape in shapes.items():
        stop = start + int(np.prod(shape))
        arrays[name] = np.asarray(block[start:stop]).reshape(shape)
        start = stop
    return arrays
