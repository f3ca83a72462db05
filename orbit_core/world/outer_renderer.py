"""Renderers that draw with another one, and paint over what it drew."""

from __future__ import annotations

from torch import Tensor

from orbit_core.interfaces import Renderer


class OuterRenderer(Renderer):
    """Hands all but pictures on to the renderer that it draws with."""

    def __init__(self, inner: Renderer) -> None:
        self._inner = inner
        self.capture = inner.capture

    def set_link_colors(self, colors: Tensor | None) -> None:
        super().set_link_colors(colors)
        self._inner.set_link_colors(colors)

    def close(self) -> None:
        self._inner.close()
