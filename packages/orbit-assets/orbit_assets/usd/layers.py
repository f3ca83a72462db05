"""USD stages opened with all their layers, and none that the model may not open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from orbit_assets.archives import check_archive
from orbit_assets.naming import one_line
from orbit_assets.options import ReadOptions
from orbit_assets.outside import check_file, resolve_file
from orbit_assets.usd.library import pxr
from orbit_assets.usd.sizes import composed_prims
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
    known = {layer.realPath for layer in layers}
    for layer in stage.GetUsedLayers():
        if not layer.anonymous and layer.realPath not in known:
            raise AssetError(f"{path} takes in {layer.identifier}, which was not checked: name it by its plain path")
    return stage


def _checked_layers(path: Path, options: ReadOptions) -> list[Any]:
    """The layers, the file's own first, followed from one to the next, each held to be allowed before it is opened.

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
