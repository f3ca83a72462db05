"""PettingZoo's own view of a task with several agents: its test, episodes' ends, and independent learners."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from pettingzoo.test import parallel_api_test
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.multi_agents.torch.ippo import IPPO, IPPO_CFG
from skrl.resources.preprocessors.torch import RunningStandardScaler
from torch import Tensor, nn

from orbit_core.backends import default_backend
from orbit_core.envs import Environment, RewardTerm
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp import common
from orbit_learn.networks import perceptron
from orbit_learn.pettingzoo import ParallelEnvironment
from orbit_tasks.handover import GIVER, RECEIVER, Handover

BACKEND = default_backend()


def test_pettingzoos_own_test_passes() -> None:
    environment = ParallelEnvironment("Handover", backend=BACKEND, episode_length=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(environment, num_cycles=120)
    assert str(environment) == "orbit/Handover"
    environment.close()


def test_an_episode_ends_for_all_and_shows_its_end() -> None:
    environment = ParallelEnvironment("Handover", backend=BACKEND, episode_length=0.06)
    inner, whole = environment.environment, environment.environment.observation_size
    assert environment.possible_agents == [GIVER, RECEIVER]
    shapes = [environment.observation_space(agent).shape[0] for agent in environment.possible_agents]
    assert sum(shapes) == whole + 10  # both see the rod's pose and the goal
    assert sum(environment.action_space(agent).shape[0] for agent in environment.possible_agents) == inner.action_size
    environment.reset(seed=0)
    actions = {agent: np.full(environment.action_space(agent).shape, 0.5, np.float32) for agent in environment.agents}
    for step in range(3):
        assert environment.agents == [GIVER, RECEIVER]
        observations, rewards, terminations, truncations, infos = environment.step(actions)
        assert terminations == {GIVER: False, RECEIVER: False}
        assert truncations == {GIVER: step == 2, RECEIVER: step == 2}
    assert environment.agents == []
    # The last state's observation, in which the last action still shows; the next episode's first would show none.
    assert (observations[GIVER][-18:-10] == 0.5).all()
    assert environment.state().shape == (whole,)
    assert all(isinstance(reward, float) for reward in rewards.values())
    assert {"success", "goal_distance_m", "handover_distance_m"} == set(infos[RECEIVER])
    with pytest.raises(ConfigurationError, match="the episode is over: reset"):
        environment.step(actions)
    environment.close()


def test_a_task_with_one_agent_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"task Lift has one agent.*SingleEnvironment"):
        ParallelEnvironment("Lift", backend=BACKEND)


@dataclass
class Heights:
    """Each hand earns its own height."""

    giver: RewardTerm | None = RewardTerm(lambda env, agent: hand_height(env, agent), 2.0, agent=GIVER)
    receiver: RewardTerm | None = RewardTerm(lambda env, agent: hand_height(env, agent), 2.0, agent=RECEIVER)


def hand_height(env: Environment, agent: str) -> Tensor:
    return common.hand_pose(env, agent)[:, 2]


class Actor(GaussianMixin, Model):
    def __init__(self, **spaces: Any) -> None:
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        self.layers = perceptron(self.num_observations, (64,), self.num_actions)
        self.log_std = nn.Parameter(torch.full((self.num_actions,), -0.7))

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[Tensor, dict[str, Any]]:
        return self.layers(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    def __init__(self, **spaces: Any) -> None:
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.layers = perceptron(self.num_observations, (64,), 1)

    def compute(self, inputs: dict[str, Any], role: str = "") -> tuple[Tensor, dict[str, Any]]:
        return self.layers(inputs["observations"]), {}


def independent_learners(environment: Any, rollouts: int, folder: Path) -> IPPO:
    agents = environment.possible_agents
    spaces = [{
        "observation_space": environment.observation_space(agent), "action_space": environment.action_space(agent),
        "device": "cpu",
    } for agent in agents]  # fmt: skip
    scalings = {a: {"size": own["observation_space"], "device": "cpu"} for a, own in zip(agents, spaces, strict=True)}
    none: Any = {agent: {} for agent in agents}  # skrl takes an empty dictionary for one that lacks agents
    configuration = IPPO_CFG(
        rollouts=rollouts, learning_epochs=10, mini_batches=2, learning_rate=3e-3, discount_factor=0.9,
        observation_preprocessor=RunningStandardScaler, observation_preprocessor_kwargs=scalings, value_clip=0.0,
        learning_rate_scheduler_kwargs=none, state_preprocessor_kwargs=none, value_preprocessor_kwargs=none,
        time_limit_bootstrap=True, experiment={"directory": str(folder), "write_interval": 0, "checkpoint_interval": 0},
    )  # fmt: skip
    learners = IPPO(
        possible_agents=agents,
        models={a: {"policy": Actor(**own), "value": Critic(**own)} for a, own in zip(agents, spaces, strict=True)},
        memories={agent: RandomMemory(memory_size=rollouts, num_envs=1, device="cpu") for agent in agents},
        observation_spaces=environment.observation_spaces,
        state_spaces=dict.fromkeys(agents),
        action_spaces=environment.action_spaces,
        device="cpu",
        cfg=configuration,
    )
    learners.init()
    learners.enable_training_mode(True)
    return learners


def test_independent_learners_raise_both_returns(tmp_path: Path) -> None:
    """skrl's independent PPO (de Witt et al., 2020), a policy an agent, through its own wrapper of PettingZoo."""
    torch.manual_seed(0)
    parallel = ParallelEnvironment(Handover(rewards=Heights(), episode_length=0.5), backend=BACKEND)
    environment = wrap_env(parallel, wrapper="pettingzoo")
    learners = independent_learners(environment, 250, tmp_path)
    nobody = dict.fromkeys(environment.possible_agents)
    returns = []
    for step in range(2500):
        if not parallel.agents:
            returns.append(dict.fromkeys(environment.possible_agents, 0.0))
            seen, _ = environment.reset()
        time = {"timestep": step, "timesteps": 2500}
        with torch.no_grad():
            actions, _ = learners.act(seen, nobody, **time)
            following, rewards, terminated, truncated, infos = environment.step(actions)
            for agent, reward in rewards.items():
                returns[-1][agent] += float(reward)
            learners.record_transition(
                observations=seen, states=nobody, actions=actions, rewards=rewards, next_observations=following,
                next_states=nobody, terminated=terminated, truncated=truncated, infos=infos, **time,
            )  # fmt: skip
        learners.post_interaction(**time)
        seen = following
    for agent in environment.possible_agents:
        before, after = (np.mean([episode[agent] for episode in part]) for part in (returns[:20], returns[-20:]))
        assert after > 1.1 * before, agent
    environment.close()
