"""MuJoCo-Warp's own objects, which the engine's parts share."""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import mujoco_warp as mjw


@dataclass(frozen=True)
class Native:
    """MuJoCo-Warp's own objects."""

    host_model: mujoco.MjModel
    """MuJoCo's model on the host."""
    model: mjw.Model
    """Its copy on the device, with rows where parameters are randomised."""
    data: mjw.Data
    """State of all environments."""
