"""Tasks: a scene, what is observed and rewarded in it, and the vectorised environment that runs it.

Names load on first use, so that listing tasks does not load the tensor library.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbit_core.exports import lazy_names

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment
    from orbit_core.envs.making import make
    from orbit_core.envs.off_policy import OffPolicySettings
    from orbit_core.envs.ppo import PpoSettings
    from orbit_core.envs.registry import TaskEntry, TaskRegistry, task_entries, task_entry
    from orbit_core.envs.state import TaskState, buffer
    from orbit_core.envs.task import Subtask, Task, TaskMetadata
    from orbit_core.envs.terms import (
        CommandTerm,
        CurriculumTerm,
        EventTerm,
        EventTime,
        ModifyTerm,
        ObservationGroup,
        ObservationTerm,
        PremiseTerm,
        RewardTerm,
        TerminationTerm,
        once_per_state,
    )

_MODULES: dict[str, tuple[str, ...]] = {
    "environment": ("Environment",),
    "making": ("make",),
    "off_policy": ("OffPolicySettings",),
    "ppo": ("PpoSettings",),
    "registry": ("TaskEntry", "TaskRegistry", "task_entries", "task_entry"),
    "state": ("TaskState", "buffer"),
    "task": ("Subtask", "Task", "TaskMetadata"),
    "terms": (
        "CommandTerm", "CurriculumTerm", "EventTerm", "EventTime", "ModifyTerm", "ObservationGroup",
        "ObservationTerm", "PremiseTerm", "RewardTerm", "TerminationTerm", "once_per_state",
    ),
}  # fmt: skip
__all__ = [
    "CommandTerm", "CurriculumTerm", "Environment", "EventTerm", "EventTime", "ModifyTerm",
    "ObservationGroup", "ObservationTerm", "OffPolicySettings", "PpoSettings", "PremiseTerm", "RewardTerm", "Subtask",
    "Task", "TaskEntry", "TaskMetadata", "TaskRegistry", "TaskState", "TerminationTerm", "buffer", "make",
    "once_per_state", "task_entries", "task_entry",
]  # fmt: skip

__getattr__, __dir__ = lazy_names(__name__, _MODULES)
