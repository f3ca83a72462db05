"""What a camera measures, as colours for the eye."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.scene import Channel

Picture = npt.NDArray[np.uint8]


def picture_of(channel: Channel, image: Tensor) -> Picture:
    """(H, W, 3) of one camera's (H, W, channels).

    Depth runs from near, bright, to far, dark; normals and positions show x, y, z as red, green, blue; every
    index of a segmentation
    has a colour of its own.
    """
    match channel:
        case Channel.RGB | Channel.ALBEDO:
            return image.cpu().numpy()
        case Channel.DEPTH:
            return _depth(image).cpu().numpy()
        case Channel.POSITION:
            return _position(image).cpu().numpy()
        case Channel.NORMALS:
            return ((image + 1.0) * 127.5).to(torch.uint8).cpu().numpy()
        case Channel.INSTANCE | Channel.SEMANTIC:
            return _indices(image[..., 0].cpu().numpy())


def _depth(depth: Tensor) -> Tensor:
    seen = torch.isfinite(depth)
    if not bool(seen.any()):
        return torch.zeros(*depth.shape[:2], 3, dtype=torch.uint8)
    near, far = depth[seen].min(), depth[seen].max()
    brightness = 230.0 - 200.0 * (depth - near) / (far - near).clamp_min(1e-6)
    return torch.where(seen, brightness, 0.0).to(torch.uint8).expand(-1, -1, 3)


def _position(position: Tensor) -> Tensor:
    """Colours repeat every metre."""
    seen = torch.isfinite(position)
    return torch.where(seen, 255.0 * (torch.where(seen, position, 0.0) % 1.0), 0.0).to(torch.uint8)


def _indices(indices: npt.NDArray[np.integer]) -> Picture:
    # Hues a golden angle apart are all well apart, however many there are.
    hue = (indices * 0.381966) % 1.0
    channels = [np.abs((hue * 6.0 - shift) % 6.0 - 3.0) - 1.0 for shift in (0.0, 2.0, 4.0)]
    colors = 60.0 + 180.0 * np.clip(np.stack(channels, axis=-1), 0.0, 1.0)
    return np.where(indices[..., None] < 0, 30.0, colors).astype(np.uint8)
