"""Things drawn for people, without physics."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from orbit_core.scene.materials import Color


class MarkerShape(Enum):
    """How a marker looks."""

    FRAME = "frame"
    SPHERE = "sphere"
    BOX = "box"
    ARROW = "arrow"
    """Along the marker's x axis."""


@dataclass(frozen=True)
class MarkerSpec:
    """A marker in each environment; its pose is set at run time. ``size`` is its length in metres."""

    name: str
    shape: MarkerShape = MarkerShape.FRAME
    size: float = 0.1
    color: Color = (0.1, 0.8, 0.1, 0.6)
