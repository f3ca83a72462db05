"""Files that come from anyone: whatever a policy or a checkpoint holds, one clear error, and nothing of it runs."""

from __future__ import annotations

import json
import os
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import onnx
import pytest
import safetensors.torch
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn

import orbit_core
from orbit_core.interfaces import OrbitError
from orbit_data import tensor_file
from orbit_learn.description import Part, PolicyDescription
from orbit_learn.networks import Perceptron
from orbit_learn.policy import Policy, load_policy
from orbit_learn.training import read_checkpoint, write_checkpoint

DESCRIPTION = PolicyDescription(
    "Reach", "a_robot", "joint_position", (Part("seen", 3),), (Part("moved", 2),), 0.02, "an_engine", "a_library", 1
)


def policy(description: PolicyDescription = DESCRIPTION) -> Policy:
    network = Perceptron((4,))
    torch.manual_seed(0)
    return Policy(network.build(description.observation_size, description.action_size), network, description)


def saved(folder: Path) -> Path:
    path = folder / "policy_1.safetensors"
    policy().save(path)
    return path


def changed(path: Path, change: Callable[[dict[str, Any], dict[str, Tensor]], None]) -> None:
    """Write the file again with another document or other weights, as ORBIT itself would not."""
    with safetensors.safe_open(path, framework="pt") as file:
        document, weights = json.loads(file.metadata()["orbit"]), safetensors.torch.load(path.read_bytes())
    change(document, weights)
    safetensors.torch.save_file(weights, path, {"orbit": json.dumps(document)})


def put(*keys: str | int, value: Any) -> Callable[[dict[str, Any], dict[str, Tensor]], None]:
    """A change of the document."""

    def change(document: Any, weights: dict[str, Tensor]) -> None:
        for key in keys[:-1]:
            document = document[key]
        document[keys[-1]] = value

    return change


def weight(name: str, value: Tensor | None) -> Callable[[dict[str, Any], dict[str, Tensor]], None]:
    """A change of a weight; None drops it."""

    def change(document: dict[str, Any], weights: dict[str, Tensor]) -> None:
        weights.pop(name, None)
        if value is not None:
            weights[name] = value

    return change


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (put("format", value=7), "no policy of format 1"),
        (put("policy", value=[]), "not an object"),
        (put("policy", "task", value=3), "task is 3, but must be text"),
        (put("policy", "step_dt", value="fast"), "step_dt is 'fast', but must be a number"),
        (put("policy", "step_dt", value=float("nan")), "JSON holds NaN"),
        (put("policy", "iteration", value=1e300), r"iteration is 1e\+300, but must be a whole number"),
        (put("policy", "iteratoin", value=1), "did you mean 'iteration'"),
        (put("policy", "observation_parts", 0, "size", value=-1), "components, not -1"),
        (put("policy", "observation_parts", 0, "size", value=10**12), "components, not 1000000000000"),
        (put("policy", "observation_parts", value=[]), "1 to 1,048,576 components each"),
        (put("policy", "action_parts", 0, value={"name": "moved", "size": 5}), r"needs \(5, 4\)"),
        (put("policy", "action_parts", 0, "size", value=5), r"shape \(2,\) does not have 5 components"),
        (put("policy", "observation_parts", 0, "dtype", value="complex64"), "'complex64', which is none of"),
        (put("policy", "concatenated", value=False), "cannot act"),
        (put("network", value=None), "names no network"),
        (put("network", "name", value="perceptrom"), "did you mean 'perceptron'"),
        (put("network", "name", value="os:system"), "unknown network 'os:system'"),
        (put("network", "name", value="x" * 100_000), "unknown network 'xxx"),
        (put("policy", "x" * 100_000, value=1), "unknown field 'xxx"),
        (put("policy", "task", value=["x" * 100_000]), "task is"),
        (put("network", "settings", "activation", value="elo"), "did you mean 'elu'"),
        (put("network", "settings", "hidden_sizes", value=[2**16] * 65), "up to 64 hidden layers"),
        (put("network", "settings", "hidden_sizes", value=[2**16] * 64), "lacks weights"),
        (put("network", "settings", "hidden_sizes", value=[5]), r"needs \(5, 3\)"),
        (put("network", "settings", "observation_limit", value=-1.0), "is positive"),
        (weight("layers.0.bias", torch.full((4,), float("nan"))), "NaN or infinity in 'layers.0.bias'"),
        (weight("std", torch.tensor([1.0, float("inf"), 1.0])), "NaN or infinity in 'std'"),
        (weight("std", torch.zeros(3)), "not finite"),
        (weight("layers.0.bias", torch.zeros(5)), r"shape \(5,\) .* needs \(4,\)"),
        (weight("layers.0.bias", torch.zeros(4, dtype=torch.float64)), "float64"),
        (weight("layers.0.bias", None), "lacks weights 'layers.0.bias'"),
        (weight("another", torch.zeros(1)), "no place for weights 'another'"),
    ],
)
def test_what_is_wrong_in_a_policy_is_named(
    tmp_path: Path, change: Callable[[dict[str, Any], dict[str, Tensor]], None], complaint: str
) -> None:
    path = saved(tmp_path)
    assert load_policy(path).description == DESCRIPTION
    changed(path, change)
    with pytest.raises(OrbitError, match=complaint) as raised:
        load_policy(path)
    assert str(path) in str(raised.value)
    assert len(str(raised.value)) < 500


def header(size: int, text: bytes = b"") -> bytes:
    return size.to_bytes(8, "little") + text


def with_document(text: str) -> bytes:
    written = json.dumps({"__metadata__": {"orbit": text}}).encode()
    return header(len(written), written)


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (b"", "fewer than a header"),
        (header(2**63), "its header says that it has 9,223,372,036,854,775,808 bytes"),
        (header(100, b"{}"), "its header says that it has 100 bytes, of 10"),
        (header(2, b"{}"), "lacks '__metadata__'"),
        (header(9, b"\xff\xfe garbage"[:9]), "cannot be read"),
        (header(100_000, b"[" * 100_000), "nested too deeply"),
        (header(100_000, b'{"a":' * 20_000), "nested too deeply"),
        (with_document("[" * 50_000), "nested too deeply"),
        (with_document("[1]"), "no object but a list"),
        (with_document('{"format": ' + "9" * 10_000 + "}"), "cannot be read: Exceeds the limit"),
        (with_document("{}"), "no policy of format"),
        (header(21, b'{"__metadata__": [1]}'), "metadata is no object"),
    ],
)
def test_a_malformed_file_is_told_of(tmp_path: Path, data: bytes, complaint: str) -> None:
    path = tmp_path / "policy_1.safetensors"
    path.write_bytes(data)
    with pytest.raises(OrbitError, match=complaint):
        load_policy(path)


@pytest.mark.parametrize("cut", [-1, 1])
def test_the_tensors_fill_what_the_header_says(tmp_path: Path, cut: int) -> None:
    path = saved(tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[:cut] if cut < 0 else data + b"\0" * cut)
    with pytest.raises(OrbitError, match="cannot be read"):
        load_policy(path)


def test_a_file_beyond_the_limits_is_neither_read_nor_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = saved(tmp_path)
    monkeypatch.setattr(tensor_file, "MAX_HEADER", 100)
    with pytest.raises(OrbitError, match="its header says"):
        load_policy(path)
    monkeypatch.setattr(tensor_file, "MAX_FILE", 1000)
    with pytest.raises(OrbitError, match="larger than 1,000 bytes"):
        load_policy(path)
    with pytest.raises(OrbitError, match="would be larger"):
        policy().save(tmp_path / "policy_2.safetensors")
    assert [entry.name for entry in tmp_path.iterdir()] == ["policy_1.safetensors"]


class _Reads(nn.Module):
    """As TorchScript it opens, grows and may overwrite a file of the user's."""

    def __init__(self, path: str) -> None:
        super().__init__()
        self.path = path

    def forward(self, observation: Tensor) -> Tensor:
        return torch.from_file(self.path, True, 6)


class _Runs:
    """As a pickle it runs a command."""

    def __init__(self, command: str) -> None:
        self.command = command

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (self.command,)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", ["policy_1.pt", "policy_1.safetensors", "policy_1.onnx"])
@pytest.mark.parametrize("kind", ["script", "pickle", "checkpoint"])
def test_no_code_in_a_file_runs(tmp_path: Path, kind: str, name: str) -> None:
    path, canary = tmp_path / name, tmp_path / "canary"
    runs = _Runs(f"touch '{canary}'")
    if kind == "script":
        torch.jit.save(torch.jit.script(_Reads(str(canary))), str(path))
    elif kind == "pickle":
        path.write_bytes(pickle.dumps(runs))
    else:
        torch.save({"state": runs}, path)
    with pytest.raises(OrbitError, match="policy_1") as raised:
        load_policy(path)
    assert "may run code" in str(raised.value) or not name.endswith(".pt")
    with pytest.raises(OrbitError, match="policy_1"):
        read_checkpoint(path, "sb3")
    assert not canary.exists()


@pytest.mark.parametrize("name", ["pretrained_model", "pretrained_model/model.safetensors", "robomimic.pth"])
def test_checkpoints_of_other_libraries_are_refused_with_the_way_to_use_them(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "pretrained_model"
    folder.mkdir()
    safetensors.torch.save_file({"model.weight": torch.zeros(2)}, str(folder / "model.safetensors"))
    (folder / "config.json").write_text('{"type": "act"}')
    torch.save({"model": torch.zeros(2)}, tmp_path / "robomimic.pth")
    with pytest.raises(OrbitError, match=r"export it to ONNX.*orbit adopt.*--agent ws://"):
        load_policy(tmp_path / name)


def test_a_folder_leads_nowhere_else(tmp_path: Path) -> None:
    folder, other = tmp_path / "training", tmp_path / "other"
    folder.mkdir()
    other.mkdir()
    (folder / "policy_2.safetensors").symlink_to(saved(other))
    with pytest.raises(OrbitError, match="a link that leads out of its folder"):
        load_policy(folder)
    assert load_policy(folder / "policy_2.safetensors").description == DESCRIPTION, "whoever names a link means it"
    for stray in ("policy_../1.safetensors", "policy_9999999999999999999999.safetensors", "policy_x.safetensors"):
        (folder / stray).parent.mkdir(exist_ok=True)
        (folder / stray).write_bytes(b"")
    policy(replace(DESCRIPTION, iteration=5)).save(folder / "policy_5.safetensors")
    assert load_policy(folder).description.iteration == 5


def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    with pytest.raises(OrbitError, match="holds no policy_<iteration>"):
        load_policy(tmp_path)
    with pytest.raises(OrbitError, match="there is no file"):
        load_policy(tmp_path / "policy_1.safetensors")
    os.mkfifo(tmp_path / "policy_1.safetensors")
    with pytest.raises(OrbitError, match="no regular file"):
        load_policy(tmp_path)


def model(*nodes: onnx.NodeProto, weights: tuple[onnx.TensorProto, ...] = (), documented: bool = True) -> bytes:
    graph = helper.make_graph(
        nodes,
        "graph",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["n", 3])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["n", 2])],
        weights,
    )
    made = helper.make_model(graph)
    if documented:
        helper.set_model_props(made, {"orbit": json.dumps(DESCRIPTION.document())})
    return made.SerializeToString()


def constant(name: str, *shape: int, fill: float = 0.1) -> onnx.TensorProto:
    return numpy_helper.from_array(torch.full(shape, fill).numpy(), name)


def elsewhere() -> onnx.TensorProto:
    weights = constant("w", 3, 2)
    weights.ClearField("raw_data")
    weights.data_location = TensorProto.EXTERNAL
    weights.external_data.add(key="location", value="../../../../etc/passwd")
    return weights


PRODUCT = helper.make_node("MatMul", ["observation", "w"], ["action"])
LARGE = (
    helper.make_node("MatMul", ["column", "row"], ["large"]),
    helper.make_node("Tanh", ["observation"], ["action"]),
)


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (b"no model", "is no policy"),
        (model(PRODUCT, weights=(elsewhere(),)), "weights 'w' are in another file"),
        (model(PRODUCT, weights=(constant("w", 3, 2, fill=float("nan")),)), "'w' hold NaN"),
        (model(PRODUCT, weights=(constant("w", 4, 2),)), "cannot act"),
        (model(PRODUCT, weights=(constant("w", 3, 5),)), r"shape \(2, 5\) of 2 observations, not \(2, 2\)"),
        (model(PRODUCT), "uses 'w' before anything computes it"),
        (model(PRODUCT, weights=(constant("w", 3, 2),), documented=False), "no policy of format"),
        (model(helper.make_node("Tanhh", ["observation"], ["action"])), "did you mean 'Tanh'"),
        (model(helper.make_node("Tanh", ["observation"], ["action"], domain="evil")), "unknown operator 'evil.Tanh'"),
        (model(helper.make_node("Loop", ["observation"], ["action"])), "unknown operator 'Loop'"),
        (model(helper.make_node("Tanh", ["observation"], ["other"])), "nothing computes its graph's output"),
        (model(*LARGE, weights=(constant("column", 10**5, 1), constant("row", 1, 10**5))), "10,000,000,000 numbers"),
        (model(helper.make_node("Sqrt", ["observation"], ["action"], rank=3)), "cannot act"),
    ],
)
def test_what_is_wrong_in_onnx_is_named(tmp_path: Path, data: bytes, complaint: str) -> None:
    path = tmp_path / "policy.onnx"
    path.write_bytes(model(PRODUCT, weights=(constant("w", 3, 2),)))
    assert load_policy(path).module(torch.ones(1, 3)).tolist() == [[pytest.approx(0.3)] * 2]
    path.write_bytes(data)
    with pytest.raises(OrbitError, match=complaint):
        load_policy(path)


def test_a_checkpoint_is_data(tmp_path: Path) -> None:
    """Whatever state dictionaries hold comes back; what is no data is refused when it is written."""
    path = tmp_path / "checkpoint_0.safetensors"
    state = {
        "optimizer": {0: {"step": torch.tensor(3.0)}, "lr": 1e-3, "betas": [0.9, 0.999]},
        "names": ["a", None, True],
    }
    write_checkpoint(path, "sb3", state)
    assert read_checkpoint(path, "sb3") == state
    with pytest.raises(OrbitError, match="of library 'sb3', not of 'skrl'"):
        read_checkpoint(path, "skrl")
    with pytest.raises(OrbitError, match="holds data, and no PolicyDescription"):
        write_checkpoint(path, "sb3", {"state": DESCRIPTION})
    with pytest.raises(OrbitError, match="no policy of format"):
        load_policy(path)
    changed(path, put("state", "items", 0, value=[["a list"], {"tensor": "7"}]))
    with pytest.raises(OrbitError, match="holds no state"):
        read_checkpoint(path, "sb3")
    with pytest.raises(OrbitError, match="no checkpoint of format"):
        read_checkpoint(saved(tmp_path), "sb3")


def damaged(good: bytes, random: Random) -> bytes:
    """Bytes overwritten, taken out or put in near the beginning, where what is not numbers lies."""
    data, place = bytearray(good), random.randrange(min(len(good), 1200))
    text = bytes(random.choices(b'0123456789[]{}",:eE-.', k=random.randint(1, 6)))
    data[place : place + random.choice([0, len(text), 20])] = random.choice([b"", text, random.randbytes(2)])
    if random.random() < 0.5:  # let the header's size be right, so that what it says is read
        size = int.from_bytes(good[:8], "little") + len(data) - len(good)
        data[:8] = size.to_bytes(8, "little")
    return bytes(data)


def test_damaged_files_end_in_errors_of_ours(tmp_path: Path) -> None:
    """100 of each kind; what is still whole is read."""
    policy().save(tmp_path / "policy.safetensors")
    policy().export_onnx(tmp_path / "policy.onnx")
    state = {"optimizer": torch.optim.Adam(policy().module.parameters()).state_dict(), "other": [1, None, {"a": 2.0}]}
    write_checkpoint(tmp_path / "checkpoint.safetensors", "sb3", state)
    random, told = Random(0), []
    for path in sorted(tmp_path.iterdir()):
        good = path.read_bytes()
        for _ in range(100):
            path.write_bytes(damaged(good, random))
            try:
                if path.stem == "policy":
                    load_policy(path)
                else:
                    read_checkpoint(path, "sb3")
            except OrbitError as error:
                told.append((path.name, str(error)))
    assert len(told) > 150
    assert all(name in error and len(error) < 700 for name, error in told)


def test_the_core_has_no_reader_that_runs_what_it_reads() -> None:
    forbidden = re.compile(r"(?<!safetensors\.)\btorch\.load\(|torch\.jit\.load|pickle\.load|allow_pickle=True")
    assert forbidden.search("state = torch.load(path)")
    core = Path(orbit_core.__file__).parent
    # What it reads comes through pipes from processes that it started, and from no file.
    pipes = core / "plugin_kit" / "workers.py"
    for path in {*core.rglob("*.py")} - {pipes}:
        assert not forbidden.search(path.read_text(encoding="utf-8")), path
