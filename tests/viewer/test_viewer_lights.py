"""The scene's lights as the browser's renderer takes them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from viser import ViserServer

from orbit_core.scene import AmbientLight, DirectionalLight, Scene
from orbit_viewer.scene_view import add_lights, browser_light


class Recorder:
    """Stands for a server and its scene, and keeps what it is told."""

    def __init__(self) -> None:
        self.scene = self
        self.told: dict[str, dict] = {}

    def __getattr__(self, name: str):
        assert hasattr(ViserServer, name) or name in dir(_scene_api()), name

        def record(*args, **settings) -> None:
            self.told[args[0] if args and isinstance(args[0], str) else name] = settings

        return record


def _scene_api() -> type:
    from viser import SceneApi

    return SceneApi


def facing(light: dict) -> np.ndarray:
    """What three.js gives a white surface that faces the light, in linear light."""
    return light["intensity"] / math.pi * (np.array(light["color"]) / 255.0) ** 2.2


def test_a_white_surface_that_faces_the_light_is_as_bright_as_the_scene_says() -> None:
    scene = Scene(
        lights=(AmbientLight((0.2, 0.3, 0.4)), DirectionalLight((0.0, 3.0, -4.0), (1.0, 0.5, 0.25), 0.6, shadows=False))
    )
    browser = Recorder()
    add_lights(browser, scene)  # type: ignore[arg-type]
    ambient, sun = browser.told["/lights/ambient"], browser.told["/lights/0"]
    shown = (facing(ambient) + facing(sun)) ** (1 / 2.2)
    assert shown == pytest.approx([0.8, 0.6, 0.55], abs=3e-3)
    assert facing(ambient) ** (1 / 2.2) == pytest.approx([0.2, 0.3, 0.4], abs=3e-3)
    assert sun["position"] == pytest.approx((0.0, -1.8, 2.4))
    assert sun["cast_shadow"] is False


def test_darkness_is_no_light() -> None:
    assert browser_light(np.zeros(3)) == ((0, 0, 0), 0.0)
