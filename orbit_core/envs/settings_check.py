"""Settings of an environment that cannot be, refused before anything is simulated."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from orbit_core.dynamics.arguments import MOST_STEPS, whole_number
from orbit_core.envs.task import Task
from orbit_core.envs.terms import CurriculumTerm, ModifyTerm, terms_of
from orbit_core.interfaces import ConfigurationError

# Steps of an episode; step counters have 64 bits, and libraries keep them in 32.
_LONGEST_EPISODE = 2**31 - 1


def check_no_backend(given: Mapping[str, object]) -> None:
    """Refuse settings of a backend, by name, where a world is given.

    Raises:
        ConfigurationError: one of them is not None.
    """
    named = [name for name, value in given.items() if value is not None]
    if named:
        raise ConfigurationError(
            f"{' and '.join(named)} given beside a world of your own: only what is simulated has any; leave one out"
        )


def curriculum_of(task: Task) -> dict[str, CurriculumTerm]:
    """Terms of the task's curriculum; empty where it is not enabled.

    Raises:
        ConfigurationError: it is enabled, and the task has none.
    """
    if not task.curriculum_enabled:
        return {}
    if task.curriculum is None:
        raise ConfigurationError(
            f"task {type(task).__name__} has no curriculum: leave curriculum_enabled out, or give it a dataclass of "
            "CurriculumTerm or ModifyTerm"
        )
    return {n: term for n, term in _curriculum_terms(task).items() if isinstance(term, CurriculumTerm)}


def modifiers_of(task: Task) -> dict[str, ModifyTerm]:
    """Terms of the task's curriculum that change its configuration; empty where it is not enabled."""
    if not task.curriculum_enabled:
        return {}
    return {n: term for n, term in _curriculum_terms(task).items() if isinstance(term, ModifyTerm)}


def _curriculum_terms(task: Task) -> dict[str, CurriculumTerm | ModifyTerm]:
    kinds: Any = CurriculumTerm | ModifyTerm
    return terms_of(task.curriculum, kinds)


def whole_steps(task: Task) -> int:
    """Steps of the environment in an episode.

    Raises:
        ConfigurationError: there is no whole number of them.
    """
    for name in ("physics_dt", "episode_length"):
        seconds = getattr(task, name)
        if not 0.0 < seconds < math.inf:
            raise ConfigurationError(f"{name} must be above zero seconds, not {seconds:g}")
    whole_number(task.decimation, "decimation", 1, MOST_STEPS)
    step_dt = task.physics_dt * task.decimation
    if not task.episode_length / step_dt <= _LONGEST_EPISODE:
        raise ConfigurationError(
            f"episode_length {task.episode_length:g} s has more than {_LONGEST_EPISODE:,} steps of {step_dt:g} s: "
            "give a shorter one"
        )
    steps = round(task.episode_length / step_dt)
    if steps < 1 or abs(steps * step_dt - task.episode_length) > 1e-6 * task.episode_length:
        raise ConfigurationError(
            f"episode_length {task.episode_length} s is no whole number of steps of {step_dt} s (physics_dt x "
            f"decimation): use {max(1, steps) * step_dt:g}"
        )
    return steps
