"""An environment is made from its task's name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from orbit_core.envs.configuration import configure
from orbit_core.envs.environment import Environment
from orbit_core.envs.registry import task_entry
from orbit_core.envs.task import Task
from orbit_core.interfaces import ConfigurationError
from orbit_core.world import WorldFactory


def make(
    task: str | Task,
    num_envs: int = 1,
    backend: str | None = None,
    device: str | torch.device = "cpu",
    seed: int = 0,
    renderer: str | None = None,
    settings: Mapping[str, Any] | None = None,
    renderer_settings: Mapping[str, Any] | None = None,
    compile: bool = False,
    check_finite: bool = False,
    world: WorldFactory | None = None,
    matter: str | None = None,
    matter_settings: Mapping[str, Any] | None = None,
    reset_diverged: bool = False,
    capture: bool = True,
    autoreset: bool = True,
    **fields: Any,
) -> Environment:
    """The environment of a task, given by name or configured; ``fields`` set the task's own, such as ``robot``.

    Raises:
        UnknownNameError: no such task, field, robot, action space, preset of observations or backend.
    """
    if isinstance(task, str):
        task = configure(task_entry(task).task_type(), fields)
    elif fields:
        raise ConfigurationError(f"set {', '.join(fields)} on the task itself: it is given configured")
    common = (
        device,
        seed,
        renderer,
        settings,
        renderer_settings,
        compile,
        check_finite,
        world,
        matter,
        matter_settings,
        reset_diverged,
        capture,
        autoreset,
    )
    return Environment(task, num_envs, backend, *common)
