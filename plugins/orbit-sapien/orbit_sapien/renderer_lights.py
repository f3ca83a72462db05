"""The scene's lights as SAPIEN's."""

# pyright: reportAttributeAccessIssue=false, reportArgumentType=false

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.scene import DirectionalLight, Rgb, Scene
from orbit_sapien.config import SapienConfig
from orbit_sapien.native import NativePose, sapien

_DISTANCE = 10.0
"""Metres from a light that casts shadows to the middle of its shadows."""
_REACH = 3.0
"""Metres around the middle that shadows reach."""
_GAMMA = 2.2


class Lights:
    """All lights of a scene.

    Tier ``fast`` takes the scene's numbers as they are, for its shader works in the picture's. The others compute in
    linear light, where light adds up otherwise: theirs is such that what is in no directional light, and what faces
    a single one, is as bright as with ``fast``.
    """

    def __init__(self, native: sapien.Scene, scene: Scene, config: SapienConfig) -> None:
        ambient, lamps = scene.ambient, scene.directional_lights
        linear = config.tier != "fast"
        native.set_ambient_light([part**_GAMMA for part in ambient] if linear else list(ambient))
        self._casting: list[tuple[npt.NDArray[np.float64], Any]] = []
        for lamp in lamps:
            color = _linear(lamp, ambient) if linear else lamp.radiance
            casts = lamp.shadows and (config.shadow_size > 0 or config.tier == "rt")
            made = native.add_directional_light(
                lamp.unit_direction, list(color), shadow=casts, shadow_scale=_REACH, shadow_near=0.1,
                shadow_far=2.5 * _DISTANCE, shadow_map_size=max(config.shadow_size, 1),
            )  # fmt: skip
            if casts:
                self._casting.append((np.array(lamp.unit_direction), made.entity))

    def point_at(self, middle: npt.NDArray[Any]) -> None:
        """Draw shadows around a place (3,)."""
        for direction, entity in self._casting:
            entity.set_pose(NativePose((middle - _DISTANCE * direction).astype(np.float32), entity.pose.q))


def _linear(lamp: DirectionalLight, ambient: Rgb) -> list[float]:
    pairs = zip(lamp.radiance, ambient, strict=True)
    return [math.pi * ((light + around) ** _GAMMA - around**_GAMMA) for light, around in pairs]
