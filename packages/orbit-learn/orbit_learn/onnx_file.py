"""Policies as ONNX files: written for use without ORBIT, and read as data.

The graph is run by torch wherever the environments live, and no file beside it is read. The description stands in the
model's metadata, under the key ``orbit``, as in :mod:`orbit_learn.policy_file`; beside it stand the keys that
code for deployment elsewhere reads, :mod:`orbit_learn.deployment`.
"""

from __future__ import annotations

import copy
import json
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import nn

from orbit_core.files import as_path, read_bytes, written_whole
from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError, OrbitError
from orbit_data.manifest.manifest import Manifest
from orbit_data.tensor_file import parse_json
from orbit_learn.deployment import deployment_metadata
from orbit_learn.description import PolicyDescription
from orbit_learn.onnx_graph import OnnxGraph
from orbit_learn.picture_features import TermByTerm
from orbit_learn.policy_file import check_action, manifest_document, manifest_of

SUFFIX = ".onnx"
_KEY = "orbit"


def write_onnx(
    path: Path | str, module: nn.Module, description: PolicyDescription, manifest: Manifest | None = None
) -> None:
    """Write input ``observation`` (N, O) and output ``action`` (N, A). The file appears whole or not at all.

    Of a policy that sees a dictionary, the inputs are its terms, (N, ...) each, by their names.

    Raises:
        ConfigurationError: the exporter is not installed.
    """
    onnx, path = _onnx(), as_path(path)
    example = description.zeros(2)
    exported = copy.deepcopy(module).cpu().eval()
    names = ["observation"]
    if isinstance(example, dict):
        names = list(example)
        exported = TermByTerm(exported, names)
    with written_whole(path) as written:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of this exporter's age; the newer one needs one more package
            torch.onnx.export(
                exported,
                tuple(example.values()) if isinstance(example, dict) else (example,),
                str(written),
                input_names=names,
                output_names=["action"],
                dynamic_axes={name: {0: "environments"} for name in (*names, "action")},
                dynamo=False,
            )
        model = onnx.load(str(written))
        document = json.dumps({**description.document(), **manifest_document(manifest)})
        deployed = {} if manifest is None else deployment_metadata(manifest, description.group, str(path.stem))
        onnx.helper.set_model_props(model, {**deployed, _KEY: document})
        onnx.save(model, str(written))


def read_onnx(path: Path | str) -> tuple[PolicyDescription, Manifest | None, nn.Module]:
    """A policy on the CPU from a file such as :func:`write_onnx` writes.

    Raises:
        OrbitError: the file is malformed, has an operator that is not known, weights elsewhere or that are not finite,
            or its parts do not fit each other; names which.
    """
    onnx = _onnx()
    from google.protobuf.message import DecodeError  # what onnx is made of

    path = as_path(path)
    data = read_bytes(path)
    try:
        model = onnx.load_model_from_string(data)
        document = parse_json({entry.key: entry.value for entry in model.metadata_props}.get(_KEY, "{}"))
        graph = OnnxGraph(model.graph, onnx).requires_grad_(False).eval()
    except (DecodeError, ValueError, TypeError, OrbitError) as error:
        raise ConfigurationError(f"{path} is no policy: {str(error).strip() or 'it is no ONNX'}") from None
    description = PolicyDescription.of_document(document, str(path))
    # Shapes alone first, so that a graph that would fill the memory is refused before it does.
    check_action(copy.deepcopy(graph).to("meta"), description, path, "meta")
    check_action(graph, description, path)
    return description, manifest_of(document, path), graph


def _onnx() -> Any:
    try:
        import onnx
    except ImportError as error:
        raise ConfigurationError(f"ONNX needs {error.name}: {install_extra('onnx')}") from None
    return onnx
