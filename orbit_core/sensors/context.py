"""What a sensor needs of the world that it measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

from orbit_core.dynamics.random import RandomStreams
from orbit_core.interfaces import Engine, Renderer, SceneLayout


@dataclass
class SensorContext:
    """``renderer`` is called on first use only, so that a scene whose cameras nobody reads makes none."""

    engine: Engine
    layout: SceneLayout
    physics_dt: float
    random: RandomStreams
    renderer: Callable[[], Renderer]
    gravity: Tensor = field(init=False)
    """(N, 3) m/s^2; whoever changes the engine's gravity writes it here too, for IMUs."""

    def __post_init__(self) -> None:
        gravity = torch.tensor(self.layout.scene.gravity, dtype=torch.float32, device=self.engine.device)
        self.gravity = gravity.repeat(self.engine.num_envs, 1)
