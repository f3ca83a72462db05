"""What differs between environments: each term does what it says, and every environment draws for itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor

from orbit_core.backends import backend_names, default_backend
from orbit_core.envs import CurriculumTerm, EventTerm, EventTime, make
from orbit_core.envs.environment import Environment
from orbit_core.interfaces import ConfigurationError, UnknownNameError, UnsupportedCapabilityError
from orbit_core.mdp import randomize
from orbit_core.mdp.randomize import Range
from orbit_tasks.cabinet import Cabinet
from orbit_tasks.lift import Lift
from orbit_tasks.velocity_flat import VelocityFlat

TASKS = ("Reach", "Lift", "Cabinet", "Velocity-Flat", "Handover")


@pytest.mark.rotates
@pytest.mark.parametrize("backend", backend_names())
@pytest.mark.parametrize("task", TASKS)
def test_every_task_runs_randomized_on_every_backend(task: str, backend: str) -> None:
    environment = make(task, 3, backend, domain_randomization=True, episode_length=0.2)
    for _ in range(15):
        observation, reward, *_ = environment.step(torch.zeros(3, environment.action_size))
    assert torch.isfinite(observation["policy"]).all()
    assert torch.isfinite(reward).all()
    environment.close()


def test_a_heavier_cube_is_a_slower_one() -> None:
    """The same force on every cube: what it gains in speed tells its mass."""
    task = Lift()
    task.events.cube_mass = EventTerm(randomize.masses("cube", Range(0.5, 2.0)), EventTime.STARTUP)
    environment = Environment(task, 16, default_backend())
    cube = environment.world.objects["cube"]
    up = torch.tensor([0.0, 0.0, 10.0, 0.0, 0.0, 0.0]).expand(16, 1, 6)
    environment.reset(seed=3)
    cube.set_wrenches(up)
    environment.world.step(4)
    masses = 10.0 / (cube.root_velocity[:, 2] / (4 * task.physics_dt) + 9.81)
    assert masses.min() > 0.05 - 1e-4
    assert masses.max() < 0.2 + 1e-4
    assert masses.max() > 2.0 * masses.min()
    environment.reset()
    cube.set_wrenches(up)
    environment.world.step(4)
    again = 10.0 / (cube.root_velocity[:, 2] / (4 * task.physics_dt) + 9.81)
    torch.testing.assert_close(again, masses, rtol=1e-3, atol=0.0)  # drawn once
    environment.close()


def test_pushes_come_when_they_are_due_and_not_else() -> None:
    task = VelocityFlat()
    push = randomize.push("robot", Range(1.0, 2.0))
    task.events.push = EventTerm(push, EventTime.INTERVAL, interval=(0.1, 0.2))
    pushed, plain = Environment(task, 32, default_backend()), Environment(VelocityFlat(), 32, default_backend())
    pushed.reset(seed=1), plain.reset(seed=1)
    still = torch.zeros(32, plain.action_size)
    first = torch.full((32,), -1)
    for step in range(12):
        pushed.step(still), plain.step(still)
        speed = (pushed.world.robots["robot"].root_velocity - plain.world.robots["robot"].root_velocity)[:, :2]
        first[(first < 0) & (speed.norm(dim=1) > 0.5)] = step
    # 0.1 s to 0.2 s are 5 to 10 steps: so many come before the step that begins with the push.
    assert first.min() == 5
    assert first.max() == 10
    pushed.close(), plain.close()


def test_a_delay_shows_what_was_and_a_bias_stays() -> None:
    task = Lift(action="joint_position_relative")
    late = replace(task.observations.policy.joint_positions, delay=(3, 3))
    off = replace(task.observations.policy.joint_velocities, bias_std=0.5)
    task.observations.policy = replace(task.observations.policy, joint_positions=late, joint_velocities=off)
    environment = Environment(task, 4, default_backend())
    robot = environment.world.robots["robot"]
    joints = len(robot.joint_names)
    environment.reset(seed=0)
    truth, biases = [robot.joint_positions - robot.home_positions], []
    for _ in range(8):
        seen = environment.step(0.5 * torch.ones(4, environment.action_size))[0]["policy"]
        truth.append((robot.joint_positions - robot.home_positions).clone())
        torch.testing.assert_close(seen[:, :joints], truth[max(0, len(truth) - 4)])
        biases.append(seen[:, joints : 2 * joints] - robot.joint_velocities)
    torch.testing.assert_close(biases[-1], biases[0])
    assert biases[0].std() > 0.2
    environment.reset(env_ids=torch.tensor([2]))
    seen = environment.observe()["policy"]
    after = seen[:, joints : 2 * joints] - robot.joint_velocities
    torch.testing.assert_close(after[[0, 1, 3]], biases[0][[0, 1, 3]])
    assert not torch.allclose(after[2], biases[0][2])
    torch.testing.assert_close(seen[2, :joints], (robot.joint_positions - robot.home_positions)[2])
    torch.testing.assert_close(seen[0, :joints], truth[-4][0])  # others are as late as before, and no later
    environment.close()


def test_each_environment_draws_for_itself_whatever_their_number() -> None:
    many, few = (make("Velocity-Flat", count, default_backend(), domain_randomization=True) for count in (5, 2))
    seen = [(e.reset(seed=4)[0]["policy"], e.step(torch.zeros(e.num_envs, 12))[0]["policy"]) for e in (many, few)]
    torch.testing.assert_close(seen[0][0][:2], seen[1][0])
    torch.testing.assert_close(seen[0][1][:2], seen[1][1])
    many.close(), few.close()


def bold(env: Environment) -> Tensor:
    return torch.where(env.state.last_action[:, 0] > 0.0, 0.3, -0.2)


@dataclass
class ByBoldness:
    skill: CurriculumTerm | None = CurriculumTerm(bold)


def test_difficulty_follows_what_episodes_come_to() -> None:
    task = VelocityFlat(curriculum_enabled=True, episode_length=0.02, curriculum=ByBoldness())  # pyright: ignore
    environment = Environment(task, 2, default_backend())
    action = torch.zeros(2, environment.action_size)
    action[0, 0] = 1.0
    courses = []
    for _ in range(5):
        info = environment.step(action)[4]
        courses.append(environment.state.difficulty.clone())
    torch.testing.assert_close(torch.stack(courses)[:, 0], torch.tensor([0.3, 0.6, 0.9, 1.0, 1.0]))
    assert not torch.stack(courses)[:, 1].any()
    torch.testing.assert_close(info["final"].metrics["difficulty"], torch.tensor([1.0, 0.0]))
    assert environment.commands["velocity"][1].abs().max() <= 0.25
    environment.close()


def test_a_range_opens_with_difficulty() -> None:
    environment = make("Reach", 1000, default_backend())
    environment.state.difficulty[:500] = 0.0
    environment.state.difficulty[500:] = 0.5
    drawn = Range(0.0, 4.0, easy=1.0).sample(environment, (), environment.all_ids)
    assert (drawn[:500] == 1.0).all()
    assert drawn[500:].min() == pytest.approx(0.5, abs=0.05)
    assert drawn[500:].max() == pytest.approx(2.5, abs=0.05)
    environment.close()


def test_what_cannot_be_is_refused() -> None:
    push = randomize.push("table", Range(1.0, 1.0))
    task = Lift()
    task.events.friction = EventTerm(push, EventTime.INTERVAL)
    with pytest.raises(ConfigurationError, match="interval of event 'friction' must be 0 < least"):
        Environment(task, 1, default_backend())
    task.events.friction = EventTerm(push, EventTime.RESET)
    with pytest.raises(ConfigurationError, match="'table' cannot be pushed: its base is fixed"):
        Environment(task, 1, default_backend())
    task.events.friction = EventTerm(randomize.masses("cub", Range(1.0, 1.0)))
    with pytest.raises(UnknownNameError, match="cube"):
        Environment(task, 1, default_backend())
    with pytest.raises(ConfigurationError, match="low <= high"):
        Range(2.0, 1.0)
    with pytest.raises(ConfigurationError, match="has no curriculum: leave curriculum_enabled out"):
        make("Lift", 1, default_backend(), curriculum_enabled=True)
    late = Lift()
    late.observations.policy.goal = replace(late.observations.policy.goal, delay=(2, 1))
    with pytest.raises(ConfigurationError, match="delay of observation term 'goal'"):
        Environment(late, 1, default_backend())


def test_joints_rub_and_drag_otherwise_in_each_environment() -> None:
    """The drawer's damping and friction, told by how it slows down; a backend that cannot is answered with who can."""
    task = Cabinet()
    parameters = randomize.joint_parameters("cabinet", Range(0.5, 2.0), Range(0.5, 2.0), joints=("drawer_joint",))
    task.events.masses = EventTerm(parameters, EventTime.STARTUP)
    environment = Environment(task, 4, "mujoco")
    environment.reset(seed=0)
    cabinet = environment.world.objects["cabinet"]
    drawer = cabinet.find_joints("drawer_joint")
    cabinet.set_joint_state(velocities=torch.full((4, 1), 1.0), joints=drawer)
    environment.world.step(20)
    assert len({round(speed, 4) for speed in cabinet.joint_velocities[:, drawer[0]].tolist()}) == 4
    environment.close()
    with pytest.raises(UnsupportedCapabilityError, match=r"joint parameters of 'cabinet'.*choose backend 'mujoco' or"):
        Environment(task, 1, "bullet")


def test_joints_stop_at_limits_of_their_own_environment() -> None:
    """The drawer, pulled out; a snapshot holds its limits; what is out of order or cannot be set is one error."""
    task = Cabinet()
    event = randomize.joint_limits("cabinet", upper=Range(-0.2, -0.1), joints=("drawer_joint",))
    task.events.masses = EventTerm(event, EventTime.STARTUP)
    environment = Environment(task, 4, "mujoco")
    environment.reset(seed=0)
    world, cabinet = environment.world, environment.world.objects["cabinet"]
    (drawer,) = cabinet.find_joints("drawer_joint")
    saved, limit = world.save_state(), cabinet.position_limits[drawer, 1].item()
    ends = []
    for _ in range(2):
        cabinet.set_joint_state(velocities=torch.full((4, 1), 3.0), joints=(drawer,))
        furthest = torch.zeros(4)
        for _ in range(50):
            world.step(1)
            furthest = torch.maximum(furthest, cabinet.joint_positions[:, drawer])
        ends.append(furthest)
        cabinet.set_joint_limits(torch.zeros(4, 1), torch.full((4, 1), 0.05), (drawer,))
        world.load_state(saved)
    assert ((ends[0] > limit - 0.21) & (ends[0] < limit - 0.09)).all()
    assert len({round(end, 4) for end in ends[0].tolist()}) == 4
    torch.testing.assert_close(*ends)
    with pytest.raises(ConfigurationError, match="lie above the upper ones"):
        cabinet.set_joint_limits(torch.ones(4, 1), torch.zeros(4, 1), (drawer,))
    environment.close()
    with pytest.raises(UnsupportedCapabilityError, match=r"joint limits of 'cabinet'.*choose backend 'mujoco' or"):
        Environment(task, 1, "bullet")
