"""A short film of a task on a backend."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orbit_core.backends import backend, backend_names
from orbit_core.envs import make
from orbit_core.envs.actors import ExpertActor
from orbit_core.interfaces import Backend, Capability, Level, UnsupportedCapabilityError
from orbit_core.rollout.stepping import roll_out
from orbit_core.rollout.video import VideoRecorder

WIDTH, HEIGHT = 256, 192


def film(
    task: str, backend_name: str, path: Path, *, seconds: float, seed: int, device: str, settings: Mapping[str, Any]
) -> None:
    """Film the first environment of a task for some seconds, its expert acting, from the task's own view.

    A backend that draws nothing is drawn by another one, the same for all such.

    Raises:
        UnsupportedCapabilityError: nothing that is installed draws, or the backend lacks what the task needs.
    """
    environment = make(task, 1, backend_name, device, seed, renderer_for(backend(backend_name)), settings)
    try:
        expert = ExpertActor(environment, seed)
        environment.reset()
        steps = min(environment.max_episode_steps, round(seconds / environment.step_dt))
        with VideoRecorder(environment, path, 1, WIDTH, HEIGHT) as recorder:
            roll_out(environment, expert, (recorder,), max_steps=steps)
    finally:
        environment.close()


def renderer_for(simulating: Backend) -> str:
    """The backend itself if it draws, else the one that draws most exactly."""
    if simulating.capabilities().has(Capability.RGB):
        return simulating.name
    drawing = [name for name in backend_names() if backend(name).capabilities().has(Capability.RGB)]
    if not drawing:
        raise UnsupportedCapabilityError(
            f"backend '{simulating.name}' does not draw, and no other is installed that does"
        )
    images = (Capability.RGB, Capability.DEPTH, Capability.NORMALS, Capability.ALBEDO, Capability.SEGMENTATION)

    def exactness(name: str) -> int:
        return sum(backend(name).capabilities()[image].level is Level.EXACT for image in images)

    return max(drawing, key=exactness)
