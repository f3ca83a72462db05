"""How many prims a USD layer composes to, found before it is composed: arcs that refer to arcs multiply."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from orbit_assets.usd.library import pxr

_WALKED = 10_000
"""Prim specs that are looked at; a layer of more is large by itself, and looking takes longer than opening it."""


def composed_prims(layer: Any) -> int:
    """An upper bound of the prims that a layer composes to, or 0 where it is too large to tell.

    References, payloads, inherited and specialised classes count with all that they bring in turn; of variants none.
    """
    sizes = _Sizes()
    try:
        return sizes.of(layer, pxr().Sdf.Path.absoluteRootPath)
    except _TooManySpecsError:
        return 0


class _TooManySpecsError(Exception):
    """There are more specs than are looked at."""


class _Sizes:
    """Sizes of the prims met so far, by layer and path."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, str], int] = {}

    def of(self, layer: Any, path: Any) -> int:
        """Prims at and below a path, those that arcs bring included; a prim that brings itself counts once."""
        key = (layer.identifier, str(path))
        if key in self._known:
            return self._known[key]
        if len(self._known) >= _WALKED:
            raise _TooManySpecsError
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
    """The layers and paths that a prim refers to."""
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
    """A layer that has been opened already, and so may be; ``None`` for others."""
    plain, _ = pxr().Sdf.Layer.SplitIdentifier(name)
    return pxr().Sdf.Layer.Find(layer.ComputeAbsolutePath(plain))
