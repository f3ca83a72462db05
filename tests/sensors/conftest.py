"""Sensors on an engine, stepped as a world steps them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import pytest
import torch
from torch import Tensor

from orbit_core import backends
from orbit_core.dynamics.random import RandomStreams
from orbit_core.interfaces import Renderer, SceneLayout
from orbit_core.scene import CameraSpec, Scene
from orbit_core.sensors import SensorContext, TimedSensor, create_sensor


class Rig:
    """An engine with the scene's sensors."""

    def __init__(self, scene: Scene, num_envs: int, seed: int) -> None:
        backend = backends.backend(backends.default_backend())
        backends.check_scene(backend, scene)
        config = backends.backend_config(backend)
        self.layout = SceneLayout.of(scene)
        self.engine = backend.create_engine(self.layout, num_envs, torch.device("cpu"), config)
        self.random = RandomStreams(num_envs, seed, torch.device("cpu"))
        self.random.reset()
        self.renderers: list[Renderer] = []
        cameras = [spec for spec in scene.sensors if isinstance(spec, CameraSpec)]

        def renderer() -> Renderer:
            if not self.renderers:
                self.renderers.append(backend.create_renderer(self.layout, cameras, config))
            return self.renderers[0]

        context = SensorContext(self.engine, self.layout, scene.physics_dt, self.random, renderer)
        self.sensors: dict[str, TimedSensor] = {spec.name: create_sensor(spec, context) for spec in scene.sensors}
        periods = [sensor.period for sensor in self.sensors.values() if sensor.period is not None]
        self._stretch = math.gcd(*periods) if periods else None
        self._steps = 0

    def step(self, steps: int = 1) -> None:
        for sensor in self.sensors.values():
            sensor.begin_step()
        while steps > 0:
            stretch = steps if self._stretch is None else min(steps, self._stretch - self._steps % self._stretch)
            self.engine.step(stretch)
            self._steps += stretch
            steps -= stretch
            for sensor in self.sensors.values():
                sensor.advance(stretch)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self.random.reset(env_ids)
        self.engine.reset(env_ids)
        for sensor in self.sensors.values():
            sensor.reset(env_ids)

    def close(self) -> None:
        for renderer in self.renderers:
            renderer.close()
        self.engine.close()


MakeRig = Callable[..., Rig]


@pytest.fixture
def make_rig() -> Iterator[MakeRig]:
    """``make_rig(scene, num_envs=2, seed=0)``; closed after the test."""
    made: list[Rig] = []

    def make(scene: Scene, num_envs: int = 2, seed: int = 0) -> Rig:
        made.append(Rig(scene, num_envs, seed))
        return made[-1]

    yield make
    for rig in made:
        rig.close()
