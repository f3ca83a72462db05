"""Textures of links that differ between environments, painted into the pictures of any renderer.

A picture's depth says where the surface in each pixel is, and its normals which way it faces; with the link's pose that
is a place in the texture. What a renderer shades is in proportion to the surface's own colour
(:mod:`orbit_core.scene.scene`), so that the texture multiplies what was drawn: alike on every engine, with its lights
and shadows. It does not show in reflections; where light is so strong that a picture is white, it is too dark.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import take_rows
from orbit_core.dynamics.transforms import quat_rotate_inverse
from orbit_core.interfaces import Image, Renderer
from orbit_core.scene import CameraSpec, Channel, Texture
from orbit_core.sensors.camera import intrinsic_matrix, point_cloud
from orbit_core.world.outer_renderer import OuterRenderer

RESOLUTION = 256
"""Pixels of a texture's sides, to which all are brought."""
_WHERE = (Channel.DEPTH, Channel.NORMALS, Channel.INSTANCE)


@dataclass(frozen=True, eq=False)
class LinkTextures:
    """The textures of a world, and which of them each link has."""

    pixels: Tensor
    """(T * R * R, 3) in [0, 1]: of each texture its rows, the lowest first, of :data:`RESOLUTION` pixels."""
    scales: Tensor
    """(T, 2) pixels a metre, along the picture and up."""
    chosen: Tensor
    """(N, L) int64 which texture each link has in each environment; -1 for none."""
    across: Tensor
    """(3, 2) int64 the axes on which a texture lies, of a surface that faces along x, y or z."""

    @staticmethod
    def of(textures: Sequence[Texture], chosen: Tensor) -> LinkTextures:
        """Bring textures to one resolution, on the device of ``chosen`` (N, L)."""
        sheets: list[Tensor] = []
        for texture in textures:
            picture = torch.tensor(texture.pixels, dtype=torch.float32).flip(0).permute(2, 0, 1)[None] / 255.0
            sheet = torch.nn.functional.interpolate(picture, (RESOLUTION, RESOLUTION), mode="bilinear", antialias=True)
            sheets.append(sheet[0].permute(1, 2, 0).reshape(-1, 3))
        scales = [(RESOLUTION / texture.width, RESOLUTION / texture.height) for texture in textures]
        device = chosen.device
        across = torch.tensor(((1, 2), (0, 2), (0, 1)), device=device)
        return LinkTextures(torch.cat(sheets).to(device), torch.tensor(scales, device=device), chosen, across)

    def colors(self, which: Tensor, places: Tensor) -> Tensor:
        """Colours (..., 3) in [0, 1] of textures (...) at places (..., 2) in metres, blended from four pixels."""
        at = places * self.scales[which] + 0.5 * (RESOLUTION - 1)  # the middle at the frame's origin
        low = at.floor()
        right, up = (at - low).unbind(-1)
        column, row = low.long().unbind(-1)
        total = torch.zeros(*which.shape, 3, device=which.device)
        for along, across in ((0, 0), (1, 0), (0, 1), (1, 1)):
            weight = (right if along else 1.0 - right) * (up if across else 1.0 - up)
            pixel = ((row + across) % RESOLUTION) * RESOLUTION + (column + along) % RESOLUTION
            total += weight[..., None] * self.pixels[which * RESOLUTION**2 + pixel]
        return total


class TexturedRenderer(OuterRenderer):
    """Draws with another renderer, and paints textures where links have any."""

    def __init__(self, inner: Renderer) -> None:
        super().__init__(inner)
        self._textures: LinkTextures | None = None
        self._lenses: dict[tuple[CameraSpec, torch.device], Tensor] = {}

    def set_link_textures(self, textures: LinkTextures | None) -> None:
        """Paint these from now on; whoever owns ``chosen`` writes it in place."""
        self._textures = textures

    def render(
        self,
        camera: CameraSpec,
        camera_poses: Tensor,
        link_poses: Tensor,
        channels: Sequence[Channel],
        marker_poses: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> Image:
        textures = self._textures
        if textures is None or not {Channel.RGB, Channel.ALBEDO} & {*channels}:
            return self._inner.render(camera, camera_poses, link_poses, channels, marker_poses, env_ids)
        asked = tuple(dict.fromkeys((*channels, *_WHERE)))
        image = self._inner.render(camera, camera_poses, link_poses, asked, marker_poses, env_ids)
        chosen = take_rows(textures.chosen, env_ids)[: len(link_poses)]
        lens = self._lens(camera, link_poses.device)
        share = _shares(textures, chosen, lens, camera_poses, link_poses, image)
        kept = image.only(channels)
        colors = {"rgb": kept.rgb, "albedo": kept.albedo}
        return replace(
            kept,
            **{name: (each * share + 0.5).to(torch.uint8) for name, each in colors.items() if each is not None},
        )

    def _lens(self, camera: CameraSpec, device: torch.device) -> Tensor:
        """(3, 3) in pixels, made once, for a captured step copies nothing to its device."""
        if (camera, device) not in self._lenses:
            self._lenses[camera, device] = intrinsic_matrix(camera).to(device)
        return self._lenses[camera, device]


def _shares(
    textures: LinkTextures, chosen: Tensor, lens: Tensor, eyes: Tensor, link_poses: Tensor, image: Image
) -> Tensor:
    """(n, H, W, 3) in [0, 1]: what is left of each pixel's colour."""
    depth, normals, links = image.depth, image.normals, image.links
    assert depth is not None  # all three were asked for
    assert normals is not None
    assert links is not None
    device, flat = link_poses.device, links.to(link_poses.device, torch.int64).flatten(1)
    seen = flat.clamp_min(0)
    which = torch.where(flat >= 0, chosen.gather(1, seen), -1).view(links.shape[:3])
    poses = link_poses.gather(1, seen[..., None].expand(-1, -1, 7)).view(*which.shape, 7)
    points = point_cloud(depth.to(device), lens, eyes)
    places = quat_rotate_inverse(poses[..., 3:], torch.where(points.isfinite(), points, 0.0) - poses[..., :3])
    facing = quat_rotate_inverse(poses[..., 3:], normals.to(device)).abs().argmax(-1)
    places = places.gather(-1, textures.across[facing])
    colors = textures.colors(which.clamp_min(0), places)
    return torch.where((which >= 0)[..., None], colors, 1.0)
