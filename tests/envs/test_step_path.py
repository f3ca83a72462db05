"""The way from an action to the engine: few Python calls, and a graph only where a generator has its own rate."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import pytest
import torch
from torch import Tensor
from torch._ops import OpOverload
from torch.utils._python_dispatch import TorchDispatchMode

from orbit_core.actions import ActionTerms, BinaryGripperConfig, JointPosition, JointPositionConfig
from orbit_core.backends import default_backend
from orbit_core.envs.captured_step import CapturedStep
from orbit_core.envs.environment import Environment
from orbit_core.interfaces import ConfigurationError, JointTarget, Robot, ShapeError
from orbit_tasks.lift import Lift

BACKEND = default_backend()
MOST_CALLS = 120
"""Python calls of one step of Lift on MuJoCo, all of them: the engine's binding and NumPy's wrappers too."""


MOST_OPERATIONS = 60
"""Torch operations of such a step, views among them, each 2 to 6 us on few numbers; 56 with torch 2.13."""


@dataclass(frozen=True, kw_only=True)
class SlowPositionConfig(JointPositionConfig):
    """Joint positions at half the rate of the environment's steps."""

    name: ClassVar[str] = "slow_position"

    def build(self, name: str, robot: Robot) -> JointPosition:
        generator = super().build(name, robot)
        generator.rate = 25.0
        return generator


class WrongPosition(JointPosition):
    """Joint positions without the last joint."""

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        return {JointTarget.POSITION: super().compute(inputs)[JointTarget.POSITION][:, :-1]}


@dataclass(frozen=True, kw_only=True)
class WrongPositionConfig(JointPositionConfig):
    name: ClassVar[str] = "wrong_position"

    def build(self, name: str, robot: Robot) -> JointPosition:
        return WrongPosition(name, robot, self)


def slow(num_envs: int) -> Environment:
    actions = ActionTerms(arm=SlowPositionConfig(), gripper=BinaryGripperConfig())
    return Environment(Lift(actions=actions, episode_length=0.2), num_envs, BACKEND)


def python_calls(environment: Environment, action: Tensor) -> int:
    calls = 0

    def note(frame: object, event: str, argument: object) -> None:
        nonlocal calls
        calls += event == "call"

    sys.setprofile(note)
    try:
        environment.step(action)
    finally:
        sys.setprofile(None)
    return calls


class Operations(TorchDispatchMode):
    """Counter of the torch operations that run within it."""

    count = 0

    def __torch_dispatch__(
        self, func: OpOverload, types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        self.count += 1
        return func(*args, **(kwargs or {}))


@pytest.mark.skipif(BACKEND != "mujoco", reason="the number holds for MuJoCo's binding")
def test_a_step_of_lift_makes_few_python_calls_and_torch_operations() -> None:
    environment = Environment(Lift(), 4, BACKEND)
    action = torch.zeros(4, environment.action_size)
    for _ in range(3):  # caches are filled in the first steps
        environment.step(action)
    assert python_calls(environment, action) <= MOST_CALLS
    with Operations() as operations:
        environment.step(action)
    assert operations.count <= MOST_OPERATIONS
    environment.close()


def test_a_generator_with_a_rate_of_its_own_holds_its_targets_between_turns() -> None:
    environment = slow(2)
    targets = environment.world.engine.position_targets
    held = []
    for value in (0.3, -0.3, -0.3):
        environment.step(torch.full((2, environment.action_size), value))
        held.append(targets[:, :7].clone())
    assert torch.equal(held[0], held[1])
    assert not torch.equal(held[1], held[2])
    environment.close()


def test_such_a_generator_does_the_same_in_a_captured_step() -> None:
    plain, other = slow(3), slow(3)
    other._closed = CapturedStep(other, compile=False, whole=True)
    generator = torch.Generator().manual_seed(0)
    for environment in (plain, other):
        environment.reset(seed=5)
    for _ in range(13):  # over the end of an episode
        action = 2.0 * torch.rand(3, plain.action_size, generator=generator) - 1.0
        mine, its = plain.step(action), other.step(action)
        torch.testing.assert_close(its[0], mine[0], rtol=0.0, atol=0.0)
        assert torch.equal(mine[1], its[1])
    # Even and odd steps, the latter with and without environments that were reset meanwhile.
    assert other._closed.parts[0].captured == 3
    for environment in (plain, other):
        environment.close()


def test_the_first_outputs_of_a_generator_are_checked() -> None:
    actions = ActionTerms(arm=WrongPositionConfig(), gripper=BinaryGripperConfig())
    environment = Environment(Lift(actions=actions), 2, BACKEND)
    with pytest.raises(ShapeError, match=r"output of node 'arm' 'position_targets' must have shape \(num_envs, 7\)"):
        environment.step(torch.zeros(2, environment.action_size))
    environment.close()


def test_a_rate_that_does_not_divide_the_steps_is_refused() -> None:
    @dataclass(frozen=True, kw_only=True)
    class OddConfig(JointPositionConfig):
        name: ClassVar[str] = "odd_position"

        def build(self, name: str, robot: Robot) -> JointPosition:
            generator = super().build(name, robot)
            generator.rate = 30.0
            return generator

    actions = ActionTerms(arm=OddConfig(), gripper=BinaryGripperConfig())
    with pytest.raises(ConfigurationError, match=r"rate of node 'arm', 30 Hz, does not divide"):
        Environment(Lift(actions=actions), 1, BACKEND)
