"""Phase of a task's scripted expert as an observation, for policies that clone an expert whose phases end after a time.

A policy that leads is in the phase that the expert would be in: the same rules of distances, times and repetitions,
applied to the states that the policy reaches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, fields, make_dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import torch
from torch import Tensor

from orbit_core.envs.terms import Meaning, ObservationGroup, ObservationTerm
from orbit_core.interfaces import ConfigurationError

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment
    from orbit_core.envs.task import Task

EXPERT_PHASE = "expert_phase"
"""Name of the observation term."""


@runtime_checkable
class PhasedExpert(Protocol):
    """A scripted expert that passes through numbered phases."""

    phase: Tensor
    """(N,) int64, number of the present phase of each environment."""
    phase_count: int
    """Number of phases."""
    timed_phases: Sequence[int]
    """Numbers of the phases that end after a time, which no observation of the state shows."""

    def follow(self, rows: Tensor) -> None:
        """Advance the phases of the environments in ``rows`` (N,) bool by one step, whoever acts.

        Raises:
            ConfigurationError: phases follow from something that only the acting expert does.
        """
        ...


class _FollowedPhase:
    """Function of the term: (N, P), one for the phase that holds in this step, else zero."""

    def __init__(self) -> None:
        self._expert: PhasedExpert | None = None

    def __deepcopy__(self, memo: object) -> _FollowedPhase:
        # A copied task is for another environment, whose expert is another.
        return _FollowedPhase()

    def __call__(self, env: Environment) -> Tensor:
        expert = self._expert or self._begin(env)
        step = env.state.episode_step
        begun = step == 0
        # An observation is computed several times in a step that ends episodes, and the phases advance once.
        fresh = begun | (step != self._step)
        self._step.copy_(step)
        self._shown.copy_(torch.where(begun, 0, torch.where(fresh, expert.phase, self._shown)))
        expert.follow(fresh)
        # Compared, because one_hot reads its argument and a captured step must not.
        return (self._shown[:, None] == self._numbers).float()

    def _begin(self, env: Environment) -> PhasedExpert:
        """Make the expert at the first observation, when the world that it reads is complete."""
        expert = env.expert()
        if not isinstance(expert, PhasedExpert):
            raise ConfigurationError(
                f"task {type(env.task).__name__} has no expert that passes through phases: leave expert_phase out"
            )
        self._expert = expert
        self._shown = torch.zeros_like(expert.phase)
        self._numbers = torch.arange(expert.phase_count, device=env.device)
        self._step = torch.full_like(expert.phase, -1)
        return expert


def show_expert_phase(task: Task) -> None:
    """Add the expert's phase to what a task's policy sees.

    Args:
        task: changed in place, once for each environment.

    Raises:
        ConfigurationError: its observations have no group for a policy.
    """
    group = getattr(task.observations, "policy", None)
    if not isinstance(group, ObservationGroup):
        raise ConfigurationError(
            f"observations of task {type(task).__name__} have no group 'policy' that could show it"
        )
    meaning = Meaning("one for the phase that the task's scripted expert is in, zero for its others")
    term = ObservationTerm(_FollowedPhase(), bounds=(0.0, 1.0), unit="1", meaning=meaning)
    # Terms are the fields of a group's class, so that one more needs a class with one more field.
    own = (EXPERT_PHASE, ObservationTerm | None, field(default=None))
    extended = make_dataclass(type(group).__name__, [own], bases=(type(group),), kw_only=True)
    given = {each.name: getattr(group, each.name) for each in fields(group)}
    task.observations.policy = extended(**{**given, EXPERT_PHASE: term})
