"""Registration of every task with Gymnasium, as ``orbit/<Task>-v0``."""

from __future__ import annotations

import gymnasium

from orbit_core.envs.registry import task_entries


def register() -> None:
    """Register all tasks with Gymnasium, each once."""
    for name in task_entries():
        identity = f"orbit/{name}-v0"
        # Gymnasium warns of a second registration, and imports may come in any order.
        if identity in gymnasium.registry:
            continue
        # No max_episode_steps: the environment holds the time limit itself.
        gymnasium.register(
            id=identity,
            entry_point="orbit_learn.gymnasium:SingleEnvironment",
            vector_entry_point="orbit_learn.gymnasium:VectorEnvironment",
            kwargs={"task": name},
        )
