"""Memory of a run: tensors per environment, which a task's terms read and write."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.envs.terms import CurriculumTerm
from orbit_core.interfaces import ConfigurationError

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


@dataclass(frozen=True)
class _Buffer:
    """Declaration of a tensor in the body of a :class:`TaskState`."""

    shape: tuple[int, ...]
    dtype: torch.dtype
    initial: float
    keep: bool


def buffer(*shape: int, dtype: torch.dtype = torch.float32, initial: float = 0.0, keep: bool = False) -> Any:
    """Declare a tensor (N, *shape) of a task's state.

    Args:
        shape: of one environment's value; without any, the tensor is (N,).
        dtype: of the tensor.
        initial: value that it has when the environment is made.
        keep: if True, a reset leaves the value; else it is ``initial`` again in the environments that begin an episode.
    """
    return _Buffer(shape, dtype, initial, keep)


class TaskState:
    """Memory of a run, the only one that a task has: sums, counters, and what is looked up once in a new world.

    Derive from it, declare tensors with :func:`buffer`, and name the class in :attr:`Task.state_type`::

        class WalkState(TaskState):
            errors: Tensor = buffer(2)

    Terms write tensors in place, ``env.state.errors += ...`` or ``env.state.errors[env_ids] = ...``: a captured step
    repeats operations on the tensors that were there when it was captured.
    """

    last_action: Tensor
    """(N, A) the action in effect; zero after a reset."""
    action_before: Tensor
    """(N, A) the action of the step before that."""
    episode_step: Tensor = buffer(dtype=torch.int64)
    """(N,) steps since reset."""
    difficulty: Tensor = buffer(initial=1.0, keep=True)
    """(N,) in [0, 1], for terms to read. It starts at 0 where the curriculum is enabled and has a
    :class:`~orbit_core.envs.CurriculumTerm`, and else stays 1; resets do not change it."""

    def __init__(self, env: Environment) -> None:
        self._locked = False
        self._device = env.device
        self._declared = {
            name: value
            for kind in reversed(type(self).__mro__)
            for name, value in vars(kind).items()
            if isinstance(value, _Buffer)
        }
        for name, declared in self._declared.items():
            size = (env.num_envs, *declared.shape)
            setattr(self, name, torch.full(size, declared.initial, dtype=declared.dtype, device=env.device))
        self.last_action = torch.zeros(env.num_envs, env.action_size, device=env.device)
        self.action_before = torch.zeros_like(self.last_action)
        curriculum = () if env.task.curriculum is None else vars(env.task.curriculum).values()
        if env.task.curriculum_enabled and any(isinstance(term, CurriculumTerm) for term in curriculum):
            self.difficulty.zero_()

    def start(self, env: Any) -> None:
        """Look things up in a new world, such as the index of a joint. Override where a task needs some."""

    def update(self, env: Any) -> None:
        """Accumulate, after each step of the world and before commands and rewards. Override where a task sums up."""

    def reset(self, env_ids: Tensor | None) -> None:
        """Set declared tensors to their initial values in some environments, by index, by mask, or in all if None."""
        for name, declared in self._declared.items():
            if not declared.keep:
                write_rows(getattr(self, name), declared.initial, env_ids)
        write_rows(self.last_action, 0.0, env_ids)

    def memory(self) -> dict[str, Any]:
        """All attributes by name, tensors or collections that hold some."""
        return {name: value for name, value in vars(self).items() if not name.startswith("_")}

    def lock(self) -> None:
        """Refuse attributes that are set from now on: the tensors are there, and are written in place."""
        self._locked = True

    def __setattr__(self, name: str, value: object) -> None:
        before = vars(self).get(name)
        if name in vars(self).get("_declared", ()) and not isinstance(value, Tensor):
            raise ConfigurationError(
                f"state '{name}' of {type(self).__name__} is a tensor, and was set to {value!r:.60}: write the tensor "
                f"in place, env.state.{name}[:] = ..."
            )
        if vars(self).get("_locked") and before is not value:
            if isinstance(before, Tensor):
                raise ConfigurationError(
                    f"state '{name}' of {type(self).__name__} was replaced by another object, which a captured step "
                    f"would not see: write the tensor in place, env.state.{name}[:] = ... or "
                    f"env.state.{name}.copy_(...)"
                )
            raise ConfigurationError(
                f"state '{name}' of {type(self).__name__} was set to {value!r:.60} while the environment runs, and a "
                f"captured step would freeze plain Python: declare a tensor, {name}: Tensor = buffer(), and write it "
                "in place; or make the environment with capture=False (--no-capture)"
            )
        object.__setattr__(self, name, value)
