"""Errors that ORBIT raises on purpose, and the bounds beyond which a simulation counts as diverged.

A message is one clear sentence that names the culprit and the remedy.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    from torch import Tensor


class OrbitError(Exception):
    """Base of all errors below; the command line prints its message alone, without a traceback."""

    def __reduce__(self) -> tuple[object, ...]:
        # By its message, not by calling __init__ with it: an error that a process cannot read breaks its whole pool.
        return _restored, (type(self), self.args, self.__dict__.copy())


def _restored(kind: type[OrbitError], arguments: tuple[object, ...], values: dict[str, object]) -> OrbitError:
    """Return an error that another process raised."""
    error = kind.__new__(kind, *arguments)
    error.__dict__.update(values)
    return error


class ConfigurationError(OrbitError):
    """A setting that is not possible: a rate that does not divide, a field out of range, a malformed file."""


class UnknownNameError(OrbitError):
    """An unknown name; the message names the nearest known ones."""

    def __init__(self, kind: str, name: str, known: Iterable[str], where: str = "", note: str = "") -> None:
        # Sorted, so that messages are the same on every run.
        known = sorted(known)
        # A cutoff of 0.5 finds a swapped or a missing letter, and no unrelated names.
        near = difflib.get_close_matches(str(name), known, n=3, cutoff=0.5)
        place = f" in {where}" if where else ""
        hint = f"did you mean {' or '.join(repr(n) for n in near)}? " if near else ""
        known_names = f"known: {', '.join(known) or 'none'}"
        super().__init__(f"unknown {kind} '{name}'{place}: {hint}{known_names}{'; ' if note else ''}{note}")
        self.name = name
        """Name that was not found."""
        self.near = near
        """Known names that resemble it, at most three."""


class BackendNotInstalledError(OrbitError):
    """A backend that exists but whose plugin is not installed."""


class UnsupportedCapabilityError(OrbitError):
    """A capability that the scene or a call needs and the backend lacks."""


class AssetError(OrbitError):
    """A file or description of something that cannot be simulated."""


class BuildError(OrbitError):
    """An engine built a model that differs from the description."""


class ArgumentError(OrbitError, ValueError):
    """An argument of another type, out of range, or that names an environment twice."""


class ShapeError(ArgumentError):
    """A tensor of the wrong shape."""


class NonFiniteError(ArgumentError):
    """A NaN or infinite number where none may be."""


class StorageError(OrbitError):
    """A file that cannot be written: the disk is full, or the folder is not writable."""


class ClosedError(OrbitError):
    """Use of an object that is closed."""


class PlanningError(OrbitError):
    """A motion that cannot be planned; the message names the constraint that prevents it."""


class PremiseError(OrbitError):
    """A premise of a task that holds in none of the sampled starts of an episode."""


class SimulationError(OrbitError):
    """A failure or divergence of the engine while stepping."""


class FailedEnvironmentsError(SimulationError):
    """A failure in some environments, by index, so that one of several parts of an engine can be told for the whole."""

    def __init__(self, environments: Sequence[int], what: str) -> None:
        """Name the environments first, then ``what`` happened to them and the remedy."""
        which = f"environments {first_few(environments)}" if environments else "environments that were reset since"
        super().__init__(f"{which} {what}")
        self.environments = tuple(environments)
        """Indices, in ascending order."""
        self.what = what
        """The rest of the message."""


# A body that falls freely for seven minutes reaches neither bound; single precision resolves 6 cm at 1e6 m.
MAX_DISTANCE = 1e6
"""Metres from the environment's origin; of a joint's position, metres or radians."""
MAX_SPEED = 1e4
"""m/s of a link or a prismatic joint, rad/s of a link or a revolute joint."""


def diverged(positions: Tensor, velocities: Tensor) -> Tensor:
    """Return a mask (N,) of the environments with numbers beyond the bounds, or not finite.

    Args:
        positions: (N, ...) in m or rad.
        velocities: (N, ...) in m/s or rad/s.
    """
    # A comparison with NaN is false, so that this finds NaN as well as numbers beyond the bounds.
    near = (positions.abs() <= MAX_DISTANCE).flatten(1).all(1)
    slow = (velocities.abs() <= MAX_SPEED).flatten(1).all(1)
    return ~(near & slow)


def divergence_error(environments: Sequence[int]) -> SimulationError:
    """Return the error that ``Engine.step`` raises for environments, by index; none if they were reset since."""
    return FailedEnvironmentsError(
        environments,
        f"diverged: something moved faster than {MAX_SPEED:g} m/s or rad/s, "
        f"went further than {MAX_DISTANCE:g} m or rad, or is not a number; reset them, and use a smaller physics_dt, "
        "softer drives, or armature on light joints, followers among them (orbit check-robot finds them)",
    )


def matter_divergence_error(environments: Sequence[int], names: Iterable[str]) -> SimulationError:
    """Return the error of a ``step`` in which deformables diverged.

    Args:
        environments: by index.
        names: of the deformables.
    """
    return SimulationError(
        f"environments {first_few(environments)} diverged in {', '.join(map(repr, sorted(names)))}: "
        "reset them, and use a smaller physics_dt, softer material or gentler grasps"
    )


def first_few(environments: Sequence[int] | npt.NDArray[np.integer]) -> str:
    """Return the first numbers of environments, for a message."""
    return ", ".join(map(str, environments[:8])) + (", ..." if len(environments) > 8 else "")
