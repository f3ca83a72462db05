"""What an engine holds of a scene once it is built, read back from the engine's own structures.

The core compares it with the description whenever a world is made, so that a wrong build never simulates in silence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Approximation:
    """A line of the build report: what the scene asked for, what the engine got, and why they differ."""

    subject: str
    asked: str
    got: str
    why: str


@dataclass(frozen=True, kw_only=True, eq=False)
class BuiltModel:
    """One kind of environment, for L links and J movable joints in the layout's order.

    An engine fills it from the objects that it simulates, never from the description. A field is None where the engine
    keeps no such number, as where the core or the plugin applies a limit itself at each step.
    """

    masses: npt.NDArray[np.float64]
    """(L,) kg. The number of a fixed root, which no motion depends on, is not compared."""
    centers_of_mass: npt.NDArray[np.float64]
    """(L, 3) metres, in the link frame."""
    inertias: npt.NDArray[np.float64] | None
    """(L, 3, 3) kg m^2, about the centre of mass, in the link's axes."""
    lower_limits: npt.NDArray[np.float64] | None = None
    """(J,) rad or m; minus infinity, or less than -1e8, where there is none."""
    upper_limits: npt.NDArray[np.float64] | None = None
    """(J,) rad or m; infinity, or more than 1e8, where there is none."""
    armatures: npt.NDArray[np.float64] | None = None
    """(J,) kg or kg m^2 of reflected motor inertia."""
    effort_limits: npt.NDArray[np.float64] | None = None
    """(J,) N or N m; infinity, or more than 1e8, where there is none."""
