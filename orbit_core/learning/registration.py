"""Gives every task a Gymnasium id, ``orbit/<Task>-v0``. Loaded when gymnasium is imported, so it imports little."""

from __future__ import annotations


def register() -> None:
    """Entry point of the group ``gymnasium.envs``: register all tasks with Gymnasium."""
    import gymnasium

    from orbit_core.tasks.registry import task_entries

    for name in task_entries():
        gymnasium.register(
            id=f"orbit/{name}-v0",
            entry_point="orbit_core.learning.gymnasium:SingleEnvironment",
            vector_entry_point="orbit_core.learning.gymnasium:VectorEnvironment",
            kwargs={"task": name},
            # The environment holds the time limit itself, checks its own input, and returns tensors of its own device.
            max_episode_steps=None,
        )
