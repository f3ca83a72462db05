"""Newton's stepping of a model among its examples: physics only, for Newton has no environments.

Options are ``physics_dt`` and ``decimation``. Joints get random efforts; nothing is reset, observed or rewarded.
"""

from __future__ import annotations

from itertools import cycle
from pathlib import Path

import newton
import torch
import warp as wp
from session import ACTIONS, Facts, Request, Session


class NewtonSession(Session):
    """Worlds of Newton, stepped by its solver of MuJoCo-Warp, as one CUDA graph on a GPU."""

    def __init__(self, request: Request) -> None:
        self.num_envs = request.num_envs
        wp.set_device(request.device)
        one = newton.ModelBuilder()
        newton.solvers.SolverMuJoCo.register_custom_attributes(one)
        # Newton's examples import its tests, which an installation may lack: their models are read without them.
        file = Path(newton.__file__).parent / "examples" / "assets" / request.environment
        one.add_mjcf(str(file), up_axis="Z", enable_self_collisions=False)
        builder = newton.ModelBuilder()
        builder.replicate(one, self.num_envs)
        builder.add_ground_plane()
        model = builder.finalize()
        self._solver = newton.solvers.SolverMuJoCo(model, njmax=200, nconmax=100)
        self._states = [model.state(), model.state()]
        self._control = model.control()
        newton.eval_fk(model, model.joint_q, model.joint_qd, self._states[0])
        self._physics_dt, self._decimation = request.options["physics_dt"], request.options["decimation"]
        if self._decimation % 2:
            raise ValueError("an even decimation leaves the state where a recorded step begins")
        efforts = wp.to_torch(self._control.joint_f).view(self.num_envs, -1)
        # The first six are the root's.
        self._efforts = efforts[:, 6:]
        drawn = 20.0 * torch.rand((ACTIONS, *self._efforts.shape), device=self._efforts.device) - 10.0
        self._actions = cycle(drawn.unbind())
        self.facts = Facts(
            engine=f"Newton {newton.__version__}, MuJoCo solver",
            physics_dt=self._physics_dt,
            decimation=self._decimation,
            action_size=self._efforts.shape[1],
            degrees_of_freedom=efforts.shape[1],
        )
        self._graph = None
        self._simulate()  # loads kernels, which a recording does not allow
        if wp.get_device().is_cuda:
            with wp.ScopedCapture() as capture:
                self._simulate()
            self._graph = capture.graph

    def _simulate(self) -> None:
        first, second = self._states
        for _ in range(self._decimation):
            first.clear_forces()
            self._solver.step(first, second, self._control, None, self._physics_dt)
            first, second = second, first

    def step(self) -> None:
        self._efforts.copy_(next(self._actions))
        if self._graph is None:
            self._simulate()
        else:
            wp.capture_launch(self._graph)

    def wait(self) -> None:
        wp.synchronize()


def make(request: Request) -> NewtonSession:
    """Make the requested environments."""
    return NewtonSession(request)
