"""The light that falls on a scene, and the sky behind it.

Every renderer shades alike. The colour of a pixel, each of red, green and blue by itself, is

    clip(albedo * (ambient + sum over k of reached_k * intensity_k * color_k * max(0, n . (-direction_k))), 0, 1)

with the shape's own colour ``albedo``, the sum ``ambient`` of all ambient lights, the surface's unit normal ``n`` and
``reached_k``, 0 where the directional light k casts shadows and something opaque stands between it and the surface, or
else 1. It is Lambert's law, reckoned in the numbers of the picture (sRGB, as they are stored) with no conversion to
linear light: half the light is half the number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from orbit_core.scene.pose import Vector3

Rgb = tuple[float, float, float]
"""Red, green and blue."""

MAX_DIRECTIONAL_LIGHTS = 3
"""Most directional lights of one scene, which every renderer can draw."""


@dataclass(frozen=True)
class AmbientLight:
    """Light that reaches every surface alike, from all around."""

    color: Rgb = (0.42, 0.42, 0.45)


@dataclass(frozen=True)
class DirectionalLight:
    """Parallel light, as the sun's.

    ``direction`` is where the light travels to, in the environment's frame and of any length but zero. A surface that
    faces the light gains ``intensity * color``.
    """

    direction: Vector3 = (-0.35, 0.45, -1.0)
    color: Rgb = (1.0, 0.97, 0.92)
    intensity: float = 0.58
    shadows: bool = True

    @property
    def unit_direction(self) -> Vector3:
        """The direction, of length 1."""
        length = math.hypot(*self.direction)
        x, y, z = self.direction
        return (x / length, y / length, z / length)

    @property
    def radiance(self) -> Rgb:
        """Intensity times colour."""
        red, green, blue = self.color
        return (self.intensity * red, self.intensity * green, self.intensity * blue)


Light = AmbientLight | DirectionalLight


@dataclass(frozen=True)
class Sky:
    """What is seen where nothing else is, lit by no light.

    Colours straight above and straight below; between them the part of ``above`` is ``(1 + z) / 2``, where ``z`` is the
    height of the unit vector along the pixel's ray.
    """

    above: Rgb = (0.55, 0.68, 0.82)
    below: Rgb = (0.88, 0.91, 0.94)
