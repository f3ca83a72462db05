"""Policies as ONNX files: written for use without ORBIT, and read as data.

The graph is run by torch on the environments' device, for operators that only compute numbers from numbers; their
meaning is that of ONNX's operator set 13 and later: https://onnx.ai/onnx/operators/. No other file is opened. The
description is in the model's metadata, under the key ``orbit``, as in :mod:`orbit_learn.policy_file`.

More keys are those of mjlab's exporter (``mjlab.rl.exporter_utils``, mjlab 1.6), so that code which deploys its
policies reads ORBIT's too. All values are texts: lists have commas, lists in lists semicolons, numbers three decimals.
"""

from __future__ import annotations

import copy
import json
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from orbit_core.files import as_path, read_bytes, written_whole
from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError, NonFiniteError, OrbitError, UnknownNameError
from orbit_data.manifest.manifest import Manifest, ObservationTermManifest
from orbit_data.tensor_file import parse_json
from orbit_learn.description import PolicyDescription
from orbit_learn.memory import MemoryModule, StepByStep
from orbit_learn.networks import TermByTerm
from orbit_learn.policy_cost import depth_of
from orbit_learn.policy_file import check_action, manifest_document, manifest_of


def deployment_metadata(manifest: Manifest, group: str, name: str) -> dict[str, str]:
    """Return metadata for the first robot that acts; lists of joints have its order, and gain 0 without an actuator.

    ``command_names`` is empty, because commands are observation terms here. ``action_scale`` is left out if targets are
    not ``default + scale * action`` of joint positions, because no such number exists then.

    Args:
        manifest: manifest of the environment that the policy was learned in.
        group: group that the policy sees.
        name: name of the run, for ``run_path``.
    """
    robot_name, robot = next((name, robot) for name, robot in manifest.robots.items() if robot.agent)
    terms = manifest.observations[group].terms
    concatenated = manifest.observations[group].concatenated
    values: dict[str, Iterable[object]] = {
        "joint_names": robot.joint_names,
        "joint_stiffness": robot.stiffness,
        "joint_damping": robot.damping,
        "default_joint_pos": robot.home_positions,
        "command_names": (),
        "observation_names": terms,
        "observation_terms_scale": [term.scale for term in terms.values()],
        "observation_terms_flatten_history_dim": [concatenated for _ in terms],
        "observation_terms_history_length": [term.history if term.history > 1 else 0 for term in terms.values()],
        "observation_terms_clip": [_clip_range(term) for term in terms.values()],
    }
    scales = _scales(manifest, robot_name)
    if scales:
        values["action_scale"] = scales
    return {"run_path": name, **{key: ",".join(map(_text, value)) for key, value in values.items()}}


def _scales(manifest: Manifest, robot: str) -> list[float]:
    """Return the scale of each component; empty if one is not a joint position around the default."""
    scales: list[float] = []
    for term in manifest.action_terms.values():
        if term.robot != robot or term.scale is None:
            return []
        scales += term.scale
    return scales


def _clip_range(term: ObservationTermManifest) -> tuple[float, float]:
    return (-math.inf if term.low is None else term.low, math.inf if term.high is None else term.high)


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return ";".join(map(_text, value))
    return f"{value:.3f}" if isinstance(value, int | float) else str(value)


_MOST_NODES = 10_000
# Limit of the numbers of one environment between two operators; a broadcast could otherwise fill the memory.
_MOST_NUMBERS = 2**24


def _gemm(
    a: Tensor, b: Tensor, c: Tensor | None = None, *, alpha: float = 1.0, beta: float = 1.0, transA: int = 0,
    transB: int = 0,
) -> Tensor:  # fmt: skip
    a, b = a.T if transA else a, b.T if transB else b
    if c is not None and alpha == beta == 1.0:  # the usual case, in one operation
        return torch.addmm(c, a, b)
    product = alpha * (a @ b)
    return product if c is None else product + beta * c


def _clip(value: Tensor, low: Tensor | None = None, high: Tensor | None = None) -> Tensor:
    return value if low is None and high is None else torch.clamp(value, low, high)


OPERATORS: dict[str, Callable[..., Tensor]] = {
    "Add": torch.add,
    "Clip": _clip,
    "Concat": lambda *values, axis: torch.cat(values, axis),
    "Div": torch.div,
    "Elu": lambda value, *, alpha=1.0: F.elu(value, alpha),
    "Exp": torch.exp,
    "Gemm": _gemm,
    "Identity": lambda value: value,
    "LeakyRelu": lambda value, *, alpha=0.01: F.leaky_relu(value, alpha),
    "MatMul": torch.matmul,
    "Max": torch.maximum,
    "Min": torch.minimum,
    "Mul": torch.mul,
    "Neg": torch.neg,
    "Relu": torch.relu,
    "Sigmoid": torch.sigmoid,
    "Softplus": F.softplus,
    "Sqrt": torch.sqrt,
    "Sub": torch.sub,
    "Tanh": torch.tanh,
}
"""Functions that take a node's inputs, None for one that is left out, and its attributes by keyword."""


@dataclass(frozen=True)
class _Operation:
    function: Callable[..., Tensor]
    inputs: tuple[str, ...]
    output: str
    attributes: dict[str, Any]


class OnnxGraph(nn.Module):
    """Graph from an observation (N, O) to an action (N, A).

    Args:
        graph: an ``onnx.GraphProto`` with one input, one output and float32 weights, all inside it.
        onnx: the package, which its user has imported.

    Raises:
        UnknownNameError: an operator is not among :data:`OPERATORS`.
        NonFiniteError: weights contain NaN or infinity.
        ConfigurationError: inputs, outputs or weights are not as above.
    """

    def __init__(self, graph: Any, onnx: Any) -> None:
        super().__init__()
        self.watch: Callable[[Sequence[int], int], None] | None = None
        """Function that gets the shape of each result, and the number of multiplications for each of its numbers."""
        if len(graph.node) > _MOST_NODES:
            raise ConfigurationError(f"its graph has {len(graph.node):,} nodes, more than {_MOST_NODES:,}")
        weights = {weight.name: _numbers(weight, onnx) for weight in graph.initializer}
        inputs = [entry.name for entry in graph.input if entry.name not in weights]
        if len(inputs) != 1 or len(graph.output) != 1:
            raise ConfigurationError(
                f"its graph has {len(inputs)} inputs and {len(graph.output)} outputs, not one each; a policy that "
                "sees a dictionary of terms is not read from ONNX: play its .safetensors file"
            )
        self._input, self._output = inputs[0], graph.output[0].name
        self._operations: list[_Operation] = []
        for node in graph.node:
            if node.op_type == "Constant":
                weights[node.output[0]] = _constant(node, onnx)
            else:
                self._operations.append(_operation(node, onnx))
        # Buffers move with the module to another device; names from a file are not always names of attributes.
        self._buffer_of = {name: f"weight_{i}" for i, name in enumerate(weights)}
        for name, buffer in self._buffer_of.items():
            self.register_buffer(buffer, weights[name])
        self._check_order()

    def forward(self, observation: Tensor) -> Tensor:
        values: dict[str, Tensor | None] = {name: getattr(self, buffer) for name, buffer in self._buffer_of.items()}
        values |= {"": None, self._input: observation}  # ONNX names inputs that are left out ""
        most = _MOST_NUMBERS * len(observation)
        for operation in self._operations:
            inputs = [values[name] for name in operation.inputs]
            result = operation.function(*inputs, **operation.attributes)
            if result.numel() > most:
                raise RuntimeError(f"'{operation.output}' has {result.numel():,} numbers, more than {most:,}")
            if self.watch is not None:
                product = operation.function in (torch.matmul, _gemm)
                depth = depth_of(product, inputs[0], bool(operation.attributes.get("transA"))) if inputs else 1
                self.watch((1, result.numel() // len(observation)), depth)
            values[operation.output] = result
        action = values[self._output]
        assert action is not None
        return action

    def _check_order(self) -> None:
        """Refuse a graph that uses a value before it is computed."""
        # ONNX requires this order of nodes, but files need not keep it.
        known = {"", self._input, *self._buffer_of}
        for operation in self._operations:
            for name in operation.inputs:
                if name not in known:
                    raise ConfigurationError(f"its graph uses '{name[:60]}' before anything computes it")
            known.add(operation.output)
        if self._output not in known - {""}:
            raise ConfigurationError(f"nothing computes its graph's output '{self._output[:60]}'")


def _operation(node: Any, onnx: Any) -> _Operation:
    if node.domain not in ("", "ai.onnx") or node.op_type not in OPERATORS:
        raise UnknownNameError("operator", f"{node.domain}.{node.op_type}".strip(".")[:60], OPERATORS)
    if len(node.output) != 1:
        raise ConfigurationError(f"its operator {node.op_type} has {len(node.output)} outputs, not one")
    numbers = (onnx.AttributeProto.FLOAT, onnx.AttributeProto.INT)
    for attribute in node.attribute:
        if attribute.type not in numbers:
            raise ConfigurationError(f"attribute '{attribute.name[:60]}' of its operator {node.op_type} is no number")
    attributes = {attribute.name: onnx.helper.get_attribute_value(attribute) for attribute in node.attribute}
    return _Operation(OPERATORS[node.op_type], tuple(node.input), node.output[0], attributes)


def _constant(node: Any, onnx: Any) -> Tensor:
    if len(node.attribute) != 1 or node.attribute[0].type != onnx.AttributeProto.TENSOR or len(node.output) != 1:
        raise ConfigurationError("its graph has a constant that is no tensor")
    return _numbers(node.attribute[0].t, onnx, node.output[0])


def _numbers(weight: Any, onnx: Any, name: str = "") -> Tensor:
    name = (weight.name or name)[:60]
    if weight.data_location == onnx.TensorProto.EXTERNAL or weight.external_data:
        raise ConfigurationError(f"weights '{name}' are in another file, which is not read: save them inside the model")
    if weight.data_type != onnx.TensorProto.FLOAT:
        raise ConfigurationError(f"weights '{name}' are not float32")
    numbers = torch.from_numpy(onnx.numpy_helper.to_array(weight).copy())
    if not bool(torch.isfinite(numbers).all()):
        raise NonFiniteError(f"weights '{name}' hold NaN or infinity")
    return numbers


SUFFIX = ".onnx"
KEY = "orbit"
"""Key of the description in the metadata."""
_MEMORY = "orbit_memory"


@contextmanager
def _attention_of_parts() -> Iterator[None]:
    """Keep torch from joining a transformer's layer into one operator, which ONNX does not have."""
    joined = torch.backends.mha.get_fastpath_enabled()
    torch.backends.mha.set_fastpath_enabled(False)
    try:
        yield
    finally:
        torch.backends.mha.set_fastpath_enabled(joined)


def write_onnx(
    path: Path | str, module: nn.Module, description: PolicyDescription, manifest: Manifest | None = None
) -> None:
    """Write ONNX with input ``observation`` (N, O) and output ``action`` (N, A); it appears complete or not at all.

    If a policy sees a dictionary, the inputs are its terms (N, ...) by name. A policy with memory has an input
    ``<name>`` and an output ``next_<name>`` for each part of it; the metadata has its values at the first step as
    ``orbit_memory``.

    Args:
        path: path of the file, which is replaced.
        module: policy's module.
        description: policy's description, for the metadata.
        manifest: manifest of the environment, for the metadata.

    Raises:
        ConfigurationError: the exporter is not installed.
    """
    onnx, path = onnx_package(), as_path(path)
    example = description.zeros(2)  # two environments: a single one could be traced as a constant size
    exported = copy.deepcopy(module).cpu().eval()
    names = list(example) if isinstance(example, dict) else ["observation"]
    inputs = tuple(example.values()) if isinstance(example, dict) else (example,)
    outputs = ["action"]
    memory = exported.initial_memory(2, "cpu") if isinstance(exported, MemoryModule) else {}
    if isinstance(exported, MemoryModule):
        exported = StepByStep(exported, names if isinstance(example, dict) else [], list(memory))
        names, inputs = [*names, *memory], (*inputs, *memory.values())
        outputs += [f"next_{name}" for name in memory]
    elif isinstance(example, dict):
        exported = TermByTerm(exported, names)
    with written_whole(path) as written:
        with warnings.catch_warnings(), _attention_of_parts():
            warnings.simplefilter("ignore")  # that this exporter is old; the newer one needs another package
            torch.onnx.export(
                exported,
                inputs,
                str(written),
                input_names=names,
                output_names=outputs,
                dynamic_axes={name: {0: "environments"} for name in (*names, *outputs)},
                dynamo=False,
            )
        model = onnx.load(str(written))
        document = json.dumps({**description.document(), **manifest_document(manifest)})
        deployed = {} if manifest is None else deployment_metadata(manifest, description.group, str(path.stem))
        begins = json.dumps({name: value[0].tolist() for name, value in memory.items()})
        first = {_MEMORY: begins} if memory else {}
        onnx.helper.set_model_props(model, {**deployed, **first, KEY: document})
        onnx.save(model, str(written))


def read_onnx(path: Path | str) -> tuple[PolicyDescription, Manifest | None, nn.Module]:
    """Return a policy on the CPU from a file such as :func:`write_onnx` writes.

    Raises:
        OrbitError: the file is malformed, has an unknown operator, weights in other files or that are not finite, or
            parts that do not fit each other; the message names the part.
    """
    onnx = onnx_package()
    from google.protobuf.message import DecodeError  # which onnx raises for damaged files

    path = as_path(path)
    data = read_bytes(path)
    try:
        model = onnx.load_model_from_string(data)
        document = parse_json({entry.key: entry.value for entry in model.metadata_props}.get(KEY, "{}"))
        _check_no_memory(document, path)
        graph = OnnxGraph(model.graph, onnx).requires_grad_(False).eval()
    except (DecodeError, ValueError, TypeError, OrbitError) as error:
        raise ConfigurationError(f"{path} is no policy: {str(error).strip() or 'it is no ONNX'}") from None
    description = PolicyDescription.of_document(document, str(path))
    # First only shapes, so that a graph that would fill the memory is refused before it does.
    check_action(copy.deepcopy(graph).to("meta"), description, path, "meta")
    check_action(graph, description, path)
    return description, manifest_of(document, path), graph


def _check_no_memory(document: Any, path: Path) -> None:
    """Reject a graph with memory, whose operators :class:`OnnxGraph` lacks.

    Raises:
        ConfigurationError: says which file to play in its place.
    """
    policy = document.get("policy") if isinstance(document, dict) else None
    if isinstance(policy, dict) and policy.get("memory"):
        raise ConfigurationError(
            f"{path} is a policy with memory, which is read from its safetensors file only: play that, or run this "
            "file with onnxruntime"
        )


def onnx_package() -> Any:
    """Return the package ``onnx``.

    Raises:
        ConfigurationError: it is not installed.
    """
    try:
        import onnx
    except ImportError as error:
        raise ConfigurationError(f"ONNX needs {error.name}: {install_extra('onnx')}") from None
    return onnx
