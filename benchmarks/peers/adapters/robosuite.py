"""robosuite's environments, with its Panda and its default controller."""

from __future__ import annotations

from functools import partial

import gymnasium
import robosuite
from robosuite.wrappers import GymWrapper

from adapters.common import GymnasiumSession, RawMujoco, mujoco_facts
from session import PICTURE, Facts, Request


class Drawn(GymWrapper):
    """robosuite's own wrapper, with pictures; each environment has its own seed."""

    def render(self):  # noqa: ANN201
        return self.env.sim.render(width=PICTURE, height=PICTURE, camera_name="frontview")


def make_one(name: str, drawn: bool) -> gymnasium.Env:
    """Make one environment.

    Args:
        name: of the environment.
        drawn: with a renderer, which each of many environments would make for itself.
    """
    environment = robosuite.make(
        name, robots="Panda", has_renderer=False, has_offscreen_renderer=drawn, use_camera_obs=False,
        reward_shaping=True, control_freq=20,
    )  # fmt: skip
    return Drawn(environment, keys=["robot0_proprio-state", "object-state"])


def make(request: Request) -> GymnasiumSession:
    """Make the requested environments."""
    return GymnasiumSession(partial(make_one, request.environment, request.num_envs == 1), request, facts, raw)


def decimation(environment: Drawn) -> int:
    """Return the physics steps of an environment's step."""
    return round(environment.env.control_timestep / environment.env.model_timestep)


def facts(environment: Drawn) -> Facts:
    """Return an environment's properties."""
    model = environment.env.sim.model._model
    return mujoco_facts(model, decimation(environment), environment.action_space.shape[0])


def raw(environment: Drawn, copies: int) -> RawMujoco:
    """Return MuJoCo's stepping of an environment's model."""
    sim = environment.env.sim
    return RawMujoco(environment, sim.model._model, sim.data._data, decimation(environment), copies)
