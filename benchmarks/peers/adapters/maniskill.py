"""ManiSkill's environments on a CPU, one scene of SAPIEN each."""

from __future__ import annotations

from functools import partial

import gymnasium
import mani_skill.envs
import sapien
import torch
from adapters.common import GymnasiumSession
from mani_skill.utils.wrappers.gymnasium import CPUGymWrapper
from session import PICTURE, Facts, Request

assert mani_skill.envs  # its import registers the environments


def make_one(name: str, drawn: bool) -> gymnasium.Env:
    """Make one environment.

    Args:
        name: of the environment.
        drawn: with a renderer; without one no graphics device is needed.
    """
    options = {"width": PICTURE, "height": PICTURE, "shader_pack": "minimal"}
    render = {"render_mode": "rgb_array", "human_render_camera_configs": options} if drawn else {}
    environment = gymnasium.make(
        name, obs_mode="state", control_mode="pd_joint_delta_pos", sim_backend="physx_cpu",
        render_backend="sapien_cpu" if drawn else "none", num_envs=1, **render,
    )  # fmt: skip
    return CPUGymWrapper(environment)


def make(request: Request) -> GymnasiumSession:
    """Make the requested environments."""
    torch.set_num_threads(1)  # small tensors gain nothing from more
    plain, drawn = (partial(make_one, request.environment, drawn) for drawn in (False, True))
    return GymnasiumSession(plain, request, facts, make_drawn=drawn)


def facts(environment: gymnasium.Env) -> Facts:
    """Return an environment's properties."""
    inner = environment.unwrapped
    return Facts(
        engine=f"SAPIEN {sapien.__version__}, PhysX",
        physics_dt=1.0 / inner.sim_freq,
        decimation=inner.sim_freq // inner.control_freq,
        action_size=environment.action_space.shape[0],
        degrees_of_freedom=inner.agent.robot.max_dof + 6,
    )
