"""USD stages opened with care: what they may open, what is missing from them, and the values that prims hold.

USD's library writes to the standard error stream what it thinks of a file. Here that is held back: what says that a
part of the stage is missing refuses the file, and the rest becomes notes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbit_assets.naming import naming, one_line
from orbit_assets.options import ReadOptions, Unsupported
from orbit_assets.usd.layers import open_stage
from orbit_assets.usd.library import pxr
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Pose

_METRICS = ("metersPerUnit", "upAxis", "kilogramsPerUnit")
"""Metadata of a layer that say in which units and axes its numbers are."""


@dataclass(frozen=True)
class Units:
    """A stage's units in SI, and the rotation that takes its up axis to z.

    Link frames turn with the stage, so that a link at rest in a y-up stage has its frame's z up here; whatever is fixed
    to a link is given in that frame.
    """

    length: float
    mass: float
    up: Pose

    @staticmethod
    def of(stage: Any) -> Units:
        """Those that a stage's metadata name.

        Raises:
            AssetError: a unit is no finite number above zero.
        """
        upright = pxr().UsdGeom.GetStageUpAxis(stage) == pxr().UsdGeom.Tokens.z
        length = pxr().UsdGeom.GetStageMetersPerUnit(stage)
        mass = pxr().UsdPhysics.GetStageKilogramsPerUnit(stage)
        for name, value in (("metersPerUnit", length), ("kilogramsPerUnit", mass)):
            if not 0.0 < value < math.inf:
                raise AssetError(f"the stage's {name} is {value}: give a finite number above zero")
        return Units(length, mass, Pose() if upright else Pose.from_euler(math.pi / 2, 0.0, 0.0))

    def effort(self, angular: bool) -> float:
        """N m (angular) or N of one unit of effort."""
        return self.mass * self.length ** (2 if angular else 1)

    def inertia(self, angular: bool) -> float:
        """kg m^2 (angular) or kg of one unit of inertia."""
        return self.mass * (self.length**2 if angular else 1.0)

    def position(self, angular: bool) -> float:
        """Radians or metres of one unit of joint position."""
        return math.radians(1.0) if angular else self.length


@dataclass(frozen=True, eq=False)
class Reading:
    """One file that is being read: its stage, its units, what the caller asked for, and what is to be told."""

    path: Path
    stage: Any
    units: Units
    options: ReadOptions
    notes: list[str]

    def lack(self, message: str) -> None:
        """What the description cannot hold: refused, or left out with a note, as the caller chose.

        Raises:
            AssetError: the caller chose to refuse it.
        """
        if self.options.unsupported is Unsupported.REFUSE:
            raise AssetError(f"{message}: take it out, or leave it out by ReadOptions(unsupported=Unsupported.DROP)")
        self.note(f"{message}: left out")

    def note(self, message: str) -> None:
        """Tell it once."""
        if message not in self.notes:
            self.notes.append(message)


@contextmanager
def opened(path: Path | str, options: ReadOptions) -> Iterator[Reading]:
    """A USD file's stage, as long as it is being read.

    Raises:
        AssetError: the file or a layer that it names is missing, malformed, too large or outside what may be opened, or
            USD is not installed; and whatever is raised within, with the file's name.
    """
    path = Path(path)
    with naming(str(path)), pxr().Tf.DiagnosticTrap() as trap:
        try:
            stage = open_stage(path, options)
            trap.Clear()
            reading = Reading(path, stage, Units.of(stage), options, [])
            _note_other_units(reading)
            yield reading
            for warning in trap.GetWarnings():
                reading.note(f"USD remarks: {one_line(warning.commentary)}")
        finally:
            trap.Clear()


def _note_other_units(reading: Reading) -> None:
    """Tell of layers in other units than the stage's: USD composes their numbers as they are."""
    own = reading.stage.GetRootLayer()
    for layer in reading.stage.GetUsedLayers():
        for name in _METRICS:
            theirs = layer.pseudoRoot.GetInfo(name) if layer.pseudoRoot.HasInfo(name) else None
            ours = reading.stage.GetMetadata(name)
            if layer != own and theirs is not None and theirs != ours:
                called = Path(layer.identifier).name
                reading.note(f"{called} has {name} {theirs}, and the stage {ours}: its numbers count in the stage's")


def attribute(prim: Any, name: str, default: Any = None) -> Any:
    """The value of an attribute, or ``default`` where the prim has no such attribute or no value for it."""
    found = prim.GetAttribute(name)
    value = found.Get() if found else None
    return default if value is None else value


def authored(prim: Any, name: str) -> float | None:
    """The number that a file itself gives an attribute; ``None`` where it leaves it to the schema.

    Raises:
        AssetError: it is no number.
    """
    return number(prim, name) if is_authored(prim, name) else None


def is_authored(prim: Any, name: str) -> bool:
    """Whether a file itself gives an attribute a value."""
    found = prim.GetAttribute(name)
    return bool(found and found.HasAuthoredValue())


def number(prim: Any, name: str, default: float = 0.0) -> float:
    """The value of a numeric attribute, which may be infinite.

    Raises:
        AssetError: it is no number, or NaN.
    """
    value = attribute(prim, name, default)
    if isinstance(value, bool | str) or not isinstance(value, int | float) or math.isnan(value):
        raise AssetError(f"{prim.GetPath()}.{name} is {value!r}: give a number")
    return float(value)


def numbers(prim: Any, name: str, default: tuple[float, ...]) -> tuple[float, ...]:
    """The components of an attribute that holds as many as ``default``; finite, unless the default is not.

    Raises:
        AssetError: they are others.
    """
    value = attribute(prim, name, default)
    try:
        found = tuple(float(part) for part in value)
    except (TypeError, ValueError):
        found = ()
    if len(found) != len(default) or not (found == default or all(map(math.isfinite, found))):
        raise AssetError(f"{prim.GetPath()}.{name} is {value!r}: give {len(default)} numbers")
    return found


def array(prim: Any, name: str, width: int, kind: type) -> Any:
    """An array attribute as (n, ``width``), or (n,) where ``width`` is 1; of no rows where there is no value.

    Raises:
        AssetError: it holds something else.
    """
    value = attribute(prim, name, ())
    try:
        found = np.asarray(value, dtype=kind)
        found = found.reshape(-1) if width == 1 else found.reshape(-1, width)
    except (TypeError, ValueError):
        raise AssetError(f"{prim.GetPath()}.{name} is no array of {width} {kind.__name__} a row: mend it") from None
    if not np.isfinite(found).all():
        raise AssetError(f"{prim.GetPath()}.{name} holds numbers that are not finite: mend it")
    return found


def rotation(prim: Any, name: str) -> Any:
    """A quaternion attribute, as USD holds it.

    Raises:
        AssetError: it is none, or not finite.
    """
    value = attribute(prim, name)
    if not (hasattr(value, "GetImaginary") and math.isfinite(value.GetReal() + sum(value.GetImaginary()))):
        raise AssetError(f"{prim.GetPath()}.{name} is {value!r}: give a finite quaternion")
    return value


def axis(prim: Any) -> str:
    """The axis of a round shape or a plane: X, Y or Z.

    Raises:
        AssetError: it is another.
    """
    value = attribute(prim, "axis", "Z")
    if value not in ("X", "Y", "Z"):
        raise AssetError(f"{prim.GetPath()}.axis is {value!r}: give X, Y or Z")
    return value


def targets(prim: Any, name: str) -> list[str]:
    """The paths that a relationship names."""
    relationship = prim.GetRelationship(name)
    return [str(target) for target in relationship.GetTargets()] if relationship else []


def applies(prim: Any, schema: str) -> bool:
    """Whether a schema is applied to a prim, installed or not; of several instances, any."""
    return any(name.partition(":")[0] == schema for name in prim.GetPrimTypeInfo().GetAppliedAPISchemas())


def label(prim: Any) -> str:
    """The name given to a prim: its display name, which may hold any characters, or else its name in the stage."""
    return prim.GetDisplayName() or prim.GetName()
