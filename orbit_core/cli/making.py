"""An environment is made from a command's settings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbit_core.backends import backend, default_backend, renderer
from orbit_core.cli.settings import EnvironmentSettings
from orbit_core.configuration import assignments
from orbit_core.distributions import missing_note
from orbit_core.envs.registry import task_entries, task_entry
from orbit_core.interfaces.errors import ConfigurationError

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


def make_environment(settings: EnvironmentSettings, num_envs: int, reset_diverged: bool = False) -> Environment:
    """The environment that the settings ask for; of ``reset_diverged`` tells Environment.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    if settings.task is None:
        names = ", ".join(sorted(task_entries())) or f"none is installed; {missing_note('orbit.tasks')}"
        raise ConfigurationError(f"name a task: {names}")
    entry = task_entry(settings.task)
    name = settings.backend or default_backend()
    backend(name)  # an unknown name is worth knowing before the task is built
    drawing = renderer(settings.renderer or name)
    import torch

    from orbit_core.envs.configuration import configure
    from orbit_core.envs.making import make

    try:
        device = torch.device(settings.device)
    except RuntimeError:
        raise ConfigurationError(
            f"device '{settings.device}' is no torch device: use 'cpu', 'cuda' or 'cuda:0'"
        ) from None
    if device.type == "cpu":
        # The layer's tensors are small: more threads gain nothing at 64 environments, and where the engine's own
        # threads or other programs hold the cores, waiting for each other makes them several times slower.
        torch.set_num_threads(1)
    owners = f"task {entry.name}", f"backend '{name}'", f"renderer '{drawing.name}'"
    fields = {**settings.fields, **assignments(settings.set, owners[0])}
    own = {**settings.settings, **assignments(settings.setting, owners[1], "setting")}
    looks = {**settings.renderer_settings, **assignments(settings.renderer_setting, owners[2], "setting")}
    chosen = {"robot": settings.robot, "action": settings.action}
    fields.update({key: value for key, value in chosen.items() if value is not None})
    own_matter = assignments(settings.matter_setting, "the matter solver", "setting")
    matter = {"matter": settings.matter, "matter_settings": {**settings.matter_settings, **own_matter}}
    common = (settings.seed, settings.renderer, own, looks, settings.compile, settings.check_finite)
    task = configure(entry.task_type(), fields)  # a field may bear the name of an argument of make
    capture = settings.capture
    return make(task, num_envs, name, device, *common, **matter, reset_diverged=reset_diverged, capture=capture)
