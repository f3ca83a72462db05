"""Checks that every task is held to: order of returns, limits of joints, coverage of starts, and chance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from orbit_conformance.task_audit import EXPERT, Status, TaskAudit, audit_task, coverage
from orbit_core.cli import main
from orbit_core.envs import Environment, EventTerm, TaskMetadata
from orbit_core.envs.registry import task_entries
from orbit_core.envs.task import TaskCheck, TaskException
from orbit_core.mdp import common
from orbit_motion.experts import Expert
from orbit_tasks.reach import Reach

QUICK = ("Reach", "Lift", "Stack", "Cabinet", "Hockey", "Cartpole-Balance", "Velocity-Flat")
"""Tasks whose audit takes seconds; the whole is run by ``orbit check-task``."""


def _status(audit: TaskAudit) -> dict[TaskCheck, Status]:
    return {verdict.check: verdict.status for verdict in audit.verdicts}


@pytest.mark.rotates
@pytest.mark.parametrize("task", QUICK)
def test_a_task_is_as_its_checks_ask_or_as_it_declares(task: str) -> None:
    audit = audit_task(task, "mujoco", episodes=4, start_samples=256)
    assert not audit.faults


def test_every_exception_is_declared_once_and_with_a_reason() -> None:
    for name in task_entries():
        exceptions = task_entries()[name].task_type().metadata.exceptions
        checks = [exception.check for exception in exceptions]
        assert len(checks) == len({*checks}), name
        assert all(exception.reason for exception in exceptions), name


@dataclass(kw_only=True)
class Won(Reach):
    """Reach whose goal is always reached, and whose start is declared to be narrow."""

    metadata: TaskMetadata = TaskMetadata(exceptions=(TaskException(TaskCheck.START_AREA, "it is not"),))

    def success(self, env: Environment) -> Tensor:
        return torch.ones(env.num_envs, dtype=torch.bool)


@dataclass(kw_only=True)
class Idle(Reach):
    """Reach whose expert stays where it is."""

    metadata: TaskMetadata = TaskMetadata(exceptions=(TaskException(TaskCheck.EXPERT_BEATS_ZERO, "it is idle"),))

    def expert(self, env: Environment) -> Expert:
        expert = super().expert(env)
        expert.compute = lambda inputs: {"action": torch.zeros_like(env.state.last_action)}  # type: ignore[method-assign]
        return expert


def test_a_trivial_success_fails_and_a_declaration_that_holds_no_more_is_stale() -> None:
    audit = audit_task(Won(episode_length=0.2), "mujoco", episodes=2, start_samples=128)
    status = _status(audit)
    assert status[TaskCheck.TRIVIAL_AGENTS] is Status.FAILS
    assert status[TaskCheck.START_AREA] is Status.STALE
    assert {fault.check for fault in audit.faults} >= {TaskCheck.TRIVIAL_AGENTS, TaskCheck.START_AREA}


def test_an_expert_that_earns_no_more_than_zero_is_declared_or_fails() -> None:
    audit = audit_task(Idle(episode_length=0.4), "mujoco", episodes=2, start_samples=2)
    assert _status(audit)[TaskCheck.EXPERT_BEATS_ZERO] is Status.DECLARED
    assert audit.agents[EXPERT].episode_return.value == pytest.approx(audit.agents["zero"].episode_return.value)


def test_joints_beyond_their_velocity_limit_are_counted() -> None:
    task = Reach(episode_length=0.4)
    task.events.place_robot = None
    slow = audit_task(task, "mujoco", episodes=2, start_samples=2)
    assert slow.velocity.beyond == 0.0

    def thrown(env: Environment[Reach], env_ids: Tensor) -> None:
        robot = common.robot_of(env.world)
        home = robot.home_positions.expand(len(env_ids), -1)
        robot.set_joint_state(home, torch.full_like(home, 20.0), env_ids=env_ids)

    task = Reach(episode_length=0.4)
    task.events.place_robot = EventTerm(thrown)
    fast = audit_task(task, "mujoco", episodes=2, start_samples=2)
    assert fast.velocity.beyond > 0.01
    assert fast.velocity.peak > 2.0
    assert _status(fast)[TaskCheck.VELOCITY_LIMITS] is Status.FAILS


def test_coverage_measures_area_and_yaw() -> None:
    generator = torch.Generator().manual_seed(0)
    draws = torch.rand(4096, 3, generator=generator)
    yaw = math.pi * (draws[:, 2] - 0.5)
    poses = torch.stack(
        (0.4 * draws[:, 0], 0.2 * draws[:, 1], draws[:, 0] * 0.0, (yaw / 2).cos(), 0 * yaw, 0 * yaw, (yaw / 2).sin()), 1
    )
    square = coverage("square", poses)
    assert square.area == pytest.approx(0.08, rel=0.15)
    assert square.yaw == pytest.approx(0.5, abs=0.03)
    corners = poses.clone()
    corners[:, :2] = torch.tensor([0.4, 0.2]) * draws[:, :2].round() + 0.03 * draws[:, :2]
    assert coverage("corners", corners).area < 0.02
    still = coverage("still", poses[:1].expand(64, 7))
    assert (still.area, still.yaw) == (0.0, 0.0)
    line = poses.clone()
    line[:, 1] = 0.0
    assert coverage("line", line).area == 0.0


def test_the_command_says_by_its_exit_code_what_holds(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check-task", "Reach", "--backend", "mujoco", "--episodes", "2", "--start-samples", "128"]) == 0
    assert "1 tasks checked, 0 with faults" in capsys.readouterr().out
    assert main(["check-task", "Reech"]) == 2
    assert "Reach" in capsys.readouterr().err
    assert main(["check-task", "Reach", "--episodes", "0"]) == 2
