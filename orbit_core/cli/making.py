"""Environments and actors from a command's settings."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Protocol

from orbit_core.backends import backend, default_backend, renderer
from orbit_core.cli.settings import EnvironmentSettings
from orbit_core.configuration import assignments
from orbit_core.distributions import missing_note
from orbit_core.envs.actors import ACTORS, scripted_actor
from orbit_core.envs.registry import TaskEntry, task_entries, task_entry
from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError
from orbit_core.registry import Registry

if TYPE_CHECKING:
    from orbit_core.envs.actors import Actor
    from orbit_core.envs.environment import Environment
    from orbit_core.envs.task import Task


class ActorSource(Protocol):
    """A package's actors; the entry-point group ``orbit.actors`` names modules or objects with these functions."""

    def names(self) -> Iterable[str]:
        """Return the names of all actors that are listed."""
        ...

    def has(self, name: str) -> bool:
        """Return whether a name, or the path of a file or folder, is one of these actors."""
        ...

    def make(self, name: str, environment: Environment, seed: int) -> Actor:
        """Return the actor of that name or path.

        Raises:
            ConfigurationError: it acts in another environment.
        """
        ...

    def digest(self, name: str) -> str:
        """Return the SHA-256 of what the actor was learned as; empty for one that is no file."""
        ...


def check_actor(name: str) -> None:
    """Reject a name that no actor has.

    Raises:
        UnknownNameError: there is none of that name.
    """
    if name not in ACTORS:
        _source(name)


def make_actor(name: str, environment: Environment, seed: int) -> Actor:
    """Return the actor of that name, the policy in that file or folder, or the kept policy of that name.

    Raises:
        UnknownNameError: there is none.
        ConfigurationError: the policy was learned for another environment.
    """
    return scripted_actor(name, environment, seed) if name in ACTORS else _source(name).make(name, environment, seed)


def actor_digest(name: str) -> str:
    """Return the SHA-256 of a policy's files; empty for actors that are no file."""
    return "" if name in ACTORS else _source(name).digest(name)


@functools.cache
def _sources() -> Registry[ActorSource]:
    return Registry[ActorSource]("source of actors", "orbit.actors")


def _source(name: str) -> ActorSource:
    """Return the package's source that has an actor of that name."""
    registry = _sources()
    sources = registry.values.values()
    for source in sources:
        if source.has(name):
            return source
    names = {*ACTORS, *(other for source in sources for other in source.names())}
    raise UnknownNameError("actor or policy", name, names, note=registry.note)


def make_environment(
    settings: EnvironmentSettings,
    num_envs: int,
    reset_diverged: bool = False,
    change: Callable[[Task], None] | None = None,
) -> Environment:
    """Make the environment that the settings describe.

    Args:
        settings: of a command.
        num_envs: environments that are stepped together.
        reset_diverged: as of :class:`~orbit_core.envs.environment.Environment`.
        change: changes the configured task, beyond what settings can say.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    _entry(settings)
    name = settings.backend or default_backend()
    backend(name)  # an unknown name is worth knowing before the task is built
    drawing = renderer(settings.renderer or name)
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
    owners = f"backend '{name}'", f"renderer '{drawing.name}'"
    own = {**settings.settings, **assignments(settings.setting, owners[0], "setting")}
    looks = {**settings.renderer_settings, **assignments(settings.renderer_setting, owners[1], "setting")}
    own_matter = assignments(settings.matter_setting, "the matter solver", "setting")
    matter = {"matter": settings.matter, "matter_settings": {**settings.matter_settings, **own_matter}}
    common = (settings.seed, settings.renderer, own, looks, settings.compile, settings.check_finite)
    task = configured_task(settings)  # a field may bear the name of an argument of make
    if change is not None:
        change(task)
    capture = settings.capture
    return make(task, num_envs, name, device, *common, **matter, reset_diverged=reset_diverged, capture=capture)


def configured_task(settings: EnvironmentSettings) -> Task:
    """Return the task that the settings describe, without an environment of it.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    from orbit_core.envs.configuration import configure

    entry = _entry(settings)
    fields = {**settings.fields, **assignments(settings.set, f"task {entry.name}")}
    chosen = {"robot": settings.robot, "action": settings.action}
    fields.update({key: value for key, value in chosen.items() if value is not None})
    task = configure(entry.task_type(), fields)
    if settings.cameras:
        from orbit_core.mdp.sensing import with_cameras

        with_cameras(task, _camera_sizes(settings.cameras))
    return task


def _entry(settings: EnvironmentSettings) -> TaskEntry:
    if settings.task is None:
        names = ", ".join(sorted(task_entries())) or f"none is installed; {missing_note('orbit.tasks')}"
        raise ConfigurationError(f"name a task: {names}")
    return task_entry(settings.task)


def _camera_sizes(words: Iterable[str]) -> dict[str, tuple[int, int]]:
    """Return width and height of each camera's pictures.

    Raises:
        ConfigurationError: a word is no name and size, or a camera is named twice.
    """
    sizes: dict[str, tuple[int, int]] = {}
    for word in words:
        matched = re.fullmatch(r"([^:]+):(\d{1,5})x(\d{1,5})", word)
        if matched is None or matched[1] in sizes:
            raise ConfigurationError(
                f"a camera is its name and its pictures' width and height, each named once, such as front:84x84, not "
                f"'{word}'"
            )
        sizes[matched[1]] = int(matched[2]), int(matched[3])
    return sizes
