"""A person's grasp without a browser: chosen, offered, refused, moved, accepted, lifted, and the arm taken over."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest
import torch

from orbit_core.envs import Environment, make
from orbit_core.interfaces import ArgumentError, ConfigurationError, UnknownNameError
from orbit_motion.grasping import GraspWorkflow, Stage
from tests.motion.servo_world import BACKENDS


def workflow_of(env: Environment) -> GraspWorkflow:
    return GraspWorkflow(env.world, env.world.robots["robot"], env.step_dt)


@pytest.fixture(scope="module", params=BACKENDS)
def lift(request: pytest.FixtureRequest) -> Iterator[Environment]:
    env = make("Lift", num_envs=1, backend=request.param)
    yield env
    env.close()


def run(env: Environment, work: GraspWorkflow, over: Callable[[], bool], steps: int = 2000) -> None:
    for _ in range(steps):
        work.update()
        if over():
            return
        if work.stage is Stage.PLANNING:
            time.sleep(0.01)  # the plan's thread
        else:
            work.drive()
            env.world.step(env.task.decimation)
    raise AssertionError(f"still {work.stage}: {work.message}")


def settle(env: Environment, work: GraspWorkflow) -> None:
    work.update()
    run(env, work, lambda: work.stage not in (Stage.PLANNING, Stage.EXECUTING))


def test_a_cube_is_chosen_refused_moved_accepted_and_lifted(lift: Environment) -> None:
    lift.reset(seed=3)
    work = workflow_of(lift)
    work.select("cube")
    settle(lift, work)
    assert work.stage is Stage.OFFERED, work.message
    assert work.motion is not None
    assert work.search is not None
    first = work.motion.pose
    work.refuse()
    settle(lift, work)
    assert work.motion is not None, work.message
    assert not torch.equal(work.motion.pose, first)
    joints = work.driver.robot.joint_positions.clone()
    for axis, shift, reason in ((0, 0.3, "nothing of 'cube' is between"), (2, -0.03, "the open hand would be")):
        moved = first.clone()
        moved[axis] += shift
        work.move(moved)
        settle(lift, work)
        assert work.motion is None
        assert reason in work.message
        work.accept()
        settle(lift, work)
        assert work.stage is Stage.OFFERED
    torch.testing.assert_close(work.driver.robot.joint_positions, joints, atol=0.01, rtol=0.0)
    work.move(first)
    settle(lift, work)
    assert work.motion is not None, work.message
    assert work.motion.score is None
    work.accept()
    settle(lift, work)
    assert work.stage is Stage.STEERING
    assert work.lifted is not None
    assert work.lifted > 0.1, work.message
    goal = work.hand_pose() + torch.tensor([0.0, 0.08, 0.05, 0.0, 0.0, 0.0, 0.0])
    work.move(goal)
    run(lift, work, lambda: float((work.hand_pose() - goal)[:3].norm()) < 0.01, 300)
    work.set_gripper(True)
    run(lift, work, lambda: float(lift.world.objects["cube"].root_pose[0, 2]) < 0.05, 300)
    work.close()


def test_what_cannot_be_is_told(lift: Environment) -> None:
    work = workflow_of(lift)
    with pytest.raises(UnknownNameError, match="cube"):
        work.select("cub")
    with pytest.raises(ArgumentError, match="7 finite numbers"):
        work.move(torch.full((7,), torch.nan))
    work.close()


@pytest.mark.parametrize(
    ("task", "fields", "culprit"),
    [("Reach", {}, "nothing to grasp"), ("Reach", {"robot": "ur10"}, "gripper"), ("Velocity-Flat", {}, "end effector")],
)
def test_a_scene_or_robot_that_grasps_nothing_is_refused(task: str, fields: dict[str, str], culprit: str) -> None:
    env = make(task, num_envs=1, backend=BACKENDS[0], **fields)
    with pytest.raises(ConfigurationError, match=culprit):
        workflow_of(env)
    env.close()
