"""Prims of a stage that is being written: names, places, attributes."""

from __future__ import annotations

from typing import Any

import numpy as np

from orbit_assets.usd.library import pxr
from orbit_core.scene import Pose
from orbit_core.scene.pose import Vector3


def define(stage: Any, parent: Any, name: str, kind: str) -> Any:
    """A new prim below ``parent``; USD's name for it is made valid and unique, and its display name is ``name``."""
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
        # USD takes no scalars of NumPy but float64.
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
    """The orientation, in single precision."""
    w, x, y, z = pose.orientation
    return pxr().Gf.Quatf(w, x, y, z)
