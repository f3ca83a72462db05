"""USD stages opened under the caller's limits: allowed layers only, composed size, and typed values of prims.

USD's library writes its remarks on a file to the standard error stream. They are captured here: a remark that a part of
the stage is missing becomes an error, all others become notes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbit_assets.options import ReadOptions, Unsupported
from orbit_assets.outside import check_archive, check_file, resolve_file
from orbit_assets.source_text import naming, one_line
from orbit_assets.usd.library import pxr
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Pose

# Most prim specs that are counted: in a larger layer counting takes longer than opening it.
_WALKED = 10_000


def composed_prims(layer: Any) -> int:
    """Compute an upper bound of the prims that a layer composes to, or 0 where it is too large to count.

    References, payloads, inherited and specialised classes count with all that they bring in turn; of variants none.
    """
    sizes = _Sizes()
    try:
        return sizes.of(layer, pxr().Sdf.Path.absoluteRootPath)
    except _TooManySpecsError:
        return 0


class _TooManySpecsError(Exception):
    """Raised when there are more specs than are counted."""


class _Sizes:
    """Cache of sizes of prims, by layer and path."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, str], int] = {}

    def of(self, layer: Any, path: Any) -> int:
        """Prims at and below a path, including those of arcs; a prim that includes itself counts once."""
        key = (layer.identifier, str(path))
        if key in self._known:
            return self._known[key]
        if len(self._known) >= _WALKED:
            raise _TooManySpecsError
        # Set before the recursion: a circle of references ends here.
        self._known[key] = 1
        total = 1
        spec = layer.GetPrimAtPath(path)
        if spec is not None:
            total += sum(self.of(layer, child.path) for child in spec.nameChildren)
            total += sum(self.of(*arc) for arc in _arcs(layer, spec))
        total += sum(self.of(each, path) for each in _sublayers(layer) if each.GetPrimAtPath(path) is not None)
        self._known[key] = total
        return total


def _sublayers(layer: Any) -> Iterator[Any]:
    for name in layer.subLayerPaths:
        if name and (found := _opened(layer, name)) is not None:
            yield found


def _arcs(layer: Any, spec: Any) -> Iterator[tuple[Any, Any]]:
    """Yield the layers and paths that a prim refers to."""
    if spec.path == pxr().Sdf.Path.absoluteRootPath:
        return
    for references in (spec.referenceList, spec.payloadList):
        for arc in references.GetAddedOrExplicitItems():
            target = _opened(layer, arc.assetPath) if arc.assetPath else layer
            if target is not None:
                yield target, arc.primPath if arc.primPath else pxr().Sdf.Path(f"/{target.defaultPrim}")
    for classes in (spec.inheritPathList, spec.specializesList):
        for path in classes.GetAddedOrExplicitItems():
            yield layer, path


def _opened(layer: Any, name: str) -> Any:
    """Return a layer that has been opened already, which is therefore allowed; None for others."""
    plain, _ = pxr().Sdf.Layer.SplitIdentifier(name)
    return pxr().Sdf.Layer.Find(layer.ComputeAbsolutePath(plain))


def open_stage(path: Path | str, options: ReadOptions) -> Any:
    """Open the stage of a USD file, and check that every sublayer, reference and payload exists.

    Raises:
        AssetError: the file or a layer that it names is missing, cannot be parsed, is where the model may not read,
            or composition fails otherwise; or USD is not installed.
    """
    usd = pxr()
    layers = _checked_layers(Path(path), options)
    # Composition takes memory in proportion to this number, and references multiply.
    if (prims := composed_prims(layers[0])) > options.limits.elements:
        raise AssetError(
            f"{path} composes to some {prims} prims: let it refer to less, or raise ReadLimits.elements from "
            f"{options.limits.elements}"
        )
    try:
        stage = usd.Usd.Stage.Open(str(path))
    except usd.Tf.ErrorException as error:
        raise AssetError(f"{path} is no USD file that can be opened: {one_line(str(error))}") from None
    if errors := stage.GetCompositionErrors():
        raise AssetError(
            f"{path} does not compose: {one_line(str(errors[0]))}: put the layer there, or correct its path"
        )
    # USD may open layers that no dependency names, such as those of clips.
    known = {layer.realPath for layer in layers}
    for layer in stage.GetUsedLayers():
        if not layer.anonymous and layer.realPath not in known:
            raise AssetError(f"{path} takes in {layer.identifier}, which was not checked: name it by its plain path")
    return stage


def _checked_layers(path: Path, options: ReadOptions) -> list[Any]:
    """Return the layers, the file's own first; each is checked against the options before it is opened.

    A layer that is missing is left to composition, to which one that only an unselected variant names does not matter.
    """
    sdf = pxr().Sdf
    resolve = pxr().Ar.GetResolver().Resolve
    check_file(path, options)
    seen: set[str] = set()
    waiting = [str(path)]
    layers: list[Any] = []
    while waiting:
        found = waiting.pop()
        if found in seen:
            continue
        seen.add(found)
        file = _outer(found)
        if file.lower().endswith(".usdz"):
            check_archive(Path(file), options)
        try:
            layer = sdf.Layer.FindOrOpen(found)
        except pxr().Tf.ErrorException as error:
            raise AssetError(f"{found} is no USD file that can be opened: {one_line(str(error))}") from None
        if layer is None:
            raise AssetError(f"{found} is no USD file that can be opened: correct it")
        layers.append(layer)
        _refuse_clips(layer)
        for reference in filter(None, layer.GetCompositionAssetDependencies()):
            if sdf.VariableExpression.IsExpression(reference):
                raise AssetError(f"{found} names a layer by the expression {reference}: write the path out")
            plain, _ = sdf.Layer.SplitIdentifier(reference)
            named = layer.ComputeAbsolutePath(plain)  # maybe within an archive: scene.usdz[part.usda]
            if outer := resolve(_outer(named)).GetPathString():
                resolve_file(outer, Path(file), options, model=path)
                if target := resolve(named).GetPathString():
                    waiting.append(target)
    return layers


def _outer(identifier: str) -> str:
    """Return the file that a layer is in: the archive, for one within an archive."""
    return identifier.partition("[")[0]


def _refuse_clips(layer: Any) -> None:
    """Refuse value clips, whose layers USD opens as it composes, by patterns of names and over time.
    # A stack instead of recursion: prims may be nested deeper than Python's stack.

    Raises:
            AssetError: a prim has some.
    """
    waiting = [layer.pseudoRoot]
    while waiting:
        spec = waiting.pop()
        if any(key.startswith("clip") for key in spec.ListInfoKeys()):
            raise AssetError(
                f"{layer.identifier}: {spec.path} has value clips, which take values from other files: write their "
                "values into the layer"
            )
        waiting += spec.nameChildren
        for variants in spec.variantSets.values():
            waiting += [variant.primSpec for variant in variants.variants.values()]


# Metadata that name the units and axes of a layer's numbers.
_METRICS = ("metersPerUnit", "upAxis", "kilogramsPerUnit")


@dataclass(frozen=True)
class Units:
    """Units of a stage in SI, and the rotation that takes its up axis to z.

    Link frames turn with the stage, so that a link at rest in a y-up stage has its frame's z up here; positions fixed
    to
    a link are given in that frame.
    """

    length: float
    """Metres of a unit."""
    mass: float
    """Kilograms of a unit."""
    up: Pose
    """Rotation from the stage's axes to z up."""

    @staticmethod
    def of(stage: Any) -> Units:
        """Read the units from a stage's metadata.

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
        """Return N m (angular) or N of one unit of effort."""
        return self.mass * self.length ** (2 if angular else 1)

    def inertia(self, angular: bool) -> float:
        """Return kg m^2 (angular) or kg of one unit of inertia."""
        return self.mass * (self.length**2 if angular else 1.0)

    def position(self, angular: bool) -> float:
        """Return radians or metres of one unit of joint position."""
        # UsdPhysics has angles in degrees.
        return math.radians(1.0) if angular else self.length


@dataclass(frozen=True, eq=False)
class Reading:
    """One file that is being read: its stage and units, the caller's options, and the notes so far."""

    path: Path
    """File that is read."""
    stage: Any
    """``Usd.Stage`` of it."""
    units: Units
    """Units of the stage."""
    options: ReadOptions
    """Options of the reader."""
    notes: list[str]
    """Changes against the file so far."""

    def lack(self, message: str) -> None:
        """Reject or note something that the description cannot hold, as the options say.

        Raises:
            AssetError: the caller chose to refuse it.
        """
        if self.options.unsupported is Unsupported.REFUSE:
            raise AssetError(f"{message}: take it out, or leave it out by ReadOptions(unsupported=Unsupported.DROP)")
        self.note(f"{message}: left out")

    def note(self, message: str) -> None:
        """Record a note once."""
        if message not in self.notes:
            self.notes.append(message)


@contextmanager
def opened(path: Path | str, options: ReadOptions) -> Iterator[Reading]:
    """Open a USD file's stage for the time of reading.

    Raises:
        AssetError: the file or a layer that it names is missing, malformed, too large or outside what may be opened, or
            USD is not installed; or any error was raised within, which then names the file.
    """
    path = Path(path)
    with naming(str(path)), pxr().Tf.DiagnosticTrap() as trap:
        try:
            stage = open_stage(path, options)
            # Warnings of opening are about missing layers, which open_stage has reported; those of reading become
            # notes.
            trap.Clear()
            reading = Reading(path, stage, Units.of(stage), options, [])
            _note_other_units(reading)
            yield reading
            for warning in trap.GetWarnings():
                reading.note(f"USD remarks: {one_line(warning.commentary)}")
        finally:
            trap.Clear()


def _note_other_units(reading: Reading) -> None:
    """Note layers in other units than the stage's: USD composes their numbers as they are."""
    own = reading.stage.GetRootLayer()
    for layer in reading.stage.GetUsedLayers():
        for name in _METRICS:
            theirs = layer.pseudoRoot.GetInfo(name) if layer.pseudoRoot.HasInfo(name) else None
            ours = reading.stage.GetMetadata(name)
            if layer != own and theirs is not None and theirs != ours:
                called = Path(layer.identifier).name
                reading.note(f"{called} has {name} {theirs}, and the stage {ours}: its numbers count in the stage's")


def attribute(prim: Any, name: str, default: Any = None) -> Any:
    """Return the value of an attribute, or ``default`` where the prim has no such attribute or no value for it."""
    found = prim.GetAttribute(name)
    value = found.Get() if found else None
    return default if value is None else value


def authored(prim: Any, name: str) -> float | None:
    """Return the number that the file itself gives an attribute; None where it leaves it to the schema.

    Raises:
        AssetError: it is no number.
    """
    return number(prim, name) if is_authored(prim, name) else None


def is_authored(prim: Any, name: str) -> bool:
    """Return True if the file itself gives an attribute a value."""
    found = prim.GetAttribute(name)
    return bool(found and found.HasAuthoredValue())


def number(prim: Any, name: str, default: float = 0.0) -> float:
    """Return the value of a numeric attribute, which may be infinite.

    Raises:
        AssetError: it is no number, or NaN.
    """
    value = attribute(prim, name, default)
    if isinstance(value, bool | str) or not isinstance(value, int | float) or math.isnan(value):
        raise AssetError(f"{prim.GetPath()}.{name} is {value!r}: give a number")
    return float(value)


def numbers(prim: Any, name: str, default: tuple[float, ...]) -> tuple[float, ...]:
    """Return the components of an attribute that holds as many as ``default``; finite, unless the default is not.

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
    """Return an array attribute as (n, ``width``), or (n,) where ``width`` is 1; without rows where it has no value.

    Raises:
        AssetError: it holds something else.
    """
    value = attribute(prim, name, ())
    try:
        found = np.asarray(value, dtype=kind)
        found = found.reshape(-1) if width == 1 else found.reshape(-1, width)
    except (TypeError, ValueError):
        raise AssetError(f"{prim.GetPath()}.{name} is no array of {width} {kind.__name__} a row: correct it") from None
    if not np.isfinite(found).all():
        raise AssetError(f"{prim.GetPath()}.{name} holds numbers that are not finite: correct it")
    return found


def rotation(prim: Any, name: str) -> Any:
    """Return a quaternion attribute as USD's type.

    Raises:
        AssetError: it is none, or not finite.
    """
    value = attribute(prim, name)
    if not (hasattr(value, "GetImaginary") and math.isfinite(value.GetReal() + sum(value.GetImaginary()))):
        raise AssetError(f"{prim.GetPath()}.{name} is {value!r}: give a finite quaternion")
    return value


def axis(prim: Any) -> str:
    """Return the axis of a round shape or a plane: X, Y or Z.

    Raises:
        AssetError: it is another.
    """
    value = attribute(prim, "axis", "Z")
    if value not in ("X", "Y", "Z"):
        raise AssetError(f"{prim.GetPath()}.axis is {value!r}: give X, Y or Z")
    return value


def targets(prim: Any, name: str) -> list[str]:
    """Return the paths that a relationship names."""
    relationship = prim.GetRelationship(name)
    return [str(target) for target in relationship.GetTargets()] if relationship else []


def applies(prim: Any, schema: str) -> bool:
    """Return True if a schema is applied to a prim, installed or not; of several instances, any."""
    return any(name.partition(":")[0] == schema for name in prim.GetPrimTypeInfo().GetAppliedAPISchemas())


def label(prim: Any) -> str:
    """Return a prim's display name, which may hold any characters, or else its name in the stage."""
    return prim.GetDisplayName() or prim.GetName()
