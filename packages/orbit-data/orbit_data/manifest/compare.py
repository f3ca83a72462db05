"""Comparison of an environment with the one of data or a policy: every difference by its path, and its severity."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, Any

from orbit_core.interfaces import ConfigurationError
from orbit_data.manifest.manifest import Manifest
from orbit_data.manifest.plain import ROUNDED

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment

# Relative difference of numbers that counts as none: that of single precision.
_CLOSE = 1e-6


class Kind(Enum):
    """Severity of a difference."""

    ERROR = "error"
    """Numbers have another meaning: another order of joints, other terms, scales or rates."""
    WARNING = "warning"
    """The same numbers have other effects: other gains, limits, masses, gravity, matter."""
    NOTE = "note"
    """Another origin: the engine, versions, seeds, rewards and events of the task."""


# Patterns of paths, of which the first match counts.
_RULES: tuple[tuple[str, Kind], ...] = (
    (r"(action_terms|observations)(\..*)?\.(low|high)", Kind.WARNING),
    (r"(action_terms|observations)\..*\.(formula|frame|order|decoding|rate|clip|leads)", Kind.NOTE),
    (r"action_terms(\..*)?|observations(\..*)?|step_dt", Kind.ERROR),
    (r"robots\.[^.]*|robots\..*\.(joint_names|agent)", Kind.ERROR),
    (r"robots\..*|assets(\..*)?|gravity|physics_dt|decimation|matter|task", Kind.WARNING),
    (r".*", Kind.NOTE),
)


@dataclass(frozen=True)
class Difference:
    """Difference of one value."""

    kind: Kind
    path: str
    """Path within the manifest."""
    recorded: Any
    """Value in the manifest; None if it has none."""
    present: Any
    """Value of the environment; None if it has none."""

    def __str__(self) -> str:
        return f"{self.path} was {_shown(self.recorded)} and is {_shown(self.present)}"


def differences(recorded: Manifest, present: Manifest, groups: Collection[str] | None = None) -> list[Difference]:
    """Return all differences, the most severe first.

    Args:
        recorded: manifest of the data or policy.
        present: manifest of the environment.
        groups: observation groups that matter; all if None.
    """
    old, new = (_reduced(manifest.document(), groups) for manifest in (recorded, present))
    for name, group in old["observations"].items():
        if not group["concatenated"] and (other := new["observations"].get(name)):
            # A reader of a dictionary takes the terms that it knows, so that additional ones are no difference.
            other["terms"] = {term: other["terms"][term] for term in group["terms"] if term in other["terms"]}
    return sorted(_differences(old, new, ""), key=lambda difference: [*Kind].index(difference.kind))


def check_manifest(
    recorded: Manifest, environment: Environment, what: str, groups: Collection[str] | None = None
) -> list[Difference]:
    """Compare an environment with a manifest, warn of other effects, and return all differences.

    Args:
        recorded: manifest of the data or policy.
        environment: environment in which it will be used.
        what: the data or policy, for messages.
        groups: observation groups that matter; all if None.

    Raises:
        ConfigurationError: numbers would have another meaning; the message names every such difference.
    """
    found = differences(recorded, Manifest.of(environment, recorded.task, recorded.seed), groups)
    errors = [str(difference) for difference in found if difference.kind is Kind.ERROR]
    if errors:
        raise ConfigurationError(f"{what} does not fit this environment: {'; '.join(errors)}")
    graver = [str(difference) for difference in found if difference.kind is Kind.WARNING]
    if graver:
        warnings.warn(f"{what} was made with other settings: {'; '.join(graver)}", stacklevel=2)
    return found


def renamed_group(manifest: Manifest, name: str, other: str) -> Manifest:
    """Return a manifest with an observation group renamed, for environments with the same terms in another group."""
    groups = {other if group == name else group: terms for group, terms in manifest.observations.items()}
    return replace(manifest, observations=groups)


def _reduced(document: dict[str, Any], groups: Collection[str] | None) -> dict[str, Any]:
    if groups is not None:
        document["observations"] = {n: group for n, group in document["observations"].items() if n in groups}
    return document


def _differences(old: Any, new: Any, path: str) -> Iterator[Difference]:
    """Yield the differences below a path; lists, the order of terms and values of one side count as one difference."""
    if not (isinstance(old, dict) and isinstance(new, dict)):
        if not _same(old, new):
            yield Difference(_kind(path) if _comparable(path, old, new) else Kind.NOTE, path, old, new)
        return
    ordered = path == "action_terms" or path.endswith(".terms")
    if ordered and old.keys() == new.keys() and [*old] != [*new]:
        yield Difference(_kind(path), f"{path}, in order,", ", ".join(old), ", ".join(new))
    for key in dict.fromkeys((*old, *new)):
        yield from _differences(old.get(key), new.get(key), f"{path}.{key}" if path else key)


def _same(old: Any, new: Any) -> bool:
    if isinstance(old, list | tuple) and isinstance(new, list | tuple):
        return len(old) == len(new) and all(map(_same, old, new))
    if isinstance(old, float) and isinstance(new, int | float):
        return math.isclose(old, new, rel_tol=_CLOSE, abs_tol=_CLOSE)
    return old == new


def _comparable(path: str, old: Any, new: Any) -> bool:
    """Return whether two values can be compared: not fields that old manifests lack, nor digests of different kinds."""
    if re.fullmatch(r"observations\..*\.(components|offset)", path) and not old:
        return False
    # Old digests are of every bit, new ones (ROUNDED) of nine significant digits: they differ for equal assets.
    digests = path.startswith("assets.") and isinstance(old, str) and isinstance(new, str)
    return not digests or old.startswith(ROUNDED) == new.startswith(ROUNDED)


def _kind(path: str) -> Kind:
    return next(kind for pattern, kind in _RULES if re.fullmatch(pattern, path))


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return "there"
    if isinstance(value, list | tuple):
        value = ", ".join(_shown(item) for item in value)
    text = f"{value:g}" if isinstance(value, float) else "absent" if value is None else str(value)
    return text if len(text) <= 120 else f"{text[:117]}..."
