"""Every error that ORBIT raises on purpose: one clear sentence that names the culprit and the remedy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class OrbitError(Exception):
    """Base of all errors below; the command line prints its message alone, without a traceback."""


class ConfigurationError(OrbitError):
    """A setting that cannot be: a rate that does not divide, a field out of range, a malformed file."""


class UnknownNameError(OrbitError):
    """A name that nothing bears, with the nearest names that something does."""

    def __init__(self, kind: str, name: str, known: Iterable[str], where: str = "", note: str = "") -> None:
        known = sorted(known)
        near = difflib.get_close_matches(str(name), known, n=3, cutoff=0.5)
        place = f" in {where}" if where else ""
        hint = f"did you mean {' or '.join(repr(n) for n in near)}? " if near else ""
        known_names = f"known: {', '.join(known) or 'none'}"
        super().__init__(f"unknown {kind} '{name}'{place}: {hint}{known_names}{'; ' if note else ''}{note}")
        self.name = name
        self.near = near


class BackendNotInstalledError(OrbitError):
    """A backend that exists but whose plugin is not installed."""


class UnsupportedCapabilityError(OrbitError):
    """The scene, or a call, needs what the backend lacks."""


class AssetError(OrbitError):
    """A file or description that describes nothing that can be simulated."""


class BuildError(OrbitError):
    """An engine built something else than the description says."""


class ArgumentError(OrbitError, ValueError):
    """An argument of a call that cannot be: of another type, out of range, or one environment twice."""


class ShapeError(ArgumentError):
    """A tensor of the wrong shape."""


class NonFiniteError(ArgumentError):
    """A NaN or infinite number where none may be."""


class StorageError(OrbitError):
    """A file that cannot be written: the disk is full, or the folder is not writable."""


class ClosedError(OrbitError):
    """What was closed is used again."""


class PlanningError(OrbitError):
    """A motion that cannot be planned: says which constraint stands against it."""


class PremiseError(OrbitError):
    """What a task takes for granted when an episode begins holds in none of the starts that were tried."""


class SimulationError(OrbitError):
    """The engine failed or diverged while stepping."""
