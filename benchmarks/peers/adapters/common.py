"""Adapters' shared parts: sessions of Gymnasium's environments, and raw stepping of a MuJoCo model.

Imported in the peers' own virtual environments, each of which has Gymnasium and NumPy.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from itertools import cycle
from typing import Any

import gymnasium
import numpy as np
from session import ACTIONS, Block, Facts, Request, Session, repeated

# Environment steps whose states and commands raw stepping starts from.
_SNAPSHOTS = 200


class Raw(ABC):
    """Bare engine of an environment."""

    @abstractmethod
    def step(self) -> None:
        """Step as many copies of the engine as there are environments, by the environment's decimation."""


class GymnasiumSession(Session):
    """Environments of Gymnasium's interface.

    Args:
        make: makes one environment; called in each process.
        request: number of environments, way of stepping them and seed.
        facts: reads the environment's properties.
        raw: makes the bare engine of an environment for a number of copies; None for no such measurement.
        make_drawn: makes an environment with a renderer, for pictures; None where ``make`` does.
    """

    def __init__(
        self,
        make: Callable[[], gymnasium.Env],
        request: Request,
        facts: Callable[[gymnasium.Env], Facts],
        raw: Callable[[gymnasium.Env, int], Raw] | None = None,
        make_drawn: Callable[[], gymnasium.Env] | None = None,
    ) -> None:
        self.num_envs, self._make_raw, self._make_drawn = request.num_envs, raw, make_drawn
        self._raw: Raw | None = None
        self._drawn: gymnasium.Env | None = None
        self._one = make()
        self.facts = facts(self._one)
        space = self._one.action_space
        shape = (ACTIONS, *((self.num_envs,) if self.num_envs > 1 else ()), *space.shape)
        actions = np.random.default_rng(request.seed).uniform(space.low, space.high, shape)
        self._actions = cycle(actions.astype(space.dtype))
        self._one.reset(seed=request.seed)
        self._many: gymnasium.vector.VectorEnv | None = None
        if self.num_envs > 1:
            kind = {"processes": gymnasium.vector.AsyncVectorEnv, "in turn": gymnasium.vector.SyncVectorEnv}
            self._many = kind[request.way]([make] * self.num_envs)
            self._many.reset(seed=request.seed)

    def step(self) -> None:
        if self._many is not None:
            self._many.step(next(self._actions))
        else:
            self._step_one()

    def _step_one(self) -> None:
        _, _, terminated, truncated, _ = self._one.step(next(self._actions))
        if terminated or truncated:
            self._one.reset()

    def stepped_raw(self, seconds: float) -> Block | None:
        if self._make_raw is None:
            return None
        if self._raw is None:
            self._raw = self._make_raw(self._one, self.num_envs)
        calls, taken = repeated(self._raw.step, seconds)
        return Block(calls * self.num_envs, taken)

    def draw(self) -> None:
        if self._drawn is None:
            self._drawn = self._make_drawn() if self._make_drawn else self._one
            self._drawn.reset(seed=1)
        self._drawn.render()

    def close(self) -> None:
        if self._many is not None:
            self._many.close()
        self._one.close()


class RawMujoco(Raw):
    """MuJoCo's own stepping of an environment's model, from states and with commands that random actions led to.

    Each step starts from the state in which a step of the environment began, and holds the commands that it ended with:
    the motions are the environment's, and nothing is read back.

    Args:
        environment: is stepped to collect the states.
        model: ``mujoco.MjModel`` of the environment.
        data: ``mujoco.MjData`` of the environment.
        decimation: physics steps of an environment's step.
        copies: number of environments.
    """

    def __init__(self, environment: gymnasium.Env, model: Any, data: Any, decimation: int, copies: int) -> None:
        import mujoco

        self._mujoco, self._model, self._decimation, self._copies = mujoco, model, decimation, copies
        kinds = mujoco.mjtState
        self._commands = int(kinds.mjSTATE_USER)
        starts, ends = int(kinds.mjSTATE_FULLPHYSICS), []
        self._states = np.empty((_SNAPSHOTS, mujoco.mj_stateSize(model, starts)))
        self._whole = int(kinds.mjSTATE_INTEGRATION)
        wholes = np.empty((_SNAPSHOTS, mujoco.mj_stateSize(model, self._whole)))
        ends = np.empty((_SNAPSHOTS, mujoco.mj_stateSize(model, self._commands)))
        random, space = np.random.default_rng(1), environment.action_space
        environment.reset(seed=1)
        for index in range(_SNAPSHOTS):
            mujoco.mj_getState(model, data, self._states[index], starts)
            mujoco.mj_getState(model, data, wholes[index], self._whole)
            action = random.uniform(space.low, space.high).astype(space.dtype)
            _, _, terminated, truncated, _ = environment.step(action)
            mujoco.mj_getState(model, data, ends[index], self._commands)
            if terminated or truncated:
                environment.reset()
        self._wholes, self._ends, self._next = wholes, ends, 0
        # Separate data: the environment's own must not be changed under its wrappers.
        self._data = [mujoco.MjData(model) for _ in range(os.cpu_count() or 1 if copies > 1 else 1)]

    def step(self) -> None:
        mujoco, first = self._mujoco, self._next
        self._next = (first + self._copies) % (_SNAPSHOTS - self._copies)
        if self._copies == 1:
            data = self._data[0]
            mujoco.mj_setState(self._model, data, self._wholes[first], self._whole)
            mujoco.mj_setState(self._model, data, self._ends[first], self._commands)
            mujoco.mj_step(self._model, data, self._decimation)
            return
        from mujoco import rollout

        rows = slice(first, first + self._copies)
        rollout.rollout(
            self._model, self._data, self._states[rows], self._ends[rows, None], control_spec=self._commands,
            nstep=self._decimation, persistent_pool=True,
        )  # fmt: skip


def mujoco_facts(model: Any, decimation: int, action_size: int) -> Facts:
    """Return the properties of an environment of a MuJoCo model.

    Args:
        model: ``mujoco.MjModel``.
        decimation: physics steps of an environment's step.
        action_size: components of its action.
    """
    import mujoco

    integrators = {int(kind): kind.name.removeprefix("mjINT_") for kind in mujoco.mjtIntegrator.__members__.values()}
    return Facts(
        engine=f"MuJoCo {mujoco.__version__}, {integrators[int(model.opt.integrator)]}",
        physics_dt=float(model.opt.timestep),
        decimation=decimation,
        action_size=action_size,
        degrees_of_freedom=int(model.nv),
    )
