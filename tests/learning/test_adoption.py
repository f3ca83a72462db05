"""Models from elsewhere as policies: inputs are picked from what a task shows, the output becomes its action."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.envs import make
from orbit_core.envs.environment import Environment
from orbit_core.interfaces import ConfigurationError, OrbitError
from orbit_learn.adoption import Shown, adopt, signature_of
from orbit_learn.policy import PolicyActor

onnx = pytest.importorskip("onnx")
WEIGHTS = np.random.default_rng(0).normal(size=(5, 6)).astype(np.float32)


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    environment = make("Reach", num_envs=3, backend=default_backend(), robot="ur10", action="joint_position")
    yield environment
    environment.close()


def model(path: Path, operator: str = "Tanh", inputs: int = 5) -> Path:
    """Write a layer from an input named like the observation of ORBIT's own files, whose output is named likewise."""
    value, helper = onnx.helper.make_tensor_value_info, onnx.helper
    nodes = [
        helper.make_node("MatMul", ["state", "weights"], ["observation"]),
        helper.make_node(operator, ["observation"], ["action"]),
    ]
    graph = helper.make_graph(
        nodes, "elsewhere", [value("state", onnx.TensorProto.FLOAT, ["batch", inputs])],
        [value("action", onnx.TensorProto.FLOAT, ["batch", 6])], [onnx.numpy_helper.from_array(WEIGHTS, "weights")],
    )  # fmt: skip
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)]), str(path))
    return path


def test_an_adopted_model_acts_on_the_terms_that_were_named(environment: Environment, tmp_path: Path) -> None:
    source = model(tmp_path / "model.onnx")
    assert signature_of(source).inputs == {"state": 5}
    adopt(source, tmp_path / "policy.onnx", environment, "Reach", state_of(environment), scale=3.0)
    environment.reset(seed=2)
    seen = environment.observe()["policy"]
    assert isinstance(seen, torch.Tensor)
    columns = environment.observation["policy"].columns
    joints, goal = (seen[:, columns[name]] for name in (next(iter(columns)), goal_of(environment)))
    expected = 3.0 * torch.tanh(torch.cat((joints[:, 1:3], 2.0 * goal[:, :3]), 1) @ torch.from_numpy(WEIGHTS))
    made = PolicyActor(environment, tmp_path / "policy.onnx").act()
    torch.testing.assert_close(made, expected.clamp(-1.0, 1.0))


def goal_of(environment: Environment) -> str:
    """Name of a term that has three components or more and is no joint's."""
    columns = environment.observation["policy"].columns
    return next(name for name, at in list(columns.items())[2:] if at.stop - at.start >= 3)


def state_of(environment: Environment) -> dict[str, tuple[Shown, ...]]:
    first = next(iter(environment.observation["policy"].columns))
    return {"state": (*Shown.of_text(f"{first}[1:3]"), *Shown.of_text(f" {goal_of(environment)}[0:3]*2"))}


@pytest.mark.parametrize(
    ("inputs", "changes", "told"),
    [
        ({}, {}, "say what input 'state'"),
        ({"sate": ()}, {}, "unknown input 'sate'"),
        ({"state": Shown.of_text("nothing")}, {}, "unknown observation term 'nothing'"),
        ({"state": Shown.of_text("joint_positions[4:9]")}, {}, "components 0:6"),
        ({"state": Shown.of_text("joint_positions")}, {}, "has 5 numbers, and its terms 6"),
        ({"state": Shown.of_text("joint_positions[0:5]")}, {"output": "act"}, "unknown output 'act'"),
        ({}, {"scale": float("nan")}, "--action-scale) is finite and not 0, not nan"),
        ({}, {"scale": 0.0}, "--action-scale) is finite and not 0, not 0"),
    ],
)
def test_what_does_not_fit_is_named(
    inputs: Any, changes: Any, told: str, environment: Environment, tmp_path: Path
) -> None:
    source = model(tmp_path / "model.onnx")
    with pytest.raises(OrbitError, match=re.escape(told)):
        adopt(source, tmp_path / "policy.onnx", environment, "Reach", inputs, **changes)
    assert not (tmp_path / "policy.onnx").exists()


def test_a_model_of_operators_that_are_not_read_leaves_no_file(environment: Environment, tmp_path: Path) -> None:
    source = model(tmp_path / "model.onnx", "Sin")
    with pytest.raises(OrbitError, match=rf"{re.escape(str(source))} .*'Sin'"):
        adopt(source, tmp_path / "policy.onnx", environment, "Reach", state_of(environment))
    assert not (tmp_path / "policy.onnx").exists()


@pytest.mark.parametrize("text", ["", "a b", "a[1]", "a*", "a*inf", "a,,b", "a[0:1]*1e"])
def test_terms_that_cannot_be_read_are_rejected(text: str) -> None:
    with pytest.raises(ConfigurationError, match="separated by commas"):
        Shown.of_text(text)


def test_a_file_that_is_no_model_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "model.onnx").write_text("no model")
    words = ["adopt", str(tmp_path / "model.onnx"), "--task", "Reach", "--output", str(tmp_path / "policy.onnx")]
    assert main(words) != 0
    assert "is no ONNX" in " ".join(capsys.readouterr().err.split())
