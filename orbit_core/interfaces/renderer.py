"""Images of a scene from poses alone, so that any plugin may draw what any other simulates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from orbit_core.scene import CameraSpec, Channel


@dataclass(frozen=True)
class Image:
    """What one camera saw in n environments; a channel not asked for is None."""

    rgb: Tensor | None = None
    """(n, H, W, 3) uint8"""
    depth: Tensor | None = None
    """(n, H, W, 1) float32 metres along the optical axis; infinite beyond everything."""
    normals: Tensor | None = None
    """(n, H, W, 3) float32 in world axes; zero beyond everything."""
    links: Tensor | None = None
    """(n, H, W, 1) int32 link index, TERRAIN or BACKGROUND."""


class Renderer(ABC):
    """Draws visual shapes (collision shapes where a link has none), terrain and markers."""

    @abstractmethod
    def render(
        self,
        camera: CameraSpec,
        camera_poses: Tensor,
        link_poses: Tensor,
        channels: Sequence[Channel],
        marker_poses: Tensor | None = None,
    ) -> Image:
        """One picture per environment.

        Args:
            camera: one of the cameras that the renderer was made with.
            camera_poses: (n, 7) in each environment's frame, -z forward, y up.
            link_poses: (n, L, 7) of every link of the scene.
            channels: what to draw.
            marker_poses: (n, M, 7) of the scene's markers; None draws none.
        """

    def close(self) -> None:
        """Free what the renderer holds; idempotent."""
