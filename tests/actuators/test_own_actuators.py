"""Actuators of one's own: refused where nothing computes them, and where something does, captured like ORBIT's own."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch
from torch import Tensor

from orbit_core.actuators import ActuatorModel, Actuators, actuator_models
from orbit_core.backends import default_backend
from orbit_core.dynamics.random import RandomStreams
from orbit_core.envs import Environment
from orbit_core.envs.captured_step import CapturedStep
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.scene import ActuatorConfig, IdealPd, ImplicitPd, Scene
from orbit_tasks.reach import Reach

BACKEND = default_backend()
Pendulums = Callable[..., Any]


@dataclass(frozen=True, kw_only=True)
class Unknown(ActuatorConfig):
    """Nothing computes it."""

    knee: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Softened(IdealPd):
    """A PD law with a number that the law does not read."""

    softness: float = 0.5


@dataclass(frozen=True, kw_only=True)
class Named(IdealPd):
    """A PD law by another name."""


@dataclass(frozen=True, kw_only=True)
class Driven(ImplicitPd):
    """A drive of the engine's with a model beside it."""

    gain: float = 1.0


class Counting(ActuatorModel):
    """Counts its turns in plain Python."""

    turns = 0

    def efforts(self, position: Tensor, velocity: Tensor, targets: Any) -> Tensor:
        self.turns += 1
        return torch.full_like(position, 0.01 * self.turns)


def actuators_of(engine: Any) -> Actuators:
    random = RandomStreams(engine.num_envs, 0, engine.device)
    random.reset()
    return Actuators(engine, engine.layout, random)


@pytest.fixture
def example(forgotten_names: None) -> Iterator[ModuleType]:
    path = Path(__file__).parents[2] / "examples" / "own_actuator.py"
    spec = importlib.util.spec_from_file_location("own_actuator", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["own_actuator"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["own_actuator"]


@pytest.mark.parametrize("group", [Unknown, Softened, ActuatorConfig])
def test_a_class_that_nothing_computes_is_refused_with_the_remedy(pendulums: Pendulums, group: type) -> None:
    with pytest.raises(UnknownNameError, match=rf"{group.__name__}.*of 'robot'.*IdealPd.*actuator_models\(\)\.add"):
        actuators_of(pendulums((group(joints=("joint_a",), stiffness=1.0),)))


def test_a_class_that_adds_nothing_has_the_law_of_its_base(pendulums: Pendulums) -> None:
    engine = pendulums((Named(joints=("joint_a",), stiffness=3.0),))
    actuators = actuators_of(engine)
    actuators.position_targets[:] = 0.5
    actuators.apply()
    assert engine.efforts[:, 0].tolist() == [1.5, 1.5]


def test_what_is_registered_wrongly_is_named(pendulums: Pendulums, forgotten_names: None) -> None:
    actuator_models().add("Unknown", dict)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ConfigurationError, match=r"this program of group orbit\.actuators names .*dict.*ActuatorModel"):
        actuators_of(pendulums((Unknown(joints=("joint_a",)),)))
    actuator_models().add("Driven", Counting)
    with pytest.raises(ConfigurationError, match="derives from ImplicitPd, which the engine drives"):
        actuators_of(pendulums((Driven(joints=("joint_a",)),)))


def test_the_example_is_its_law_remembers_and_resets(pendulums: Pendulums, example: ModuleType) -> None:
    group = example.SpringMotor(joints=("joint_[ac]",), stiffness=4.0, damping=0.5, motor_speed=2.0, effort_limit=0.06)
    engine = pendulums((group, IdealPd(joints=("joint_b",), stiffness=2.0)))
    actuators = actuators_of(engine)
    engine.q[:], engine.v[:] = 0.1, 0.01
    actuators.position_targets[:] = 1.0
    actuators.apply()
    first = 4.0 * 0.005 * 2.0 - 0.5 * 0.01  # the motor goes as far as its speed allows in one step
    torch.testing.assert_close(engine.efforts, torch.tensor([[first, 1.8, first]] * 2))
    saved = actuators.save_state()
    actuators.apply()
    assert engine.efforts[0, 0] == pytest.approx(0.06), "the effort limit"
    actuators.reset(torch.tensor([1]))
    actuators.apply()
    assert engine.efforts[:, 0].tolist() == pytest.approx([0.06, first])
    actuators.load_state(saved)
    actuators.set_gains([0], torch.full((2, 1), 0.0), torch.full((2, 1), 1.0))
    actuators.apply()
    assert engine.efforts[0, 0] == pytest.approx(-0.01)


@dataclass(kw_only=True)
class OwnReach(Reach):
    """Reach with motors of one's own in the arm."""

    drive: Any = None

    def scene(self) -> Scene:
        scene = super().scene()
        (robot,) = scene.robots
        groups = tuple(self.drive(group) if isinstance(group, ImplicitPd) else group for group in robot.actuators)
        return replace(scene, robots=(replace(robot, actuators=groups),))


def rollout(environment: Environment, steps: int = 25) -> Tensor:
    torch.manual_seed(0)
    seen = [environment.step(2.0 * torch.rand(3, environment.action_size) - 1.0)[0]["policy"] for _ in range(steps)]
    environment.close()
    return torch.stack(seen)  # pyright: ignore[reportArgumentType]


def test_the_example_is_captured_like_others(example: ModuleType) -> None:
    def spring(group: ImplicitPd) -> Any:
        return example.SpringMotor(joints=group.joints, stiffness=20.0, damping=1.0, motor_speed=1.0)

    plain, other = (Environment(OwnReach(drive=spring, episode_length=0.2), 3, BACKEND) for _ in range(2))
    other._closed = CapturedStep(other, compile=False, whole=True)
    torch.testing.assert_close(rollout(other), rollout(plain), rtol=0.0, atol=0.0)


def test_a_model_that_counts_in_python_is_refused_by_name(forgotten_names: None) -> None:
    actuator_models().add("Unknown", Counting)
    task = OwnReach(drive=lambda group: Unknown(joints=group.joints))
    environment = Environment(task, 3, BACKEND)
    environment._closed = CapturedStep(environment, compile=False, whole=True)
    with pytest.warns(RuntimeWarning, match=r"Counting of joint '\w+'\.turns \(.*test_own_actuators\.py:\d+\) changes"):
        rollout(environment, 3)
