"""mjlab's environments, by their registered names."""

from __future__ import annotations

from itertools import cycle

import mjlab.tasks
import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.tasks.registry import load_env_cfg
from mjlab.utils.torch import configure_torch_backends
from session import ACTIONS, Facts, Request, Session

assert mjlab.tasks  # its import registers the tasks


class MjlabSession(Session):
    """Environments of mjlab, batched on one device."""

    def __init__(self, request: Request) -> None:
        import mujoco_warp

        configure_torch_backends()  # as its training does
        configuration = load_env_cfg(request.environment)
        configuration.scene.num_envs = self.num_envs = request.num_envs
        configuration.seed = request.seed
        self._environment = ManagerBasedRlEnv(cfg=configuration, device=request.device)
        self._environment.reset()
        ages = self._environment.episode_length_buf
        ages.random_(self._environment.max_episode_length)  # so that some episodes end at every step
        size = self._environment.action_manager.total_action_dim
        actions = 2.0 * torch.rand((ACTIONS, self.num_envs, size), device=self._environment.device) - 1.0
        self._actions = cycle(actions.unbind())
        self.facts = Facts(
            engine=f"MuJoCo-Warp {mujoco_warp.__version__}",
            physics_dt=self._environment.physics_dt,
            decimation=configuration.decimation,
            action_size=size,
            degrees_of_freedom=int(self._environment.sim.mj_model.nv),
        )

    def step(self) -> None:
        self._environment.step(next(self._actions))

    def wait(self) -> None:
        if str(self._environment.device).startswith("cuda"):
            torch.cuda.synchronize()

    def close(self) -> None:
        self._environment.close()


def make(request: Request) -> MjlabSession:
    """Make the requested environments."""
    return MjlabSession(request)
