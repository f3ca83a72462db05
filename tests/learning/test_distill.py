"""A policy that sees pictures, distilled from one that sees the state: learned for real, at the smallest size."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from orbit_core.backends import default_backend, renderer_names
from orbit_core.cli import main
from orbit_core.envs import Environment, ObservationGroup, ObservationTerm
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp import common
from orbit_core.mdp.sensing import camera_color, camera_depth
from orbit_core.scene import END_EFFECTOR, CameraSpec, Channel, look_at
from orbit_learn.distill import DistillSettings, DistillTrainer, ReplayBuffer, RunningMoments
from orbit_learn.policy import PolicyActor, load_policy
from orbit_learn.trainer import Progress
from orbit_learn.training import Training, read_checkpoint
from orbit_tasks.reach import Reach, ReachState

BACKEND = default_backend()
RENDERER = "warp" if "warp" in renderer_names() else None
"""Draws fastest on a CPU; any would do."""
CAMERA = CameraSpec(
    name="hand",
    width=12,
    height=10,
    channels=(Channel.RGB, Channel.DEPTH),
    entity="robot",
    frame=END_EFFECTOR,
    pose=look_at((0.2, 0.0, -0.1), (0.0, 0.0, 0.1), (1.0, 0.0, 0.0)),
    far=2.0,
)
SETTINGS = DistillSettings(
    teacher="reach",
    iterations=6,
    steps_per_iteration=5,
    hidden_sizes=(64,),
    buffer_size=400,
    updates_per_iteration=25,
    batch_size=64,
    learning_rate=3e-3,
    shift=1,
)


@dataclass
class Pictures(ObservationGroup):
    concatenate: bool = False
    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    goal: ObservationTerm | None = ObservationTerm(lambda env: env.commands["goal"])
    hand_color: ObservationTerm | None = camera_color(CAMERA)
    hand_depth: ObservationTerm | None = camera_depth(CAMERA)


@dataclass
class PicturesAndState:
    policy: Pictures = field(default_factory=Pictures)
    teacher: ReachState | None = field(default_factory=ReachState)


def reach(num_envs: int = 4, teacher: ReachState | None = None, length: float = 0.2) -> Environment:
    observations = PicturesAndState(teacher=teacher)
    return Environment(Reach(observations=observations, episode_length=length), num_envs, BACKEND, renderer=RENDERER)


def train(trainer: DistillTrainer, iterations: int, resume: bool = False) -> list[Progress]:
    curve: list[Progress] = []
    Training(trainer, "Reach", {}).run(iterations, 100, curve.append, resume)
    return curve


def test_a_student_comes_to_do_what_its_teacher_does(tmp_path: Path) -> None:
    """The error falls to half in 6 iterations; what is kept acts as the student, resumes, and says what it saw."""
    environment = reach(teacher=ReachState())
    trainer = DistillTrainer(environment, SETTINGS, tmp_path, 0)
    curve = train(trainer, SETTINGS.iterations)
    assert curve[-1].loss < 0.5 * curve[0].loss
    steps = environment.max_episode_steps + SETTINGS.iterations * SETTINGS.steps_per_iteration
    assert curve[-1].env_steps == steps * environment.num_envs
    assert curve[-1].episodes > 0, "in the end the student leads"

    description = load_policy(tmp_path).description
    assert [str(part) for part in description.observation_parts] == [
        "joint_positions (9)", "goal (7)", "hand_color (10x12x3 uint8)", "hand_depth (10x12x1)",
    ]  # fmt: skip
    seen = environment.observe()["policy"]
    with torch.no_grad():
        expected = trainer._student(seen)
    assert expected.abs().max() > 0.05
    torch.testing.assert_close(PolicyActor(environment, tmp_path).act(), expected, atol=1e-6, rtol=0.0)

    again = DistillTrainer(environment, replace(SETTINGS, iterations=8), tmp_path, 1)
    again.restore(read_checkpoint(tmp_path / "checkpoint_5.safetensors", "distill"), 5)
    torch.testing.assert_close(again.actor().module(seen), expected, atol=1e-6, rtol=0.0)
    resumed = train(DistillTrainer(environment, replace(SETTINGS, iterations=8), tmp_path, 1), 8, resume=True)
    assert [progress.iteration for progress in resumed] == [6, 7]
    assert resumed[-1].loss < 0.6 * curve[0].loss
    environment.close()


def test_a_student_may_see_terms_side_by_side(tmp_path: Path) -> None:
    """As from a teacher that sees the same: the file then holds a perceptron, like those of the libraries."""
    environment = Environment(Reach(episode_length=0.2), 8, BACKEND)
    curve = train(DistillTrainer(environment, SETTINGS, tmp_path, 0), 4)
    assert curve[-1].loss < 0.7 * curve[0].loss
    assert load_policy(tmp_path).description.concatenated
    environment.close()


def test_the_expert_of_the_task_may_teach(tmp_path: Path) -> None:
    """What it would do from where the student has led: its phases go on with the student's episode."""
    environment = Environment(Reach(action="ik_relative", episode_length=0.4), 8, BACKEND)
    settings = replace(SETTINGS, teacher="expert", teacher_led=0.0)
    curve = train(DistillTrainer(environment, settings, tmp_path, 0), 4)
    assert curve[-1].loss < 0.7 * curve[0].loss
    environment.close()
    midway = Environment(Reach(action="ik_relative", episode_length=2.0, expert_starts=0.5), 2, BACKEND)
    with pytest.raises(ConfigurationError, match="set expert_starts=0"):
        DistillTrainer(midway, settings, tmp_path, 0)
    midway.close()


def test_what_the_teacher_was_learned_with_must_be_there(tmp_path: Path) -> None:
    environment = reach(2)
    with pytest.raises(ConfigurationError, match=r"no observation group .* Reach was learned with.*'policy'"):
        DistillTrainer(environment, SETTINGS, tmp_path, 0)
    with pytest.raises(ConfigurationError, match="needs a teacher"):
        DistillTrainer(environment, replace(SETTINGS, teacher=""), tmp_path, 0)
    environment.close()


def test_the_command_line_distills_from_pixels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = f"train Reach --num-envs 2 --backend {BACKEND} --library distill --teacher reach --iterations 1".split()
    words += ["--set", "observations=pixels", "--set", "episode_length=0.06", "--output", str(tmp_path / "kept")]
    small = ("steps_per_iteration=1", "updates_per_iteration=1", "batch_size=4", "buffer_size=20", "hidden_sizes=8")
    words += itertools.chain.from_iterable(("--distillation", setting) for setting in small)
    drawn = [] if RENDERER is None else ["--renderer", RENDERER]
    assert main(words + drawn) == 0
    assert "mean loss" in capsys.readouterr().out
    terms = {part.name for part in load_policy(tmp_path / "kept").description.observation_parts}
    assert {"hand_color", "hand_depth", "front_color", "front_depth", "goal"} <= terms

    assert main([*words[:6], "--ppo", "clip=0.1", "--teacher", "reach", "--library", "distill", *drawn]) != 0
    assert "takes no --ppo" in capsys.readouterr().err
    assert main([*words[:6], "--teacher", "reach", *drawn]) != 0
    assert "takes no --teacher" in capsys.readouterr().err


def test_the_buffer_keeps_the_newest_steps() -> None:
    """Depth to within half a millimetre in a metre, colours as they are; the oldest steps give way."""
    buffer = ReplayBuffer(7, observation(0), 1)  # rounded down to three steps of two environments
    for step in range(5):
        buffer.add(observation(step), torch.full((2, 1), float(step)))
    seen, actions = buffer.sample(200)
    assert isinstance(seen, dict)
    assert buffer.size == 6
    assert set(actions.flatten().tolist()) == {2.0, 3.0, 4.0}
    assert seen["color"].dtype == torch.uint8
    assert torch.equal(seen["color"][:, 0, 0, 0].float(), 10.0 * actions[:, 0])
    torch.testing.assert_close(seen["depth"][:, 0, 0], 1.0 + 0.1234 * actions, atol=6e-4, rtol=0.0)
    assert torch.equal(seen["vector"], actions * torch.pi)


def test_running_moments_are_those_of_all_rows() -> None:
    torch.manual_seed(0)
    rows = 100.0 + 3.0 * torch.randn(50, 4)
    moments = RunningMoments(4, torch.device("cpu"))
    for chunk in rows.split([3, 40, 7]):
        moments.add(chunk)
    torch.testing.assert_close(moments.mean, rows.mean(0))
    torch.testing.assert_close(moments.std, rows.std(0, unbiased=False) + 0.01)


def observation(step: int) -> dict[str, Tensor]:
    return {
        "color": torch.full((2, 4, 4, 3), 10 * step, dtype=torch.uint8),
        "depth": torch.full((2, 4, 4, 1), 1.0 + 0.1234 * step),
        "vector": torch.full((2, 1), step * torch.pi),
    }
