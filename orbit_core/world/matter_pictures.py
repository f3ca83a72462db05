"""Pictures of any renderer with deformables in them, whoever simulates these."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from orbit_core.backends import matter_names, matter_solver
from orbit_core.dynamics.indexing import take_rows
from orbit_core.installing import install_extra
from orbit_core.interfaces import Engine, Image, Renderer, SceneLayout, UnsupportedCapabilityError
from orbit_core.interfaces.matter import MatterPainter, MatterSolver
from orbit_core.plugin_kit.rendering import DeformableSurface
from orbit_core.scene import CameraSpec, Channel
from orbit_core.world.outer_renderer import OuterRenderer


def with_matter(renderer: Renderer, solver: MatterSolver | None, engine: Engine, layout: SceneLayout) -> Renderer:
    """The renderer, with the scene's deformables painted into its pictures if there are any.

    Their solver paints them; those of the engine's own, without a ``solver``, any that is installed and can.

    Raises:
        UnsupportedCapabilityError: nothing that is installed paints them.
    """
    if not layout.scene.deformables:
        return renderer
    solvers = [solver] if solver is not None else map(matter_solver, matter_names())
    reasons = [f"no matter solver is installed: {install_extra('matter')}"]
    for each in solvers:
        try:
            return MatterRenderer(renderer, each.create_painter(layout, engine.device), engine, layout)
        except UnsupportedCapabilityError as error:
            reasons = [*reasons[1:], str(error)]
    raise UnsupportedCapabilityError(f"pictures of deformables need a matter solver that paints: {'; '.join(reasons)}")


class MatterRenderer(OuterRenderer):
    """Draws with another renderer, depth with it, and paints deformables over what lies behind them."""

    def __init__(self, inner: Renderer, painter: MatterPainter, engine: Engine, layout: SceneLayout) -> None:
        super().__init__(inner)
        self._painter, self._engine = painter, engine
        self._surfaces = [DeformableSurface(spec) for spec in layout.scene.deformables]

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
        return self._painter.paint(camera, camera_poses, shown, image).only(channels)
