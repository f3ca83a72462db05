"""mjlab's environments, by their registered names."""

from __future__ import annotations

import mjlab.tasks
import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.tasks.registry import load_env_cfg
from session import Facts, Request, Session

assert mjlab.tasks  # its import registers the tasks


class MjlabSession(Session):
    """Environments of mjlab, batched on one device."""

    def __init__(self, request: Request) -> None:
        import mujoco_warp

        configuration = load_env_cfg(request.environment)
        configuration.scene.num_envs = self.num_envs = request.num_envs
        configuration.seed = request.seed
        self._environment = ManagerBasedRlEnv(cfg=configuration, device=request.device)
        self._environment.reset()
        size = self._environment.action_manager.total_action_dim
        self._shape = (self.num_envs, size)
        self.facts = Facts(
            engine=f"MuJoCo-Warp {mujoco_warp.__version__}",
            physics_dt=self._environment.physics_dt,
            decimation=configuration.decimation,
            action_size=size,
            degrees_of_freedom=int(self._environment.sim.mj_model.nv),
        )

    def step(self) -> None:
        self._environment.step(2.0 * torch.rand(self._shape, device=self._environment.device) - 1.0)

    def wait(self) -> None:
        if str(self._environment.device).startswith("cuda"):
            torch.cuda.synchronize()

    def close(self) -> None:
        self._environment.close()


def make(request: Request) -> MjlabSession:
    """Make the requested environments."""
    return MjlabSession(request)
