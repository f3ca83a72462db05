"""USD's library, loaded on first use."""

from __future__ import annotations

import functools
import importlib
from typing import Any

from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import AssetError


@functools.cache
def pxr() -> Any:
    """USD's package ``pxr``, which has no types, with the modules used here imported.

    Newton's schemas of joint friction, armature and mimic joints must register before USD first looks any schema up.

    Raises:
        AssetError: they are not installed.
    """
    modules = ("Ar", "Gf", "Sdf", "Tf", "Usd", "UsdGeom", "UsdLux", "UsdPhysics", "UsdSemantics", "UsdShade", "Vt")
    try:
        importlib.import_module("newton_usd_schemas")
        for module in modules:
            importlib.import_module(f"pxr.{module}")
    except ImportError as error:
        raise AssetError(
            f"USD files need the packages usd-core and newton-usd-schemas: {install_extra('usd')} ({error})"
        ) from None
    return importlib.import_module("pxr")
