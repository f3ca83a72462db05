"""A file of a policy says what every number means: a loop of NumPy and onnxruntime alone acts as ORBIT does."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.cli.making import make_environment
from orbit_core.envs import Environment, make
from orbit_core.envs.observation_layout import groups_of, terms_of_group
from orbit_core.envs.registry import task_entries
from orbit_core.envs.terms import meaning_of
from orbit_core.interfaces import World
from orbit_learn.cli.export import main as export
from orbit_learn.cli.play import played
from orbit_learn.cli.trained import PlaySettings
from orbit_learn.policy import load_policy
from orbit_learn.pretrained import policy_path

BACKEND = default_backend()
EXAMPLES = Path(__file__).parents[2] / "examples"
Measured = dict[str, np.ndarray]


def turned_back(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """R^T v of a quaternion (w, x, y, z), from the textbook."""
    w, x, y, z = quaternion
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return matrix.T @ vector


def joints(world: World) -> Measured:
    robot = world.robots["robot"]
    return {"joint_positions": robot.joint_positions[0].numpy(), "joint_velocities": robot.joint_velocities[0].numpy()}


def hand(world: World) -> np.ndarray:
    robot = world.robots["robot"]
    return robot.frame_pose(robot.spec.end_effector.frame)[0].numpy()


def of_reach(environment: Environment) -> Measured:
    world = environment.world
    return {**joints(world), "hand_pose": hand(world), "goal": world.markers["goal"].pose[0].numpy()}


def of_lift(environment: Environment) -> Measured:
    world = environment.world
    cube = world.objects["cube"].root_pose[0].numpy()
    goal = world.markers["goal"].pose[0, :3].numpy()
    return {**joints(world), "cube_pose": cube, "hand_to_cube": cube[:3] - hand(world)[:3], "goal": goal}


def of_walking(environment: Environment) -> Measured:
    world = environment.world
    robot = world.robots["robot"]
    turn, velocity = robot.root_pose[0, 3:].double().numpy(), robot.root_velocity[0].double().numpy()
    measured = {
        **joints(world),
        "linear_velocity": turned_back(turn, velocity[:3]),
        "angular_velocity": turned_back(turn, velocity[3:]),
        "projected_gravity": turned_back(turn, np.array([0.0, 0.0, -1.0])),
        "command": environment.commands["velocity"][0, :3].numpy(),
    }
    if "height_scan" in world.sensors:
        scan: Any = world.sensors["height_scan"]
        measured["height_scan"] = scan.distances[0].clamp(max=scan.spec.max_distance).numpy()
    return measured


CASES: Mapping[str, Callable[[Environment], Measured]] = {
    "reach": of_reach,
    "lift": of_lift,
    "velocity_flat": of_walking,
    "velocity_rough_anymal_c": of_walking,
}


@pytest.mark.parametrize("policy", CASES)
def test_a_plain_loop_from_the_file_alone_acts_as_orbit_does(
    policy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)
    from onnx_loop import OnnxLoop  # pyright: ignore[reportMissingImports] - of examples/

    export([policy, "--output", str(tmp_path)])
    environment = make_environment(played(PlaySettings(policy=Path(policy), backend=BACKEND)), 1)
    learned, loop = load_policy(policy_path(policy)), OnnxLoop(tmp_path / "policy.onnx")
    action = torch.zeros(1, environment.action_size)
    worst = 0.0
    for _ in range(20):
        measured = {**CASES[policy](environment), "last_action": action[0].numpy()}
        own = loop.act(measured)
        action = learned.module(environment.observe()["policy"]).clamp(-1.0, 1.0)
        worst = max(worst, float(np.abs(own - action[0].numpy()).max()))
        world = environment.world
        robot = world.robots["robot"]
        positions = dict(zip(robot.joint_names, robot.joint_positions[0].tolist(), strict=True))
        environment.step(action)
        for joint, target in loop.joint_targets(own, positions).items():
            column = world.layout.joints_by_name.index(("robot", joint))
            sent = float(world.actuators.position_targets[0, column])  # pyright: ignore[reportAttributeAccessIssue]
            assert target == pytest.approx(sent, abs=1e-4)
    assert worst < 1e-5
    assert set(loop.terms) == set(measured)
    assert "minus its home position" in loop.describe()
    environment.close()


def test_the_loop_imports_nothing_of_orbit() -> None:
    code = "import onnx_loop, sys; print([name for name in sys.modules if name.startswith('orbit')])"
    shown = subprocess.run([sys.executable, "-c", code], cwd=EXAMPLES, capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "[]"


def test_every_term_of_every_task_says_what_it_is() -> None:
    for name, entry in task_entries().items():
        if not entry.factory.startswith("orbit_tasks"):
            continue
        task: Any = entry.task_type()()  # pyright: ignore[reportCallIssue]
        for observations in (task.observations, *(preset() for preset in task.observation_presets.values())):
            task.observations = observations
            for group in groups_of(task).values():
                for term_name, term in terms_of_group(group).items():
                    assert len(meaning_of(term).formula) > 10, f"{term_name} of {name}"


@pytest.mark.parametrize("task", ["Lift", "Velocity-Flat", "Handover"])
def test_arrays_of_a_manifest_that_belong_together_have_one_length(task: str) -> None:
    from orbit_data.manifest.manifest import Manifest
    from orbit_learn.onnx_file import deployment_metadata

    environment = make(task, 1, BACKEND)
    manifest = Manifest.of(environment, task, 0)
    for group in manifest.observations.values():
        for term in group.terms.values():
            size = int(np.prod(term.shape)) // term.history
            assert len(term.components) == len(term.offset) == size
    for term in manifest.action_terms.values():
        assert len(term.joints) == len(term.lower_limits) == len(term.upper_limits)
        assert term.offset is None or len(term.components) == len(term.offset) == len(term.scale or ())
        assert term.decoding
        assert term.frame
        assert term.rate == pytest.approx(1.0 / environment.step_dt)
    for robot in manifest.robots.values():
        arrays = [getattr(robot, name) for name in ("home_positions", "stiffness", "effort_limits", "actuators")]
        assert {len(array) for array in arrays} == {len(robot.joint_names)}
    flat = deployment_metadata(manifest, "policy", "run")
    lengths = {len(flat[key].split(",")) for key in ("joint_names", "joint_stiffness", "joint_damping")}
    assert len(lengths) == 1
    seen = manifest.observations["policy"].terms
    last = [name for n, term in seen.items() if n.endswith("last_action") for name in term.components]
    assert len(last) == environment.action_size
    assert last[0].startswith(next(iter(manifest.action_terms)))
    environment.close()


def test_policy_json_holds_the_manifest(tmp_path: Path) -> None:
    export(["reach", "--output", str(tmp_path)])
    document = json.loads((tmp_path / "policy.json").read_text())
    positions = document["manifest"]["observations"]["policy"]["terms"]["joint_positions"]
    assert positions["offset"] == document["manifest"]["robots"]["robot"]["home_positions"]
    assert positions["components"] == document["manifest"]["robots"]["robot"]["joint_names"]
