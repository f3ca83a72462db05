"""Force laws that objects have of their own, as plain data: what acts besides joints, springs and contact."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ActiveModel:
    """A force law of an object. Derive a frozen dataclass for a law of your own (:mod:`orbit_core.active`)."""

    name: str
    """Name of the law in its object."""


@dataclass(frozen=True, kw_only=True)
class MagneticSeal(ActiveModel):
    """A magnet that holds a door or a drawer shut, with a force that falls with the gap.

    ``F(g) = force / (1 + g / decay)^2`` pulls a joint towards where it is shut, g being the gap at the seal: the pull
    between poles whose circuit's reluctance is that of the iron and of the gap in series (Fitzgerald, Kingsley and
    Umans, Electric Machinery, 6th ed., sections 1.1 and 3.5). To pull it off takes the work ``force * decay``.
    """

    joint: str
    force: float
    """Newtons at the seal where there is no gap."""
    decay: float = 0.004
    """Metres of gap at which the force has fallen to a quarter."""
    arm: float = 1.0
    """Metres from a turning joint's axis to the seal; 1 for one that slides."""
    closed: float | None = None
    """Position in rad or m at which it is shut; None takes the joint's lower limit."""
    opens_up: bool = True
    """Whether the joint's position grows as it opens."""
