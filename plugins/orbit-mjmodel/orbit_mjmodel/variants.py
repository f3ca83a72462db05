"""Bodies whose shapes differ between environments, which MuJoCo wants alike but for numbers.

A body has a geom for each shape that any kind of environment has there, type by type. What one kind lacks of them is a
grain in the midst of its first shape, where nothing comes, until the engine that steps the model removes it.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import mujoco

from orbit_core.scene import Pose
from orbit_mjmodel.geometry import Part
from orbit_mjmodel.materials import ContactParameters

GRAIN = 1e-5
"""Metres."""
ABSENT = "absent"
"""Begins the names of geoms that only other kinds of environments have."""


@dataclass(frozen=True)
class Slot:
    """The place of one geom in one kind of environment."""

    part: Part
    contact: ContactParameters
    absent: bool = False


def slots(own: Sequence[Slot], kinds: Iterable[Sequence[Slot]]) -> Iterator[Slot]:
    """A body's geoms: its ``own``, and grains for what other ``kinds`` have, in an order that is all kinds'."""
    kinds = list(kinds)
    middle = own[0].part[3] if own else Pose()
    for kind in sorted({int(slot.part[0]) for slots_of in kinds for slot in slots_of}):
        each = [[slot for slot in slots_of if slot.part[0] == kind] for slots_of in kinds]
        most = max(each, key=len)
        mine = [slot for slot in own if slot.part[0] == kind]
        yield from mine
        for slot in most[len(mine) :]:
            _, _, asset, _ = slot.part
            size = (0.0, 0.0, 0.0) if asset else (GRAIN, GRAIN, GRAIN)
            yield Slot((mujoco.mjtGeom(kind), size, asset, middle), slot.contact, absent=True)
