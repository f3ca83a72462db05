"""Several robots act in one environment: side by side as a whole, and each with its own share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.envs import Environment, ObservationTerm, RewardTerm, make
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.mdp import common
from orbit_motion.experts import Expert, Phase
from orbit_tasks.handover import GIVER, GRIP, RECEIVER, Handover, grip
from orbit_tasks.lift import Lift

BACKEND = default_backend()


@pytest.fixture(scope="module")
def handover():
    environment = make("Handover", num_envs=3, backend=BACKEND)
    yield environment
    environment.close()


def random_actions(environment: Environment) -> torch.Tensor:
    return 2.0 * torch.rand(3, environment.action_size, generator=torch.Generator().manual_seed(0)) - 1.0


def test_an_agents_action_moves_that_agent_alone(handover: Environment) -> None:
    assert handover.multi_agent is not None
    robots = [handover.world.robots[agent] for agent in (GIVER, RECEIVER)]
    handover.reset(seed=0)
    before = [robot.joint_positions.clone() for robot in robots]
    homeward = {agent: torch.zeros(3, size) for agent, size in handover.multi_agent.action_sizes.items()}
    homeward[RECEIVER][:, :7] = 0.2
    for _ in range(10):
        handover.step(handover.multi_agent.action(homeward))
    still, moved = [robot.joint_positions - old for robot, old in zip(robots, before, strict=True)]
    assert still[:, :7].abs().max() < 0.06  # home is within the 0.05 rad by which it began elsewhere
    assert moved[:, :7].amax(1).min() > 0.1


def test_an_agent_sees_its_own_terms_and_what_all_see(handover: Environment) -> None:
    assert handover.multi_agent is not None
    observation, _ = handover.reset(seed=0)
    world = handover.world
    seen = handover.multi_agent.observations(observation["policy"])
    for agent in (GIVER, RECEIVER):
        robot = world.robots[agent]
        joints = len(robot.joint_names)
        assert seen[agent].shape == (3, handover.multi_agent.layouts[agent].size)
        torch.testing.assert_close(seen[agent][:, :joints], robot.joint_positions - robot.home_positions)
        torch.testing.assert_close(seen[agent][:, -10:-3], world.objects["rod"].root_pose)
        torch.testing.assert_close(seen[agent][:, -3:], handover.commands["goal"])
    own = handover.multi_agent.action_sizes[GIVER]
    action = random_actions(handover)
    seen = handover.multi_agent.observations(handover.step(action)[0]["policy"])
    torch.testing.assert_close(seen[GIVER][:, -10 - own : -10], action[:, :own])
    torch.testing.assert_close(seen[RECEIVER][:, -10 - own : -10], action[:, own:])


def test_agents_earn_their_own_terms_and_those_of_all(handover: Environment) -> None:
    assert handover.multi_agent is not None
    handover.reset(seed=0)
    _, reward, *_ = handover.step(random_actions(handover))
    earned = handover.multi_agent.rewards()
    parts = dict(zip(handover.reward_terms, handover.reward_sums, strict=True))  # of the episode's only step
    for agent in (GIVER, RECEIVER):
        mine = [part for name, part in parts.items() if not name.startswith(RECEIVER if agent == GIVER else GIVER)]
        torch.testing.assert_close(earned[agent], torch.stack(mine).sum(0))
    shared = torch.stack([parts[name] for name in ("lift", "track", "track_finely")]).sum(0)
    torch.testing.assert_close(earned[GIVER] + earned[RECEIVER] - shared, reward)
    assert not torch.allclose(earned[GIVER], earned[RECEIVER])


def test_where_one_robot_acts_nothing_is_shared() -> None:
    environment = make("Lift", num_envs=1, backend=BACKEND)
    assert environment.multi_agent is None
    assert [generator.name for generator in environment.actions.generators] == ["joint_position", "gripper"]
    environment.close()


@dataclass(kw_only=True)
class Ghostly(Lift):
    agents = ("robot", "ghost")


def test_whoever_is_not_there_is_named(handover: Environment) -> None:
    assert handover.multi_agent is not None
    with pytest.raises(UnknownNameError, match=r"unknown robot 'ghost' in the scene of task Ghostly.*known: robot"):
        Environment(Ghostly(), 1, BACKEND)
    task = Handover()
    task.rewards.lift = RewardTerm(common.joint_speed, 1.0, agent="reciever")
    with pytest.raises(UnknownNameError, match=r"unknown agent 'reciever' in a term of task Handover.*'receiver'"):
        Environment(task, 1, BACKEND)
    lift = Lift()
    lift.observations.policy.goal = ObservationTerm(common.last_action, agent=GIVER)
    with pytest.raises(UnknownNameError, match="unknown agent 'giver' in a term of task Lift"):
        Environment(lift, 1, BACKEND)
    with pytest.raises(UnknownNameError, match=r"unknown agent 'receiver'.*each needs an action"):
        handover.multi_agent.action({GIVER: torch.zeros(3, 8)})
    phase = Phase(lambda env: common.hand_pose(env, GIVER))
    with pytest.raises(ConfigurationError, match="equally many phases for each agent: giver, receiver"):
        Expert(handover, {GIVER: [phase], RECEIVER: [phase, replace(phase)]})


def test_neither_arm_can_do_it_alone() -> None:
    """However a Panda is bent, it reaches neither the rod's start nor, by its own end of the rod, the goal."""
    environment = make("Handover", num_envs=256, backend=BACKEND)
    world, task = environment.world, environment.task
    beyond = {
        RECEIVER: grip(environment, RECEIVER),
        GIVER: environment.commands["goal"] - torch.tensor([GRIP, 0.0, 0.0]),
    }
    for agent, wanted in beyond.items():
        robot = world.robots[agent]
        low, high = robot.position_limits.unbind(1)
        share = torch.rand(50_000, len(low), generator=torch.Generator().manual_seed(0))
        joints = low + (high - low) * share
        joints[:, 3] = high[3] - (high - low)[3] * share[:, 3] ** 3  # the elbow, which is mostly stretched so
        tree = KinematicTree(robot.spec.articulation)
        hands = tree.frame_pose(
            tree.forward(robot.root_pose[:1].expand(len(joints), -1), joints), robot.spec.end_effector.frame
        )
        assert torch.cdist(wanted, hands[:, :3]).min() > task.tolerance
    environment.close()


def test_arms_wait_for_each_other(handover: Environment) -> None:
    """The giver is where it should be at once, and goes on only when the receiver has arrived too."""
    handover.reset(seed=0)
    _task = handover.task
    here = Phase(lambda env: common.hand_pose(env, GIVER))
    lift = torch.tensor([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    above = common.hand_pose(handover, RECEIVER) + lift
    there = Phase(lambda env: above, position_tolerance=0.02)
    expert = Expert(handover, {GIVER: [here, here], RECEIVER: [there, there]})
    first = torch.full((3,), -1)
    for step in range(80):
        far = (common.hand_pose(handover, RECEIVER) - above)[:, :3].norm(dim=1) > 0.021
        handover.step(expert.compute({})["action"])
        assert not (far & (expert.phase == 1) & (first < 0)).any()
        first[(first < 0) & (expert.phase == 1)] = step
    assert (first > 3).all()
