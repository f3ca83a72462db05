"""Kept policies by name. Any installed package can add its own by the entry-point group ``orbit.policies``.

An entry point names a package. Each folder in it with a file ``policy.toml`` is a policy with that folder's name; the
files of ``orbit train`` are next to it, of which the last ``policy_<iteration>.safetensors`` counts. ``policy.toml``
has the fields of :class:`PretrainedPolicy`::

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

Listing names imports no heavy modules.
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
    """Backend, renderer or both on which a policy is known to succeed less often than elsewhere."""

    backend: str | None = None
    """Backend that simulates; any if None."""
    renderer: str | None = None
    """Renderer of the policy's pictures, which may be the backend itself; any if None."""
    least_success: float
    """Success rate that the policy must reach there, in [0, 1]."""
    reason: str
    """Difference that is the cause; or, if it is unknown, the causes that were ruled out."""

    def __post_init__(self) -> None:
        _check_rate(self.least_success)
        if self.backend is None and self.renderer is None:
            raise ValueError("a gap names a backend, a renderer or both")

    def holds_for(self, backend: str, renderer: str) -> bool:
        """Return whether the gap applies to a backend and a renderer."""
        return self.backend in (None, backend) and self.renderer in (None, renderer)


@dataclass(frozen=True)
class PretrainedPolicy:
    """Learned policy of a package, and the success rate that it must reach."""

    name: str
    """Name for ``orbit run --policy``."""
    folder: Path
    """Folder of the policy's files."""
    description: str
    """Description in one line."""
    least_success: float
    """Success rate that the policy must reach, in [0, 1], where no gap applies."""
    fields: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the task that differed from their defaults in learning, except robot and action."""
    gaps: tuple[TransferGap, ...] = ()
    """Backends and renderers on which it is known to succeed less often."""

    def __post_init__(self) -> None:
        _check_rate(self.least_success)
        if not isinstance(self.fields, Mapping):
            raise ValueError(f"fields is a table of the task's fields, not {self.fields!r}")

    def gap_on(self, backend: str, renderer: str | None = None) -> TransferGap | None:
        """Return the first gap that applies to a backend with a renderer (its own if None); None if none applies."""
        return next((gap for gap in self.gaps if gap.holds_for(backend, renderer or backend)), None)


@cache
def _installed() -> Registry[PretrainedPolicy]:
    def read(package: ModuleType) -> None:
        # A namespace package can have several folders.
        for folder in package.__path__:
            for about in sorted(Path(folder).glob(f"*/{ABOUT}")):
                registry.add(about.parent.name, _read(about))

    registry = Registry[PretrainedPolicy]("policy", GROUP, read)
    return registry


def pretrained_policies() -> dict[str, PretrainedPolicy]:
    """Return the policies of all installed packages, sorted by name, without those of broken packages."""
    return dict(sorted(_installed().values.items()))


def pretrained_policy(name: str) -> PretrainedPolicy:
    """Return the kept policy with a name.

    Raises:
        UnknownNameError: no policy has the name.
        ConfigurationError: two packages have a policy with the name.
    """
    return _installed().get(name)


def policy_path(name: str | Path) -> Path:
    """Return the file or folder at a path if it exists, else the folder of the kept policy with that name.

    Raises:
        UnknownNameError: neither exists.
    """
    path = as_path(name)
    # Files win over names: a person's own policy may have the name of a kept one.
    return path if path.exists() else pretrained_policy(str(name)).folder


def policy_fields(name: str | Path) -> Mapping[str, Any]:
    """Return the fields of the task that a policy needs, from its ``policy.toml``; empty without that file.

    Raises:
        UnknownNameError: the file, folder or kept policy does not exist.
        ConfigurationError: ``policy.toml`` is invalid.
    """
    path = policy_path(name)
    return _read(_about(path)).fields if is_kept(path) else {}


def is_kept(path: Path) -> bool:
    """Return True if a policy's file or folder has a file ``policy.toml``, which states how it is played."""
    return _about(path).exists()


def _about(path: Path) -> Path:
    return (path if path.is_dir() else path.parent) / ABOUT


def _read(about: Path) -> PretrainedPolicy:
    try:
        values = read_toml(about, "description")
        gaps = tuple(TransferGap(**gap) for gap in values.pop("gaps", ()))
        policy = PretrainedPolicy(name=about.parent.name, folder=about.parent, gaps=gaps, **values)
        TypeChecker().check(policy, "it")  # TOML has types, but any of them in any field
        return policy
    except (ValueError, TypeError, RecursionError, ConfigurationError) as error:
        raise ConfigurationError(f"{about} describes no policy: {error}") from error


def _check_rate(rate: float) -> None:
    if not 0.0 <= rate <= 1.0:
        raise ValueError(f"least_success is a rate in [0, 1], not {rate!r}")
