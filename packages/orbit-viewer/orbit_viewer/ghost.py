"""A robot as a transparent ghost, where it is not."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.scene import Color, RobotSpec
from orbit_viewer.geometry import Drawing

if TYPE_CHECKING:
    from viser import ViserServer

_COLOR: Color = (0.15, 0.5, 0.95, 0.35)


class Ghost:
    """Draws a robot at joint positions of one's choice, by forward kinematics.

    Args:
        server: of viser.
        spec: of the robot.
    """

    def __init__(self, server: ViserServer, spec: RobotSpec) -> None:
        self._server, self._tree = server, KinematicTree(spec.articulation)
        self._links = []
        for index, link in enumerate(spec.articulation.links):
            if shapes := link.visuals or link.collisions:
                drawing = Drawing.of([replace(shape, color=_COLOR) for shape in shapes])
                handle = server.scene.add_glb(f"/ghost/{index}", drawing.glb, visible=False, cast_shadow=False)
                self._links.append((index, handle))

    def place(self, root: Tensor, positions: Tensor) -> None:
        """Show it with its root at a pose (7,) and its joints at positions (J,)."""
        poses = self._tree.forward(root[None].cpu(), positions[None].cpu().to(torch.float32))[0].numpy()
        with self._server.atomic():
            for index, handle in self._links:
                handle.position, handle.wxyz = poses[index, :3], poses[index, 3:]
                handle.visible = True

    def hide(self) -> None:
        """Draw it no more."""
        for _, handle in self._links:
            handle.visible = False
