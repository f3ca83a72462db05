"""Tasks made from authored scenes: found by their file, and run like any other."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from orbit_core.cli import main
from orbit_core.envs import make
from orbit_core.envs.registry import task_entry
from orbit_core.envs.task import ROBOT
from orbit_core.interfaces.errors import ConfigurationError, OrbitError
from orbit_scenes.document import Item, SceneDocument, TaskPlan, save_document

CUBES = tuple(
    Item(name=name, object="box", parameters={"size": [0.1, 0.1, 0.1]}, position=(x, 1.0, 0.05))
    for name, x in (("red", 0.0), ("blue", 1.0))
)
TASK = TaskPlan(
    robot="cart", objects=("red", "blue"), goal=(0.0, 1.0, 0.05), size=(0.4, 0.4, 0.4), episode_length=0.4, spread=0.03
)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    cart = Item(name="cart", robot="cartpole", position=(0.0, 0.0, 1.0))
    save_document(SceneDocument(items=(*CUBES, cart), task=TASK), tmp_path / "room.toml")
    return tmp_path / "room.toml"


def test_distance_and_success_are_of_the_object_that_is_farthest_from_the_region(file: Path):
    env = make(str(file), num_envs=3, backend="mujoco")
    try:
        env.reset()
        red, blue = env.world.objects["red"], env.world.objects["blue"]
        poses = blue.root_pose.clone()
        # In the region, outside of it by 0.3 m along x, and by a diagonal.
        poses[:, :3] = torch.tensor(((0.1, 1.0, 0.05), (0.5, 1.0, 0.05), (0.5, 1.6, 0.05)))
        blue.set_root_pose(poses)
        assert env.task.metrics(env)["goal_distance_m"].tolist() == pytest.approx([0.0, 0.3, 0.5], abs=1e-5)
        assert env.task.success(env).tolist() == [True, False, False]
        assert red.root_pose.shape == (3, 7)
    finally:
        env.close()


def test_starts_vary_by_the_spread_and_no_more(file: Path):
    env = make(str(file), num_envs=16, backend="mujoco", seed=1)
    try:
        env.reset()
        moved = env.world.objects["red"].root_pose[:, :2] - torch.tensor((0.0, 1.0))
        assert float(moved.abs().max()) <= 0.03 + 1e-6
        assert float(moved.std()) > 0.005
        observation = env.reset()[0]["policy"]
        assert torch.isfinite(observation).all()
    finally:
        env.close()


def test_the_command_line_runs_a_scene_file_as_a_task(file: Path, capsys: pytest.CaptureFixture[str]):
    result = file.with_name("result.json")
    for agent in ("random", "zero"):
        words = ["run", str(file), "--backend", "mujoco", "--agent", agent, "--num-envs", "2", "--episodes", "2"]
        assert main([*words, "--json", str(result), "--overwrite"]) == 0
        assert json.loads(result.read_text())["task"] == str(file)
    assert "goal_distance_m" in capsys.readouterr().out


def test_the_plan_can_be_set_like_any_field(file: Path):
    env = make(str(file), backend="mujoco", **{"plan.size": (4.0, 4.0, 4.0)})
    try:
        env.reset()
        assert bool(env.task.success(env).all())
    finally:
        env.close()


def test_the_robot_that_acts_has_the_name_that_all_tasks_have(file: Path):
    task = task_entry(str(file)).task_type()()
    assert [robot.name for robot in task.scene().robots] == [ROBOT]
    assert task.metadata.instruction == "bring red and blue to the goal"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"task": None}, "has no task"),
        ({"task": replace(TASK, robot="red")}, "is no robot"),
        ({"items": (replace(CUBES[0], fixed=True), CUBES[1])}, "'red'.*cannot be moved"),
        ({"task": replace(TASK, action="joint_positoin")}, "joint_position"),
    ],
)
def test_a_scene_that_is_no_task_is_one_error(file: Path, change: dict[str, object], words: str):
    cart = Item(name="cart", robot="cartpole", position=(0.0, 0.0, 1.0))
    fields = {"items": CUBES, "task": TASK, **change}
    fields["items"] = (*fields["items"], cart)  # type: ignore[misc]
    save_document(SceneDocument(**fields), file)  # type: ignore[arg-type]
    with pytest.raises(OrbitError, match=words):
        make(str(file), backend="mujoco")


def test_a_scene_file_that_is_not_there_is_named():
    with pytest.raises(ConfigurationError, match=r"cannot read scene file missing\.toml"):
        task_entry("missing.toml").task_type()
