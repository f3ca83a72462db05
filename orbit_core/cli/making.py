"""From a command's settings to an environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from orbit_core.backends import backend, default_backend, renderer
from orbit_core.cli.settings import EnvironmentSettings
from orbit_core.cli.values import check_values, defaults_of, parse_values
from orbit_core.envs.registry import task_entries, task_entry
from orbit_core.interfaces.errors import ConfigurationError

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


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
    drawing = renderer(settings.renderer or name)  # an unknown name is worth knowing before the task is built
    import torch

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
    defaults = _task_defaults(entry.task_type())
    fields = _merged(settings, settings.fields, settings.set, defaults, "field", f"task {entry.name}")
    defaults = defaults_of(plugin.config_type)
    own = _merged(settings, settings.settings, settings.setting, defaults, "setting", f"backend '{name}'")
    looks = _merged(
        settings, settings.renderer_settings, settings.renderer_setting, defaults_of(drawing.config_type),
        "renderer_setting", f"renderer '{drawing.name}'",
    )  # fmt: skip
    chosen = {"robot": settings.robot, "action": settings.action}
    fields.update({key: value for key, value in chosen.items() if value is not None})
    common = (settings.seed, settings.renderer, own, looks, settings.compile, settings.check_finite)
    return make(entry.name, num_envs, name, device, *common, **fields)


def _task_defaults(task_type: type) -> dict[str, Any]:
    """Its plain fields, and the word that stands for its observations."""
    from orbit_core.envs.configuration import DEFAULT_PRESET, OBSERVATIONS

    return {**defaults_of(task_type), OBSERVATIONS: DEFAULT_PRESET}


def _merged(
    settings: EnvironmentSettings,
    from_file: Mapping[str, Any],
    pairs: Sequence[str],
    defaults: Mapping[str, Any],
    kind: str,
    owner: str,
) -> dict[str, Any]:
    """The command line's ``key=value`` over the file's table."""
    table = check_values(from_file, defaults, kind, f"{owner}, table [{kind}s] of {settings.config}")
    return {**table, **parse_values(pairs, defaults, kind.replace("_", " "), owner)}
