"""Environments of dm_control: its suite by ``DOMAIN-TASK``, its manipulation by ``manipulation/NAME``."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium
import numpy as np
from adapters.common import GymnasiumSession, RawMujoco, mujoco_facts
from dm_control import manipulation, suite
from session import PICTURE, Facts, Request


class Wrapped(gymnasium.Env):
    """Environment of dm_control behind Gymnasium's interface, for Gymnasium's vector environments.

    Args:
        name: of the environment.
    """

    def __init__(self, name: str) -> None:
        folder, _, task = name.rpartition("/")
        self.inner = manipulation.load(task) if folder else suite.load(*task.split("-"))
        spec = self.inner.action_spec()
        self.action_space = gymnasium.spaces.Box(spec.minimum, spec.maximum, dtype=spec.dtype)
        sizes = {key: part.shape for key, part in self.inner.observation_spec().items()}
        self.observation_space = gymnasium.spaces.Dict(
            {key: gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float64) for key, shape in sizes.items()}
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        return self.inner.reset().observation, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        step = self.inner.step(action)
        return step.observation, float(step.reward or 0.0), False, step.last(), {}

    def render(self) -> Any:
        return self.inner.physics.render(PICTURE, PICTURE, camera_id=0)


def make(request: Request) -> GymnasiumSession:
    """Make the requested environments."""
    return GymnasiumSession(partial(Wrapped, request.environment), request, facts, raw)


def decimation(environment: Wrapped) -> int:
    """Return the physics steps of an environment's step."""
    return round(environment.inner.control_timestep() / environment.inner.physics.timestep())


def facts(environment: Wrapped) -> Facts:
    """Return an environment's properties."""
    model = environment.inner.physics.model.ptr
    return mujoco_facts(model, decimation(environment), environment.action_space.shape[0])


def raw(environment: Wrapped, copies: int) -> RawMujoco:
    """Return MuJoCo's stepping of an environment's model."""
    # Tasks of manipulation compile another model at a reset: an episode that outlasts the snapshots keeps this one.
    physics = environment.inner.physics
    return RawMujoco(environment, physics.model.ptr, physics.data.ptr, decimation(environment), copies)
