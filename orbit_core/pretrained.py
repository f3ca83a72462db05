"""Kept policies by name. Any installed package may add its own through the entry-point group ``orbit.policies``.

An entry point names a package. Each folder in it that holds a file ``policy.toml`` is a policy of that folder's name;
beside the file lies what ``orbit train`` wrote, of which the last ``policy_<iteration>.safetensors`` counts. The
file holds the fields of :class:`PretrainedPolicy`::

    description = "Opens a drawer to where it should be: Franka Panda, joint targets"
    least_success = 0.9

    [[gaps]]
    backend = "some_backend"
    least_success = 0.6
    reason = "its friction lets the bar slip out of the fingers"

Listing names imports nothing heavy.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.registry import Registry

GROUP = "orbit.policies"
ABOUT = "policy.toml"


@dataclass(frozen=True)
class TransferGap:
    """A backend on which a policy is known to succeed less often than it is held to elsewhere."""

    backend: str
    least_success: float
    """The rate that it is held to there, in [0, 1]."""
    reason: str
    """What differs there; or that it is not known, and what has been ruled out."""

    def __post_init__(self) -> None:
        _check_rate(self.least_success)


@dataclass(frozen=True)
class PretrainedPolicy:
    """A learned policy that a package brings, and what it is held to."""

    name: str
    folder: Path
    description: str
    """One line."""
    least_success: float
    """The success rate that it is held to, in [0, 1], wherever no gap says otherwise."""
    gaps: tuple[TransferGap, ...] = ()

    def __post_init__(self) -> None:
        _check_rate(self.least_success)

    def gap_on(self, backend: str) -> TransferGap | None:
        """What is declared of a backend."""
        return next((gap for gap in self.gaps if gap.backend == backend), None)


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
    return Path(name) if Path(name).exists() else pretrained_policy(str(name)).folder


def _read(about: Path) -> PretrainedPolicy:
    try:
        values: dict[str, Any] = tomllib.loads(about.read_text(encoding="utf-8"))
        gaps = tuple(TransferGap(**gap) for gap in values.pop("gaps", ()))
        return PretrainedPolicy(name=about.parent.name, folder=about.parent, gaps=gaps, **values)
    except (ValueError, TypeError) as error:
        raise ConfigurationError(f"{about} describes no policy: {error}") from error


def _check_rate(rate: float) -> None:
    if not 0.0 <= rate <= 1.0:
        raise ValueError(f"least_success is a rate in [0, 1], not {rate!r}")
