"""Meta-World's environments, one task of one kind each."""

from __future__ import annotations

from functools import partial

import gymnasium
import metaworld
from adapters.common import GymnasiumSession, RawMujoco, mujoco_facts
from session import PICTURE, Facts, Request

assert metaworld  # its import registers the environments


def make(request: Request) -> GymnasiumSession:
    """Make the requested environments."""
    one = partial(
        gymnasium.make, "Meta-World/MT1", env_name=request.environment, render_mode="rgb_array", width=PICTURE,
        height=PICTURE,
    )  # fmt: skip
    return GymnasiumSession(one, request, facts, raw)


def facts(environment: gymnasium.Env) -> Facts:
    """Return an environment's properties."""
    inner = environment.unwrapped
    return mujoco_facts(inner.model, inner.frame_skip, environment.action_space.shape[0])


def raw(environment: gymnasium.Env, copies: int) -> RawMujoco:
    """Return MuJoCo's stepping of an environment's model."""
    inner = environment.unwrapped
    return RawMujoco(environment, inner.model, inner.data, inner.frame_skip, copies)
