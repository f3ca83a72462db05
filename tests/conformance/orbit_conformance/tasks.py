"""Whole tasks: the same seeds and the same scripted agent on every backend."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orbit_conformance.episodes import FirstEpisodes, TaskResult
from orbit_conformance.recording import Recording
from orbit_conformance.verdict import Divergence, divergence
from orbit_core.envs.actors import ExpertActor


def run_task(
    task: str,
    backend: str,
    *,
    num_envs: int = 32,
    seed: int = 0,
    fields: Mapping[str, Any] | None = None,
    recording: Path | str | None = None,
    tracked_envs: int = 8,
    device: str = "cpu",
    settings: Mapping[str, Any] | None = None,
) -> TaskResult:
    """One episode of a task's expert in each environment.

    Args:
        task: name of a registered task.
        backend: name of an installed backend.
        num_envs: episodes.
        seed: of the environments.
        fields: of the task, by name.
        recording: where to keep actions and trajectories, an ``.npz`` file for replays and
            :func:`compare_recordings`.
        tracked_envs: how many environments' trajectories to keep.
        device: where tensors live.
        settings: of the backend, by field name.

    Raises:
        UnsupportedCapabilityError: the backend lacks what the task needs.
    """
    with FirstEpisodes(task, backend, num_envs, seed, fields or {}, device, settings) as episodes:
        episodes.run(ExpertActor(episodes.environment, seed), tracked_envs)
        if recording is not None:
            episodes.recording().save(recording)
        return episodes.result()


def compare_recordings(recording: Path | str, reference: Path | str) -> list[Divergence]:
    """Return the distance over time between the trajectories of two runs of one task.

    Raises:
        AssetError: a file is no recording.
        ConfigurationError: the runs are of different tasks, seeds or fields.
    """
    return divergence(Recording.load(recording), Recording.load(reference))
