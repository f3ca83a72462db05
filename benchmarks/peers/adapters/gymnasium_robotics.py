"""Gymnasium's and Gymnasium-Robotics' environments of MuJoCo."""

from __future__ import annotations

from functools import partial

import gymnasium
import gymnasium_robotics
from adapters.common import GymnasiumSession, RawMujoco, mujoco_facts
from session import PICTURE, Facts, Request


def make(request: Request) -> GymnasiumSession:
    """Make the requested environments."""
    gymnasium.register_envs(gymnasium_robotics)
    one = partial(gymnasium.make, request.environment, render_mode="rgb_array", width=PICTURE, height=PICTURE)
    return GymnasiumSession(one, request, facts, raw)


def decimation(environment: gymnasium.Env) -> int:
    """Return the physics steps of an environment's step."""
    inner = environment.unwrapped
    return getattr(inner, "n_substeps", 0) or inner.frame_skip


def facts(environment: gymnasium.Env) -> Facts:
    """Return an environment's properties."""
    size = environment.action_space.shape[0]
    return mujoco_facts(environment.unwrapped.model, decimation(environment), size)


def raw(environment: gymnasium.Env, copies: int) -> RawMujoco:
    """Return MuJoCo's stepping of an environment's model."""
    inner = environment.unwrapped
    return RawMujoco(environment, inner.model, inner.data, decimation(environment), copies)
