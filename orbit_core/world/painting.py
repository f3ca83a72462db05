"""Colours and textures of links that differ between environments, in all pictures of a world."""

from __future__ import annotations

import weakref
from collections.abc import Sequence

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_columns
from orbit_core.interfaces import Renderer
from orbit_core.scene import Texture
from orbit_core.world.texturing import LinkTextures, TexturedRenderer


class Painting:
    """Links' own colours and textures, of N environments, and the renderers that draw them.

    Args:
        num_envs: N.
        links: L, of the scene.
        device: where colours lie.
    """

    def __init__(self, num_envs: int, links: int, device: torch.device) -> None:
        self._shape, self._device = (num_envs, links, 4), device
        self._colors: Tensor | None = None
        self._known: list[Texture] = []
        self._numbers: dict[tuple[Texture, ...], Tensor] = {}
        """Of textures that were given together, made once, so that a captured step copies nothing to its device."""
        self._chosen: Tensor | None = None
        self.textures: LinkTextures | None = None
        """What renderers paint; None while nothing has a texture."""
        self._renderers: weakref.WeakSet[TexturedRenderer] = weakref.WeakSet()

    def add(self, renderer: Renderer) -> Renderer:
        """A renderer that draws what this one draws, with the colours and textures."""
        textured = TexturedRenderer(renderer)
        self._renderers.add(textured)
        textured.set_link_colors(self._colors)
        textured.set_link_textures(self.textures)
        return textured

    def paint(self, links: Tensor, colors: Tensor, env_ids: Tensor | None) -> None:
        """Give links (k,) colours (n, k, 3) in some environments."""
        if self._colors is None:
            self._colors = torch.zeros(self._shape, device=self._device)
            for renderer in self._renderers:
                renderer.set_link_colors(self._colors)
        holding = torch.cat((colors, torch.ones_like(colors[..., :1])), dim=-1)
        write_columns(self._colors, links, holding, env_ids)

    def texture(self, links: Tensor, textures: Sequence[Texture], chosen: Tensor, env_ids: Tensor | None) -> None:
        """Give links (k,) one of the textures each, by index (n, k) int64, or none by -1, in some environments."""
        if self._chosen is None:
            self._chosen = torch.full(self._shape[:2], -1, dtype=torch.int64, device=self._device)
        choices = tuple(textures)
        if choices not in self._numbers:
            self._numbers[choices] = self._learned(choices, self._chosen)
        write_columns(self._chosen, links, self._numbers[choices][chosen], env_ids)

    def _learned(self, textures: Sequence[Texture], chosen: Tensor) -> Tensor:
        """Have renderers know these textures; (k + 1,) their numbers among all that are known, then -1 for none."""
        if new := [texture for texture in textures if texture not in self._known]:
            self._known += new
            self.textures = LinkTextures.of(self._known, chosen)
            for renderer in self._renderers:
                renderer.set_link_textures(self.textures)
        return torch.tensor([*(self._known.index(texture) for texture in textures), -1], device=self._device)
