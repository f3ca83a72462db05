"""Poses from tensors to NumPy, and pictures back, for renderers that draw on the host."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor


def pose_array(poses: Tensor) -> npt.NDArray[np.float64]:
    """Poses (..., 7) in double precision on the host; waits for the device."""
    return poses.detach().cpu().numpy().astype(np.float64)


def image_tensor(array: npt.NDArray[Any] | None, device: torch.device) -> Tensor | None:
    """A channel's pictures on the device of the poses that they were drawn from; None for a channel not drawn."""
    return None if array is None else torch.from_numpy(np.ascontiguousarray(array)).to(device)
