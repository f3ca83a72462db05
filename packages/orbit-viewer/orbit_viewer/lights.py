"""The scene's lights and sky in the browser, whose renderer reckons in linear light.

Surfaces that no directional light falls on, and those that face a single one, are as bright as
:mod:`orbit_core.scene.scene` says; between the two, the browser's are brighter.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from orbit_core.scene import Scene

if TYPE_CHECKING:
    from viser import ViserServer

_GAMMA = 2.2
_DISTANCE = 3.0
"""Metres from a directional light to the origin, which it shines at."""


def add_lights(server: ViserServer, scene: Scene) -> None:
    """Light and background of a scene in place of the browser's own."""
    browser = server.scene
    browser.configure_default_lights(enabled=False)
    around = np.asarray(scene.ambient, dtype=np.float64)
    color, intensity = browser_light(around**_GAMMA)
    browser.add_light_ambient("/lights/ambient", color=color, intensity=intensity)
    for index, light in enumerate(scene.directional_lights):
        color, intensity = browser_light((around + light.radiance) ** _GAMMA - around**_GAMMA)
        x, y, z = (-_DISTANCE * part for part in light.unit_direction)
        browser.add_light_directional(
            f"/lights/{index}", color=color, intensity=intensity, cast_shadow=light.shadows, position=(x, y, z)
        )
    sky = np.linspace(scene.sky.above, scene.sky.below, 256)
    rows = (255.0 * sky + 0.5).astype(np.uint8)
    browser.set_background_image(np.repeat(rows[:, None], 2, axis=1), format="png")


def browser_light(linear: npt.NDArray[np.float64]) -> tuple[tuple[int, int, int], float]:
    """Colour and intensity of linear light (3,); three.js divides a light's intensity by pi."""
    brightest = float(linear.max())
    if brightest <= 0.0:
        return (0, 0, 0), 0.0
    red, green, blue = (round(255.0 * float(part / brightest) ** (1.0 / _GAMMA)) for part in linear)
    return (red, green, blue), math.pi * brightest
