"""Pictures of any renderer with a matter solver's deformables in them."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from orbit_core.dynamics.indexing import take_rows
from orbit_core.interfaces import Engine, Image, Renderer, SceneLayout
from orbit_core.interfaces.matter import MatterPainter
from orbit_core.plugin_kit.deformable_surface import DeformableSurface
from orbit_core.scene import CameraSpec, Channel

_SERVED = {
    Channel.RGB: "rgb", Channel.DEPTH: "depth", Channel.NORMALS: "normals", Channel.ALBEDO: "albedo",
    Channel.INSTANCE: "links", Channel.SEMANTIC: "links",
}  # fmt: skip


class MatterRenderer(Renderer):
    """Draws with another renderer, depth with it, and paints deformables over what lies behind them."""

    def __init__(self, inner: Renderer, painter: MatterPainter, engine: Engine, layout: SceneLayout) -> None:
        self._inner, self._painter, self._engine = inner, painter, engine
        self._surfaces = [DeformableSurface(spec) for spec in layout.scene.deformables]
        self.capture = inner.capture

    def render(
        self,
        camera: CameraSpec,
        camera_poses: Tensor,
        link_poses: Tensor,
        channels: Sequence[Channel],
        marker_poses: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> Image:
        asked = tuple(dict.fromkeys((*channels, Channel.DEPTH)))
        image = self._inner.render(camera, camera_poses, link_poses, asked, marker_poses, env_ids)
        count = len(camera_poses)
        shown = [
            surface.vertices(take_rows(self._engine.particle_positions(index), env_ids)[:count])
            for index, surface in enumerate(self._surfaces)
        ]
        painted = self._painter.paint(camera, camera_poses, shown, image)
        wanted = {_SERVED[channel] for channel in channels}
        return Image(**{name: getattr(painted, name) for name in wanted})

    def close(self) -> None:
        self._inner.close()
