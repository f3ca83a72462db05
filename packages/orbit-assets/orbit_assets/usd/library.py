"""USD's library, loaded on first use; unique names of prims; prims written with attributes and poses."""

from __future__ import annotations

import functools
import importlib
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Pose
from orbit_core.scene.pose import Vector3


@functools.cache
def pxr() -> Any:
    """Return USD's package ``pxr``, which has no types, with the modules used here imported.

    Newton's schemas of joint friction, armature and mimic joints must register before USD first looks any schema up.

    Raises:
        AssetError: they are not installed.
    """
    modules = ("Ar", "Gf", "Sdf", "Tf", "Usd", "UsdGeom", "UsdLux", "UsdPhysics", "UsdSemantics", "UsdShade", "Vt")
    try:
        # Before pxr: a schema registered after the first look-up of any schema is never found.
        importlib.import_module("newton_usd_schemas")
        for module in modules:
            importlib.import_module(f"pxr.{module}")
    except ImportError as error:
        raise AssetError(
            f"USD files need the packages usd-core and newton-usd-schemas: {install_extra('usd')} ({error})"
        ) from None
    return importlib.import_module("pxr")


def unique_names(labels: Mapping[str, str], taken: frozenset[str] = frozenset()) -> dict[str, str]:
    """Return a unique name for each path: its label, prefixed by names of the prims above where several share it.

    Numbers distinguish names where even whole paths do not.

    Args:
        labels: by path, in the order in which the first keeps the shorter name where numbers are needed.
        taken: names that are reserved.
    """
    names = dict(labels)
    parts = {path: [part for part in path.split("/")[1:-1] if part] for path in labels}
    shared = _shared(names, taken)
    depth = 0
    while shared and any(len(parts[path]) > depth for path in shared):
        depth += 1
        for path in shared:
            names[path] = "_".join((*parts[path][-depth:], labels[path]))
        shared = _shared(names, taken)
    used = {name for path, name in names.items() if path not in shared} | taken
    for path in shared:
        number, name = 1, names[path]
        while name in used:
            number, name = number + 1, f"{names[path]}_{number + 1}"
        names[path] = name
        used.add(name)
    return names


def _shared(names: Mapping[str, str], taken: frozenset[str]) -> list[str]:
    counts = Counter(names.values())
    return [path for path, name in names.items() if counts[name] > 1 or name in taken]


def define(stage: Any, parent: Any, name: str, kind: str) -> Any:
    """Define a prim below ``parent`` with a valid and unique name; its display name is ``name``."""
    base = parent.GetPath() if parent else stage.GetPseudoRoot().GetPath()
    valid = pxr().Tf.MakeValidIdentifier(name)
    path, number = base.AppendChild(valid), 1
    while stage.GetPrimAtPath(path):
        path, number = base.AppendChild(f"{valid}_{number}"), number + 1
    prim = stage.DefinePrim(path, kind)
    if prim.GetName() != name:
        prim.SetDisplayName(name)
    return prim


def assign(prim: Any, schema: str | None, attributes: dict[str, Any]) -> None:
    """Apply a schema by name, ``Schema:instance`` where it may be applied several times, and set attributes of it."""
    if schema:
        name, *instance = schema.split(":")
        prim.ApplyAPI(name, *instance)
    for key, value in attributes.items():
        # USD accepts no NumPy scalars other than float64.
        prim.GetAttribute(key).Set(value.item() if isinstance(value, np.generic) else value)


def assign_custom(prim: Any, attributes: dict[str, float | bool | list[float]]) -> None:
    """Set attributes that no installed schema has."""
    types = pxr().Sdf.ValueTypeNames
    for key, value in attributes.items():
        kind = types.Bool if isinstance(value, bool) else types.DoubleArray if isinstance(value, list) else types.Double
        prim.CreateAttribute(key, kind, custom=True).Set(value)


def place(prim: Any, pose: Pose, scale: Vector3 | None = None) -> None:
    """Move a prim to a pose in its parent."""
    transform = pxr().UsdGeom.Xformable(prim)
    transform.AddTranslateOp().Set(pxr().Gf.Vec3d(*pose.position))
    w, x, y, z = pose.orientation
    transform.AddOrientOp(pxr().UsdGeom.XformOp.PrecisionDouble).Set(pxr().Gf.Quatd(w, x, y, z))
    if scale:
        transform.AddScaleOp(pxr().UsdGeom.XformOp.PrecisionDouble).Set(pxr().Gf.Vec3d(*map(float, scale)))


def quatf(pose: Pose) -> Any:
    """Return the orientation in single precision."""
    w, x, y, z = pose.orientation
    return pxr().Gf.Quatf(w, x, y, z)
