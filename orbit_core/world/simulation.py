"""Making worlds: simulated ones by name of a backend, and what else makes any."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any, Protocol

import torch

from orbit_core.dynamics.linear import products_ignore_other_rows
from orbit_core.interfaces import World
from orbit_core.scene import Scene
from orbit_core.world.world import SimulatedWorld


class WorldFactory(Protocol):
    """Makes a world of a scene, however it comes by its state: recorded, or measured on real robots."""

    def __call__(self, scene: Scene, num_envs: int, device: torch.device, seed: int) -> World:
        """The world, whose tensors are on ``device`` and whose random streams start from ``seed``."""
        ...


def simulate(
    scene: Scene,
    num_envs: int,
    backend: str,
    settings: Mapping[str, Any] | None = None,
    device: str | torch.device = "cpu",
    seed: int = 0,
    renderer: str | None = None,
    renderer_settings: Mapping[str, Any] | None = None,
    matter: str | None = None,
    matter_settings: Mapping[str, Any] | None = None,
) -> World:
    """N environments of a scene in one physics engine.

    Args:
        scene: what to simulate.
        num_envs: how many copies.
        backend: name of an installed backend.
        settings: the backend's own settings, by field name.
        device: where state tensors live.
        seed: of the environments' random streams.
        renderer: name of the renderer, or backend, that draws; the one that simulates if None.
        renderer_settings: the renderer's own, by field name; over ``settings`` where one backend simulates and draws.
        matter: name of the matter solver that simulates deformables, or ``"native"`` for the engine's own; the first
            installed solver that does what the scene needs, and else the engine, if None.
        matter_settings: the matter solver's own, by field name.

    Raises:
        UnknownNameError, BackendNotInstalledError: no such backend.
        UnsupportedCapabilityError: the backend lacks what the scene needs, or the renderer what its cameras need.
        AssetError: an articulation cannot be simulated.
        BuildError: what the engine built is not what the scene describes.
    """
    drawing, matters = (renderer, renderer_settings), (matter, matter_settings)
    world = SimulatedWorld(scene, num_envs, backend, settings, device, seed, *drawing, *matters)
    if world.device.type == "cpu" and not products_ignore_other_rows():
        warnings.warn(
            "matrix products of this process depend on the number of environments, in their last bits, and so do "
            "observations and rewards: import orbit_core before torch multiplies anything, or set MKL_CBWR=AUTO,STRICT",
            stacklevel=2,
        )
    return world
