"""MuJoCo Playground's environments, wrapped as for its training: batched, and reset where an episode ends."""

from __future__ import annotations

import os
from itertools import cycle

import jax
from mujoco_playground import registry, wrapper
from session import ACTIONS, Facts, Request, Session

# The other side needs memory of the same GPU.
os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")


class PlaygroundSession(Session):
    """Environments of MuJoCo Playground, batched on JAX's default device."""

    def __init__(self, request: Request) -> None:
        self.num_envs = request.num_envs
        one = registry.load(request.environment)
        self._environment = wrapper.wrap_for_brax_training(one)
        key, drawn = jax.random.split(jax.random.PRNGKey(request.seed))
        self._state = jax.jit(self._environment.reset)(jax.random.split(key, self.num_envs))
        self._step = jax.jit(self._environment.step)
        shape = (ACTIONS, self.num_envs, one.action_size)
        self._actions = cycle(list(jax.random.uniform(drawn, shape, minval=-1.0, maxval=1.0)))
        self.facts = Facts(
            engine=f"MJX, {one.mjx_model.impl.value}",
            physics_dt=one.sim_dt,
            decimation=one.n_substeps,
            action_size=one.action_size,
            degrees_of_freedom=int(one.mj_model.nv),
        )

    def step(self) -> None:
        self._state = self._step(self._state, next(self._actions))

    def wait(self) -> None:
        jax.block_until_ready(self._state)


def make(request: Request) -> PlaygroundSession:
    """Make the requested environments."""
    return PlaygroundSession(request)
