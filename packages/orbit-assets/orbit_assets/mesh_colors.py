"""One colour for a surface of a mesh file, whatever the file says of its material."""

from __future__ import annotations

from typing import Any

import numpy as np

from orbit_core.scene import Color


def surface_color(geometry: Any) -> tuple[Color | None, bool]:
    """A trimesh geometry's colour, ``None`` where the file gives none, and whether it stands for a picture.

    A picture counts as the median of what the surface shows of it, or of all of it where nothing says what that is.
    """
    visual = geometry.visual
    if not visual.defined:
        return None, False
    material = getattr(visual, "material", None)
    if material is None:
        return _color(visual.main_color), False
    picture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if picture is None:
        return _color(material.main_color), False
    return _color(np.median(_shown(geometry, picture), axis=0)), True


def _shown(geometry: Any, picture: Any) -> Any:
    coordinates = getattr(geometry.visual, "uv", None)
    if coordinates is not None and np.shape(coordinates) == (len(geometry.vertices), 2):
        return geometry.visual.to_color().vertex_colors
    return np.asarray(picture.convert("RGBA")).reshape(-1, 4)


def _color(channels: Any) -> Color:
    r, g, b, a = (round(float(channel) / 255.0, 4) for channel in channels)
    return (r, g, b, a)
