"""How far a simulation may go before it counts as diverged, the same on every engine.

The bounds lie far beyond what a robot or anything near it does, and far within what single precision holds: a body that
falls for 17 minutes reaches neither.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from orbit_core.interfaces.errors import SimulationError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    from torch import Tensor

MAX_DISTANCE = 1e6
"""Metres from the environment's origin; of a joint's position, metres or radians."""
MAX_SPEED = 1e4
"""m/s of a link or a prismatic joint, rad/s of a link or a revolute joint."""


def diverged(positions: Tensor, velocities: Tensor) -> Tensor:
    """(N,) whether an environment's numbers are beyond the bounds, or not finite.

    Args:
        positions: (N, ...) in m or rad.
        velocities: (N, ...) in m/s or rad/s.
    """
    # A comparison with NaN is false, so what is not within the bounds is found, whatever it is.
    near = (positions.abs() <= MAX_DISTANCE).flatten(1).all(1)
    slow = (velocities.abs() <= MAX_SPEED).flatten(1).all(1)
    return ~(near & slow)


def divergence_error(environments: Sequence[int]) -> SimulationError:
    """The error that an engine's ``step`` raises for environments, by index; none if they have begun anew since."""
    which = f"environments {first_few(environments)}" if environments else "environments that have begun anew since"
    return SimulationError(
        f"{which} diverged: something moved faster than {MAX_SPEED:g} m/s or rad/s, "
        f"went further than {MAX_DISTANCE:g} m or rad, or is not a number; reset them, and use a smaller physics_dt, "
        "softer drives, or armature on light joints, followers among them (orbit check-robot finds them)"
    )


def matter_divergence_error(environments: Sequence[int], names: Iterable[str]) -> SimulationError:
    """The error of a ``step`` in which the deformables of these names diverged, for environments, by index."""
    return SimulationError(
        f"environments {first_few(environments)} diverged in {', '.join(map(repr, sorted(names)))}: "
        "reset them, and use a smaller physics_dt, softer material or gentler grasps"
    )


def first_few(environments: Sequence[int] | npt.NDArray[np.integer]) -> str:
    """The first numbers of environments, for a message."""
    return ", ".join(map(str, environments[:8])) + (", ..." if len(environments) > 8 else "")
