"""From a command's settings to an environment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from orbit_core.backends import backend, default_backend
from orbit_core.cli.settings import EnvironmentSettings
from orbit_core.cli.values import defaults_of, overridden
from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.tasks.registry import task_entries, task_entry

if TYPE_CHECKING:
    from orbit_core.tasks.environment import Environment


def make_environment(settings: EnvironmentSettings, num_envs: int) -> Environment:
    """The environment that the settings ask for.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    if settings.task is None:
        raise ConfigurationError(f"name a task: {', '.join(sorted(task_entries()))}")
    entry = task_entry(settings.task)
    name = settings.backend or default_backend()
    plugin = backend(name)
    if settings.renderer is not None:
        backend(settings.renderer)  # an unknown name is worth knowing before the task is built
    import torch

    from orbit_core.tasks.environment import make

    try:
        device = torch.device(settings.device)
    except RuntimeError:
        raise ConfigurationError(
            f"device '{settings.device}' is no torch device: use 'cpu', 'cuda' or 'cuda:0'"
        ) from None
    fields = overridden(settings.fields, settings.set, defaults_of(entry.task_type()), "--set", f"task {entry.name}")
    chosen = {"robot": settings.robot, "action": settings.action}
    fields.update({key: value for key, value in chosen.items() if value is not None})
    own = overridden(
        settings.settings, settings.setting, defaults_of(plugin.config_type), "--setting", f"backend '{name}'"
    )
    return make(entry.name, num_envs, name, device, settings.seed, settings.renderer, own, **fields)


def check_output(path: Path | None, suffix: str) -> None:
    """Refuse a file that could not be written, before the work whose result it is to hold."""
    if path is None:
        return
    if path.suffix != suffix:
        raise ConfigurationError(f"the name of output file {path} must end in {suffix}")
    if not path.parent.is_dir():
        raise ConfigurationError(f"cannot write {path}: there is no folder {path.parent}")
    if path.is_dir():
        raise ConfigurationError(f"cannot write {path}: it is a folder")


def check_positive(name: str, value: int) -> None:
    """Refuse a number below one."""
    if value < 1:
        raise ConfigurationError(f"{name} must be at least 1, not {value}")
