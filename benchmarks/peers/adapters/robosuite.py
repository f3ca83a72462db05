"""robosuite's environments, with its Panda and its default controller."""

from __future__ import annotations

from functools import partial

import gymnasium
import robosuite
from adapters.common import GymnasiumSession, RawMujoco, mujoco_facts
from robosuite.wrappers import GymWrapper
from session import PICTURE, Facts, Request


class Drawn(GymWrapper):
    """robosuite's own wrapper, with pictures."""

    def render(self):
        return self.env.sim.render(width=PICTURE, height=PICTURE, camera_name="frontview")


def make_one(name: str, drawn: bool) -> gymnasium.Env:
    """Make one environment.

    Args:
        name: of the environment.
        drawn: with a renderer.
    """
    environment = robosuite.make(
        name, robots="Panda", has_renderer=False, has_offscreen_renderer=drawn, use_camera_obs=False,
        reward_shaping=True, control_freq=20,
    )  # fmt: skip
    wrapped = Drawn(environment, keys=["robot0_proprio-state", "object-state"])
    wrapped.metadata = {"render_modes": ["rgb_array"]}  # robosuite leaves None, which vector environments do not take
    return wrapped


def make(request: Request) -> GymnasiumSession:
    """Make the requested environments."""
    plain, drawn = (partial(make_one, request.environment, drawn) for drawn in (False, True))
    return GymnasiumSession(plain, request, facts, raw, drawn)


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
