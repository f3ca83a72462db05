"""USD stages opened with all their layers, and none that the model may not open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from orbit_core.assets.archives import check_archive
from orbit_core.assets.naming import one_line
from orbit_core.assets.options import ReadOptions
from orbit_core.assets.outside import check_file, resolve_file
from orbit_core.assets.usd.library import pxr
from orbit_core.assets.usd.sizes import composed_prims
from orbit_core.interfaces.errors import AssetError


def open_stage(path: Path | str, options: ReadOptions) -> Any:
    """The stage of a USD file, of which every sublayer, reference and payload is there.

    Raises:
        AssetError: the file or a layer that it names is missing, cannot be parsed, lies where the model may not read,
            or composition fails otherwise; or USD is not installed.
    """
    usd = pxr()
    layers = _checked_layers(Path(path), options)
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
        raise AssetError(f"{path} does not compose: {one_line(str(errors[0]))}: put the layer there, or mend its path")
    return stage


def _checked_layers(path: Path, options: ReadOptions) -> list[Any]:
    """The layers, the file's own first, followed from one to the next, each held to be allowed before it is opened.

    A layer that is missing is left to composition, to which one that only an unselected variant names does not matter.
    """
    sdf = pxr().Sdf
    check_file(path, options)
    seen: set[str] = set()
    waiting = [str(path)]
    layers: list[Any] = []
    while waiting:
        found = waiting.pop()
        if found in seen:
            continue
        seen.add(found)
        if found.lower().endswith(".usdz"):
            check_archive(Path(found), options)
        try:
            layer = sdf.Layer.FindOrOpen(found)
        except pxr().Tf.ErrorException as error:
            raise AssetError(f"{found} is no USD file that can be opened: {one_line(str(error))}") from None
        if layer is None:
            raise AssetError(f"{found} is no USD file that can be opened: correct it")
        layers.append(layer)
        for reference in layer.GetCompositionAssetDependencies():
            # A path within an archive, scene.usdz[part.usda], opens no other file than the archive.
            target = layer.ComputeAbsolutePath(reference).partition("[")[0]
            if reference and Path(target).exists():
                waiting.append(str(resolve_file(target, Path(found), options, model=path)))
    return layers
