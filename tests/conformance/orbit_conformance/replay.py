"""Actions recorded on one backend and repeated open loop on another: how much of the success depends on the engine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orbit_conformance.episodes import FirstEpisodes, TaskResult
from orbit_conformance.recording import RecordedActions, Recording
from orbit_conformance.verdict import Divergence, divergence


@dataclass(frozen=True)
class ReplayResult:
    """The outcome of actions recorded on one backend and repeated open loop on another."""

    recorded_on: str
    """Name of the backend that recorded the actions."""
    result: TaskResult
    """Success and metrics of the repeated episodes."""
    divergence: list[Divergence]
    """Divergence from the recorded trajectories."""


def replay(
    recording: Path | str,
    backend: str,
    *,
    replayed: Path | str | None = None,
    device: str = "cpu",
    settings: Mapping[str, Any] | None = None,
) -> ReplayResult:
    """Take the recorded actions again, open loop, from the same initial states.

    Where an episode lasts longer than the recorded one did, its last action is held.

    Args:
        recording: what :func:`run_task` kept.
        backend: name of an installed backend.
        replayed: where to keep the replay's own trajectories.
        device: where tensors live.
        settings: of the backend, by field name.

    Raises:
        AssetError: the file is no recording.
        UnsupportedCapabilityError: the backend lacks what the task needs.
    """
    kept = Recording.load(recording)
    num_envs, tracked = kept.actions.shape[1], next(iter(kept.tracks.values())).shape[1]
    with FirstEpisodes(kept.task, backend, num_envs, kept.seed, kept.fields, device, settings) as episodes:
        episodes.run(RecordedActions(kept, episodes.environment.device), tracked)
        own = episodes.recording()
        if replayed is not None:
            own.save(replayed)
        return ReplayResult(kept.backend, episodes.result(), divergence(own, kept))
