"""Images of a scene from poses alone, so that any plugin may draw what any other simulates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from torch import Tensor

from orbit_core.interfaces.capture import Traceable, measures
from orbit_core.interfaces.layout import TERRAIN, SceneLayout
from orbit_core.scene import CameraSpec, Channel, Shape


@dataclass(frozen=True)
class Image:
    """Pictures of one camera in n environments; a channel that was not requested is None."""

    rgb: Tensor | None = None
    """(n, H, W, 3) uint8"""
    depth: Tensor | None = None
    """(n, H, W, 1) float32 metres along the optical axis; infinite beyond everything."""
    normals: Tensor | None = None
    """(n, H, W, 3) float32 in world axes; zero beyond everything."""
    links: Tensor | None = None
    """(n, H, W, 1) int32 link index, TERRAIN or BACKGROUND."""
    albedo: Tensor | None = None
    """(n, H, W, 3) uint8: the shapes' own colours, unlit; black beyond everything."""

    def only(self, channels: Sequence[Channel]) -> Image:
        """Return a copy that holds only the fields which serve these channels."""
        return Image(**{name: getattr(self, name) for name in {_FIELDS[channel] for channel in channels}})


# Of an image, by the channel that it serves
_FIELDS = {
    Channel.RGB: "rgb", Channel.DEPTH: "depth", Channel.NORMALS: "normals", Channel.ALBEDO: "albedo",
    Channel.INSTANCE: "links", Channel.SEMANTIC: "links",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class LightTable:
    """Lights of N environments in the place of the scene's own, of which there are as many directional ones."""

    ambient: Tensor
    """(N, 3) sum of all light from around."""
    directions: Tensor
    """(N, K, 3) unit vectors along which the K directional lights travel, in the scene's order."""
    radiance: Tensor
    """(N, K, 3) intensity times colour of each; zero switches a light off."""

    def rows(self, env_ids: Tensor) -> LightTable:
        """Return the lights of some environments (n,)."""
        return LightTable(self.ambient[env_ids], self.directions[env_ids], self.radiance[env_ids])


class Renderer(Traceable, ABC):
    """Draws visual shapes (collision shapes where a link has none), terrain and markers."""

    # None costs nothing; a table of all links would be looked up for every pixel.
    link_colors: Tensor | None = None
    """(N, L, 4) each link's red, green and blue in [0, 1] in each environment, in the place of its shapes' own where
    the fourth number is above zero; None: all have their own. Opacity is the shapes' own. Its owner writes in place."""

    def set_link_colors(self, colors: Tensor | None) -> None:
        """Take :attr:`link_colors` from now on."""
        self.link_colors = colors

    most_samples: int | None = None
    """Pictures that a studio averages at most, where one takes long; None: as many as it asks for."""
    lights: LightTable | None = None
    """Lights of each environment; None: all have the scene's. Its owner writes in place."""

    def set_lights(self, lights: LightTable | None) -> None:
        """Take :attr:`lights` from now on."""
        self.lights = lights

    @abstractmethod
    @measures("camera_poses", "link_poses", "marker_poses")
    def render(
        self,
        camera: CameraSpec,
        camera_poses: Tensor,
        link_poses: Tensor,
        channels: Sequence[Channel],
        marker_poses: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> Image:
        """Render one picture per environment.

        Args:
            camera: one of the cameras that the renderer was made with.
            camera_poses: (n, 7) in each environment's frame, -z forward, y up.
            link_poses: (n, L, 7) of every link of the scene.
            channels: what to draw. POSITION is not among them: the camera sensor has it from depth.
            marker_poses: (n, M, 7) of the scene's markers; None draws none.
            env_ids: (n,) which environments these are, for objects differ between them where the scene has variants;
                None means the first n. A renderer whose ``capture`` takes masks for this method also takes one
                (N,) bool, with poses of all environments; pictures outside of the mask may hold anything.
        """

    def close(self) -> None:
        """Free the renderer's resources; idempotent."""


def drawn_shapes(layout: SceneLayout) -> list[tuple[Shape, int]]:
    """Return all shapes that a picture shows, markers excepted, each with its link's index or TERRAIN."""
    terrain = [(shape, TERRAIN) for shape in layout.scene.terrain]
    return terrain + [(shape, n) for n, link in enumerate(layout.links) for shape in link.visuals or link.collisions]


def albedo_table(layout: SceneLayout) -> npt.NDArray[np.uint8]:
    """Return the colours (1 + shapes, 3) of nothing, which is black, and of each of :func:`drawn_shapes`."""
    colors = np.array([(0.0, 0.0, 0.0), *(shape.color[:3] for shape, _ in drawn_shapes(layout))])
    return (255.0 * np.clip(colors, 0.0, 1.0) + 0.5).astype(np.uint8)
