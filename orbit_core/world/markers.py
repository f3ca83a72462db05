"""Markers of a simulated world."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import RowSelector, write_rows
from orbit_core.interfaces import Marker
from orbit_core.scene import MarkerSpec


class SimulatedMarker(Marker):
    """A pose (N, 7) that viewers and videos draw."""

    def __init__(self, spec: MarkerSpec, poses: Tensor, selector: RowSelector) -> None:
        self.spec = spec
        self._poses = poses
        self._selector = selector

    @property
    def pose(self) -> Tensor:
        return self._poses

    def set_pose(self, pose: Tensor, env_ids: Tensor | None = None) -> None:
        chosen = self._selector.select(env_ids)
        write_rows(self._poses, chosen.poses(pose, f"pose of marker '{self.spec.name}'"), chosen.rows)


def identity_poses(num_envs: int, markers: int, device: torch.device) -> Tensor:
    """(N, M, 7) at each environment's origin."""
    poses = torch.zeros(num_envs, markers, 7, device=device)
    poses[..., 3] = 1.0
    return poses
