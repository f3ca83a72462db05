"""Kept policies by name. Any installed package may add its own through the entry-point group ``orbit.policies``.

An entry point names a package. Each folder in it that holds a file ``policy.toml`` is a policy of that folder's name;
beside the file lies what ``orbit train`` wrote, of which the last ``policy_<iteration>.safetensors`` counts. The
file holds the fields of :class:`PretrainedPolicy`::

    description = "Opens a drawer to where it should be: Franka Panda, joint targets"
    least_success = 0.9

    [fields]
    observations = "pixels"

    [[gaps]]
    backend = "some_backend"
    least_success = 0.6
    reason = "its friction lets the bar slip out of the fingers"

    [[gaps]]
    renderer = "some_renderer"
    least_success = 0.3
    reason = "it draws no depth beyond a metre"

Listing names imports nothing heavy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from orbit_core.configuration import TypeChecker, read_toml
from orbit_core.files import as_path
from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.registry import Registry

GROUP = "orbit.policies"
ABOUT = "policy.toml"


@dataclass(frozen=True, kw_only=True)
class TransferGap:
    """A backend, a renderer or both on which a policy is known to succeed less often than it is held to elsewhere."""

    backend: str | None = None
    """Backend that simulates; any if None."""
    renderer: str | None = None
    """Renderer that draws what the policy sees, be it another's or the backend's own; any if None."""
    least_success: float
    """The rate that it is held to there, in [0, 1]."""
    reason: str
    """What differs there; or that it is not known, and what has been ruled out."""

    def __post_init__(self) -> None:
        _check_rate(self.least_success)
        if self.backend is None and self.renderer is None:
            raise ValueError("a gap names a backend, a renderer or both")

    def holds_for(self, backend: str, renderer: str) -> bool:
        """Whether it is of that backend and that renderer."""
        return self.backend in (None, backend) and self.renderer in (None, renderer)


@dataclass(frozen=True)
class PretrainedPolicy:
    """A learned policy that a package brings, and what it is held to."""

    name: str
    folder: Path
    description: str
    """One line."""
    least_success: float
    """The success rate that it is held to, in [0, 1], wherever no gap says otherwise."""
    fields: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the task that differed from their defaults in learning, but robot and action."""
    gaps: tuple[TransferGap, ...] = ()

    def __post_init__(self) -> None:
        _check_rate(self.least_success)
        if not isinstance(self.fields, Mapping):
            raise ValueError(f"fields is a table of the task's fields, not {self.fields!r}")

    def gap_on(self, backend: str, renderer: str | None = None) -> TransferGap | None:
        """What is declared of a backend that draws itself, or of it and a renderer: the first gap that holds."""
        return next((gap for gap in self.gaps if gap.holds_for(backend, renderer or backend)), None)


@cache
def _installed() -> Registry[PretrainedPolicy]:
    def read(package: ModuleType) -> None:
        for folder in package.__path__:
            for about in sorted(Path(folder).glob(f"*/{ABOUT}")):
                registry.add(about.parent.name, _read(about))

    registry = Registry[PretrainedPolicy]("policy", GROUP, read)
    return registry


def pretrained_policies() -> dict[str, PretrainedPolicy]:
    """All that installed packages bring, by name, sorted; those of broken packages left out."""
    return dict(sorted(_installed().values.items()))


def pretrained_policy(name: str) -> PretrainedPolicy:
    """The kept policy of that name.

    Raises:
        UnknownNameError: there is none.
        ConfigurationError: two packages bring it.
    """
    return _installed().get(name)


def policy_path(name: str | Path) -> Path:
    """The file or folder at that path, if there is one, else the folder of the kept policy of that name.

    Raises:
        UnknownNameError: there is neither.
    """
    path = as_path(name)
    return path if path.exists() else pretrained_policy(str(name)).folder


def policy_fields(name: str | Path) -> Mapping[str, Any]:
    """The fields of the task that a policy must be given, as the file ``policy.toml`` beside it says; none without one.

    Raises:
        UnknownNameError: there is no such file, folder or kept policy.
        ConfigurationError: the file ``policy.toml`` describes no policy.
    """
    path = policy_path(name)
    return _read(_about(path)).fields if is_kept(path) else {}


def is_kept(path: Path) -> bool:
    """Return True if a policy's file or folder has a file ``policy.toml``, which says what it is played with."""
    return _about(path).exists()


def _about(path: Path) -> Path:
    return (path if path.is_dir() else path.parent) / ABOUT


def _read(about: Path) -> PretrainedPolicy:
    try:
        values = read_toml(about, "description")
        gaps = tuple(TransferGap(**gap) for gap in values.pop("gaps", ()))
        policy = PretrainedPolicy(name=about.parent.name, folder=about.parent, gaps=gaps, **values)
        TypeChecker().check(policy, "it")
        return policy
    except (ValueError, TypeError, RecursionError, ConfigurationError) as error:
        raise ConfigurationError(f"{about} describes no policy: {error}") from error


def _check_rate(rate: float) -> None:
    if not 0.0 <= rate <= 1.0:
        raise ValueError(f"least_success is a rate in [0, 1], not {rate!r}")
