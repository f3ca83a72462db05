"""Checks that every task is held to, and a task's declaration that one of them does not hold."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class TaskCheck(Enum):
    """A property of a task that ``orbit check-task`` measures."""

    EXPERT_BEATS_RANDOM = "expert beats random"
    """The expert's mean return is above that of uniformly random actions."""
    EXPERT_BEATS_ZERO = "expert beats zero"
    """The expert's mean return is above that of actions that are all zero."""
    VELOCITY_LIMITS = "velocity limits"
    """The expert's joints are within their velocity limits, but for a small share of samples."""
    EFFORT_LIMITS = "effort limits"
    """The efforts on the expert's joints are within their limits."""
    START_AREA = "start area"
    """Something begins its episodes at places that cover an area."""
    START_YAW = "start yaw"
    """Something begins its episodes turned by many angles about the vertical."""
    TRIVIAL_AGENTS = "trivial agents"
    """No agent that looks at nothing succeeds more often than a stated rate."""


@dataclass(frozen=True)
class TaskException:
    """A task's declaration that it does not meet a check.

    An exception that a measurement contradicts is stale, and fails as the check would; but that of velocity limits,
    which some engines enforce themselves.
    """

    check: TaskCheck
    reason: str
    """A sentence for the table of checked tasks."""
