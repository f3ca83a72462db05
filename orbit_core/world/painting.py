"""Colours of links that differ between environments, in all pictures of a world."""

from __future__ import annotations

import weakref

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_columns
from orbit_core.interfaces import Renderer


class Painting:
    """Links' own colours, of N environments, and the renderers that draw them.

    Args:
        num_envs: N.
        links: L, of the scene.
        device: where colours lie.
    """

    def __init__(self, num_envs: int, links: int, device: torch.device) -> None:
        self._shape, self._device = (num_envs, links, 4), device
        self._colors: Tensor | None = None
        self._renderers: weakref.WeakSet[Renderer] = weakref.WeakSet()

    def add(self, renderer: Renderer) -> Renderer:
        """Have a renderer draw the colours; gives it back."""
        self._renderers.add(renderer)
        renderer.set_link_colors(self._colors)
        return renderer

    def paint(self, links: Tensor, colors: Tensor, env_ids: Tensor | None) -> None:
        """Give links (k,) colours (n, k, 3) in some environments."""
        if self._colors is None:
            self._colors = torch.zeros(self._shape, device=self._device)
            for renderer in self._renderers:
                renderer.set_link_colors(self._colors)
        holding = torch.cat((colors, torch.ones_like(colors[..., :1])), dim=-1)
        write_columns(self._colors, links, holding, env_ids)
