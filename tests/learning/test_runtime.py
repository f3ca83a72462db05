"""An exported runtime of NumPy and onnxruntime gives the joint targets that ORBIT gives, for each kind of term."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from orbit_core.actions.differential_ik import DifferentialIk
from orbit_core.backends import default_backend
from orbit_core.cli.making import make_environment
from orbit_core.envs import Environment, make
from orbit_core.interfaces import ConfigurationError
from orbit_data.manifest.manifest import Manifest
from orbit_learn.cli.export import main as export
from orbit_learn.cli.play import played
from orbit_learn.cli.trained import PlaySettings
from orbit_learn.description import PolicyDescription
from orbit_learn.networks import Perceptron
from orbit_learn.policy import Policy, load_policy
from orbit_learn.pretrained import policy_path
from orbit_learn.runtime import write_runtime
from tests.learning.test_onnx_loop import CASES, Measured

BACKEND = default_backend()


def module_of(folder: Path) -> ModuleType:
    """The exported file, loaded from where it was written."""
    spec = importlib.util.spec_from_file_location("orbit_runtime", folder / "orbit_runtime.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def measured_of(environment: Environment) -> Measured:
    """Raw numbers of each term, from the observation by the manifest's scale and offset."""
    manifest = Manifest.of(environment, "", 0).observations["policy"].terms
    row, begin, found = environment.observe()["policy"][0].numpy(), 0, {}
    for name, term in manifest.items():
        end = begin + int(np.prod(term.shape))
        # The newest step of a history is its last.
        size = (end - begin) // term.history
        found[name] = row[end - size : end] / term.scale + np.array(term.offset)
        begin = end
    return found


def jacobians_of(environment: Environment) -> dict[str, np.ndarray]:
    named = zip(environment.actions.terms, environment.actions.generators, strict=True)
    return {
        name: each.robot.jacobian(each.frame, each.joints)[0].numpy()
        for name, each in named
        if isinstance(each, DifferentialIk)
    }


def compare(runtime: object, environment: Environment, policy: Policy, case: str | None) -> None:
    world, action = environment.world, torch.zeros(1, environment.action_size)
    robot = world.robots["robot"]
    for _ in range(20):
        measured = CASES[case](environment) if case else measured_of(environment)
        positions = dict(zip(robot.joint_names, robot.joint_positions[0].tolist(), strict=True))
        targets = runtime.step(measured, positions, jacobians_of(environment))  # type: ignore[attr-defined]
        action = policy.module(environment.observe()["policy"]).clamp(-1.0, 1.0)
        environment.step(action.detach())
        assert len(targets) >= 8
        for joint, target in targets.items():
            column = world.layout.joints_by_name.index(("robot", joint))
            sent = float(world.actuators.position_targets[0, column])  # pyright: ignore[reportAttributeAccessIssue]
            assert target == pytest.approx(sent, abs=1e-5), joint


@pytest.mark.parametrize("name", ["reach", "lift"])
def test_a_runtime_gives_the_targets_that_orbit_gives(name: str, tmp_path: Path) -> None:
    export([name, "--runtime", str(tmp_path)])
    environment = make_environment(played(PlaySettings(policy=Path(name), backend=BACKEND)), 1)
    runtime = module_of(tmp_path).Runtime(tmp_path)
    assert runtime.rate == pytest.approx(1.0 / environment.step_dt)
    compare(runtime, environment, load_policy(policy_path(name)), name if name == "reach" else None)
    assert "minus its home position" in runtime.describe()
    environment.close()


def untrained(environment: Environment) -> tuple[Policy, Manifest]:
    torch.manual_seed(0)
    description, network = PolicyDescription.of(environment, "Lift", "none", 0), Perceptron(hidden_sizes=(16,))
    module = network.build(description.observation_size, description.action_size)
    return Policy(module, network, description), Manifest.of(environment, "Lift", 0)


@pytest.mark.parametrize("action", ["ik_relative", "joint_position_relative"])
def test_runtimes_of_other_action_spaces_give_the_same_targets(action: str, tmp_path: Path) -> None:
    environment = make("Lift", 1, BACKEND, action=action)
    policy, manifest = untrained(environment)
    write_runtime(tmp_path, policy, manifest, environment)
    compare(module_of(tmp_path).Runtime(tmp_path), environment, policy, None)
    environment.close()


def test_an_action_term_without_a_runtime_is_refused_by_name(tmp_path: Path) -> None:
    environment = make("Lift", 1, BACKEND, action="ik_absolute")
    policy, manifest = untrained(environment)
    with pytest.raises(ConfigurationError, match="has no runtime: joint_position, binary_gripper and relative"):
        write_runtime(tmp_path, policy, manifest, environment)
    assert not [*tmp_path.iterdir()]
    environment.close()


def test_a_runtime_imports_nothing_of_orbit_and_reads_its_own_format_only(tmp_path: Path) -> None:
    export(["reach", "--runtime", str(tmp_path)])
    code = "import orbit_runtime as r, sys; r.Runtime('.'); print([n for n in sys.modules if n.startswith('orbit_')])"
    shown = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "['orbit_runtime']"
    file = tmp_path / "runtime.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "format": 9}))
    with pytest.raises(ValueError, match="format 9"):
        module_of(tmp_path).Runtime(tmp_path)
