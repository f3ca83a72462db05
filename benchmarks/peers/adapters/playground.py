"""MuJoCo Playground's environments, wrapped as for its training: batched, and reset where an episode ends."""

from __future__ import annotations

import jax
from mujoco_playground import registry, wrapper
from session import Facts, Request, Session


class PlaygroundSession(Session):
    """Environments of MuJoCo Playground, batched on JAX's default device."""

    def __init__(self, request: Request) -> None:
        self.num_envs = request.num_envs
        one = registry.load(request.environment)
        self._environment = wrapper.wrap_for_brax_training(one)
        self._key = jax.random.PRNGKey(request.seed)
        self._state = jax.jit(self._environment.reset)(jax.random.split(self._key, self.num_envs))
        self._step = jax.jit(self._stepped)
        self.facts = Facts(
            engine=f"MJX, {one.mjx_model.impl.value}",
            physics_dt=one.sim_dt,
            decimation=one.n_substeps,
            action_size=one.action_size,
            degrees_of_freedom=int(one.mj_model.nv),
        )

    def _stepped(self, state, key):
        key, drawn = jax.random.split(key)
        action = jax.random.uniform(drawn, (self.num_envs, self.facts.action_size), minval=-1.0, maxval=1.0)
        return self._environment.step(state, action), key

    def step(self) -> None:
        self._state, self._key = self._step(self._state, self._key)

    def wait(self) -> None:
        jax.block_until_ready(self._state)


def make(request: Request) -> PlaygroundSession:
    """Make the requested environments."""
    return PlaygroundSession(request)
