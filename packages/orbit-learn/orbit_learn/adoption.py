"""Adoption of ONNX models that were learned elsewhere: a graph around them says what their inputs are here.

The model stays as it is. A matrix product before each of its inputs picks and scales the numbers that it needs from the
observation, and its output is scaled and clipped to an action. The file is then like one of ``orbit export``.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from orbit_core.envs.observation_layout import POLICY
from orbit_core.files import as_path, read_bytes, written_whole
from orbit_core.interfaces import ConfigurationError, OrbitError, UnknownNameError
from orbit_data.manifest.manifest import Manifest
from orbit_learn.description import PolicyDescription
from orbit_learn.onnx_file import KEY, onnx_package, read_onnx
from orbit_learn.policy_file import manifest_document

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment

_TERM = re.compile(r"\s*(?P<name>[\w.]+)(\[(?P<begin>\d+):(?P<end>\d+)\])?(\*(?P<scale>[-+.\deE]+))?\s*")
_OBSERVATION, _ACTION = "observation", "action"


@dataclass(frozen=True)
class Shown:
    """Numbers of an observation term, as a model sees them."""

    term: str
    """Name of the term in the observation group."""
    begin: int = 0
    """First component."""
    end: int | None = None
    """One past the last component; None for all."""
    scale: float = 1.0
    """Factor that the model's input has over the environment's value."""

    @staticmethod
    def of_text(text: str) -> tuple[Shown, ...]:
        """Read terms separated by commas, each ``name``, ``name[begin:end]`` or ``name[begin:end]*scale``.

        Raises:
            ConfigurationError: a term is written in another way.
        """
        terms: list[Shown] = []
        for word in text.split(","):
            found = _TERM.fullmatch(word)
            try:
                if found is None:
                    raise ValueError
                scale = float(found["scale"] or 1.0)
                if not math.isfinite(scale):
                    raise ValueError
            except ValueError:
                raise ConfigurationError(
                    f"an input is terms separated by commas, such as 'joint_positions,cube_pose[0:3]*2', not '{text}'"
                ) from None
            end = None if found["end"] is None else int(found["end"])
            terms.append(Shown(found["name"], int(found["begin"] or 0), end, scale))
        return tuple(terms)


@dataclass(frozen=True)
class Signature:
    """Inputs and outputs of a model, with the numbers that each has for an environment."""

    inputs: dict[str, int]
    """Numbers of each input, by name."""
    outputs: dict[str, int]
    """Numbers of each output, by name."""


def signature_of(path: Path | str) -> Signature:
    """Return the inputs and outputs of an ONNX file.

    Raises:
        ConfigurationError: it is no ONNX, or one of them is not of shape (N, K).
    """
    return _signature(_model(as_path(path)), as_path(path))


def adopt(
    path: Path | str,
    target: Path | str,
    environment: Environment,
    task: str,
    inputs: Mapping[str, tuple[Shown, ...]],
    output: str | None = None,
    scale: float = 1.0,
) -> None:
    """Write a model that was learned elsewhere as a policy for an environment.

    Args:
        path: of the ONNX file.
        target: file that is written.
        environment: that the policy is for.
        task: name that the environment was made by.
        inputs: what each input of the model is, by the input's name.
        output: name of the output that is the action; may be left out where there is one.
        scale: of the output, to the environment's action in [-1, 1].

    Raises:
        OrbitError: an input or a term is unknown, sizes differ, or the model has operators that are not read; the
            message names the part.
    """
    path, target, onnx = as_path(path), as_path(target), onnx_package()
    if not math.isfinite(scale) or scale == 0.0:
        raise ConfigurationError(f"the factor of the action (--action-scale) is finite and not 0, not {scale:g}")
    layout = environment.observation[POLICY]
    if not layout.concatenated:
        raise ConfigurationError(
            f"the policy of task {task} sees a dictionary of terms, and models are adopted for one tensor: give the "
            "task other observations"
        )
    model = _model(path)
    signature = _signature(model, path)
    for name in inputs:
        if name not in signature.inputs:
            raise UnknownNameError("input", name, signature.inputs, str(path))
    output = _chosen(output, signature, environment.action_size, path)
    graph = model.graph
    # Names of the file's own must not meet those that are added.
    for name in (*signature.inputs, output, _OBSERVATION, _ACTION):
        _rename(graph, name, f"adopted.{name}")
    helper, nodes = onnx.helper, []
    for name, size in signature.inputs.items():
        if name not in inputs:
            raise ConfigurationError(f"say what input '{name}' ({size} numbers) of {path} is: --input {name}=TERM,...")
        matrix = _selection(inputs[name], layout.columns, name, size)
        graph.initializer.append(onnx.numpy_helper.from_array(matrix, f"selection.{name}"))
        nodes.append(helper.make_node("MatMul", [_OBSERVATION, f"selection.{name}"], [f"adopted.{name}"]))
    numbers = {"scale": scale, "low": -1.0, "high": 1.0}
    for name, value in numbers.items():
        graph.initializer.append(onnx.numpy_helper.from_array(np.array(value, np.float32), f"action.{name}"))
    last = [
        helper.make_node("Mul", [f"adopted.{output}", "action.scale"], ["action.scaled"]),
        helper.make_node("Clip", ["action.scaled", "action.low", "action.high"], [_ACTION]),
    ]
    nodes += [*graph.node, *last]
    del graph.node[:], graph.input[:], graph.output[:]
    graph.node.extend(nodes)
    kind, width = onnx.TensorProto.FLOAT, sum(value.stop - value.start for value in layout.columns.values())
    graph.input.append(helper.make_tensor_value_info(_OBSERVATION, kind, ["environments", width]))
    graph.output.append(helper.make_tensor_value_info(_ACTION, kind, ["environments", environment.action_size]))
    description = PolicyDescription.of(environment, task, "adopted", 0)
    manifest = Manifest.of(environment, task, 0)
    helper.set_model_props(model, {KEY: json.dumps({**description.document(), **manifest_document(manifest)})})
    with written_whole(target) as written:
        onnx.save(model, str(written))
        # A file that cannot be read again is no policy, even if its description is complete.
        try:
            read_onnx(written)
        except OrbitError as error:
            # The user knows the model, not the file that is about to take the target's place.
            raise ConfigurationError(str(error).replace(str(written), str(path))) from None


def _model(path: Path) -> Any:
    from google.protobuf.message import DecodeError  # which onnx raises for damaged files

    try:
        return onnx_package().load_model_from_string(read_bytes(path))
    except (DecodeError, ValueError) as error:
        raise ConfigurationError(f"{path} is no ONNX: {str(error).strip()}") from None


def _signature(model: Any, path: Path) -> Signature:
    weights = {weight.name for weight in model.graph.initializer}
    entries = [entry for entry in model.graph.input if entry.name not in weights]
    inputs, outputs = ({e.name: _size(e, path) for e in each} for each in (entries, model.graph.output))
    return Signature(inputs, outputs)


def _size(entry: Any, path: Path) -> int:
    shape = [dimension.dim_value for dimension in entry.type.tensor_type.shape.dim]
    if len(shape) != 2 or shape[1] < 1:
        raise ConfigurationError(
            f"'{entry.name[:60]}' of {path} has shape {shape}, not (environments, numbers): models with memory, "
            "pictures or free sizes are not adopted; let 'orbit run --agent ws://...' ask a server that runs it"
        )
    return shape[1]


def _chosen(output: str | None, signature: Signature, size: int, path: Path) -> str:
    if output is None and len(signature.outputs) != 1:
        raise ConfigurationError(f"{path} has outputs {', '.join(signature.outputs)}: name the action by --action-from")
    name = next(iter(signature.outputs)) if output is None else output
    if name not in signature.outputs:
        raise UnknownNameError("output", name, signature.outputs, str(path))
    if signature.outputs[name] != size:
        raise ConfigurationError(
            f"output '{name}' of {path} has {signature.outputs[name]} numbers, and the environment's action {size}: "
            "choose the robot and the action space that it was learned with"
        )
    return name


def _rename(graph: Any, old: str, new: str) -> None:
    for node in graph.node:
        for names in (node.input, node.output):
            for place, name in enumerate(names):
                if name == old:
                    names[place] = new
    for weight in graph.initializer:
        if weight.name == old:
            weight.name = new


def _selection(terms: tuple[Shown, ...], columns: Mapping[str, slice], name: str, size: int) -> Any:
    """Return the matrix (O, K) from an observation to an input."""
    width = sum(value.stop - value.start for value in columns.values())
    chosen: list[tuple[int, float]] = []
    for term in terms:
        if term.term not in columns:
            raise UnknownNameError("observation term", term.term, columns, f"input '{name}'")
        whole = columns[term.term]
        count = whole.stop - whole.start
        end = count if term.end is None else term.end
        if not 0 <= term.begin < end <= count:
            raise ConfigurationError(f"'{term.term}' has components 0:{count}, which {term.begin}:{end} is no part of")
        chosen += [(whole.start + place, term.scale) for place in range(term.begin, end)]
    if len(chosen) != size:
        raise ConfigurationError(f"input '{name}' has {size} numbers, and its terms {len(chosen)}")
    matrix = np.zeros((width, size), np.float32)
    for place, (row, factor) in enumerate(chosen):
        matrix[row, place] = factor
    return matrix
