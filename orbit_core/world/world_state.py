"""A snapshot of a world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor


@dataclass(frozen=True)
class WorldState:
    """A snapshot of everything that the continuation depends on."""

    engine: Any
    actuators: Any
    active: Any
    sensors: dict[str, Any]
    random: Any
    markers: Tensor
    steps: int
    made_by: tuple[str, int, tuple[str, ...]]
    """Backend, number of environments and names of all things of the world that it is of."""
