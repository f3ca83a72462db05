"""rl-games: Makoviichuk and Makoviychuk, rl-games: A High-performance Framework for Reinforcement Learning (2021)."""

from __future__ import annotations

import contextlib
import io
import math
from pathlib import Path
from typing import Any, ClassVar

import torch
from rl_games.algos_torch.a2c_continuous import A2CAgent
from rl_games.common.algo_observer import AlgoObserver
from rl_games.common.ivecenv import IVecEnv
from rl_games.common.tr_helpers import DefaultRewardsShaper
from torch import Tensor, nn

from orbit_core.envs.environment import Environment
from orbit_core.envs.observation_layout import Observation, one_tensor
from orbit_core.envs.ppo import PpoSettings
from orbit_core.interfaces import ConfigurationError
from orbit_learn.networks import ActorNetwork, perceptron_actor
from orbit_learn.spaces import CRITIC, action_space, check_groups, critic_group, critic_space, observation_space
from orbit_learn.trainer import LoopTrainer


class RlGamesEnvironment(IVecEnv):
    """Environment with rl-games' interface. Infos distinguish time-outs, for bootstrapping."""

    def __init__(self, environment: Environment, seed: int | None = None) -> None:
        self.environment = environment
        """ORBIT's environment behind the interface."""
        self._seed = seed

    def reset(self) -> dict[str, Tensor]:
        """Begin an episode in every environment; the seed is used only the first time."""
        observation, _ = self.environment.reset(self._seed)
        self._seed = None
        return self._seen(observation)

    def step(self, actions: Tensor) -> tuple[dict[str, Tensor], Tensor, Tensor, dict[str, Any]]:
        """Take one step with actions (N, A), and return observation, reward (N,), ended (N,) uint8 and infos."""
        observation, reward, terminated, truncated, info = self.environment.step(actions)
        done = (terminated | truncated).to(torch.uint8)  # the type of rl-games' own buffers
        return self._seen(observation), reward, done, {"time_outs": truncated, "ends": info}

    def _seen(self, observation: Observation) -> dict[str, Tensor]:
        """Return the actor's observation and, if the task has that group, the critic's as ``states``."""
        seen = {"obs": one_tensor(observation)}
        return {**seen, "states": one_tensor(observation, CRITIC)} if CRITIC in observation else seen

    def get_env_info(self) -> dict[str, Any]:  # pyright: ignore[reportIncompatibleMethodOverride] - it has no types
        """Return the spaces, by rl-games' names."""
        return {
            "observation_space": observation_space(self.environment)["policy"],  # pyright: ignore[reportIndexIssue]
            "action_space": action_space(self.environment),
            "state_space": critic_space(self.environment),
            "agents": 1,
            "value_size": 1,
        }


class RlGamesTrainer(LoopTrainer[PpoSettings]):
    """PPO with the learning rate following the Kullback-Leibler divergence."""

    name: ClassVar[str] = "rl-games"

    def __init__(self, environment: Environment, settings: PpoSettings, folder: Path | str, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        check_groups(environment, self.name)
        # rl-games stops with an assertion otherwise.
        if self.batch % settings.minibatches:
            raise ConfigurationError(
                f"rl-games needs num_envs x steps_per_iteration, here {self.batch}, to be a multiple of minibatches, "
                f"here {settings.minibatches}"
            )
        adapted = RlGamesEnvironment(environment, seed)
        with _quiet():
            self._agent = A2CAgent("orbit", self._parameters(adapted))
        # The two calls that A2CAgent.train makes before its own loop, which this trainer replaces.
        self._agent.init_tensors()
        self._agent.obs = self._agent.env_reset()

    def iterate(self, iteration: int) -> None:
        agent = self._agent
        with _quiet():
            epoch = agent.update_epoch()
            step_time, play_time, update_time, total_time, actor, critic, _, entropies, kls, rate, factor = (
                agent.train_epoch()
            )
            agent.dataset.update_values_dict(None)  # frees the iteration's batch, as its own loop does
            agent.frame += agent.curr_frames
            agent.write_stats(
                total_time, epoch, step_time, play_time, update_time, actor, critic, entropies, kls, rate, factor,
                agent.frame, total_time, play_time, agent.curr_frames,
            )  # fmt: skip

    def state(self) -> Any:
        return self._agent.get_full_state_weights()

    def load(self, state: Any) -> None:
        self._agent.set_full_state_weights(state)
        # Its state has no rate, which the optimiser's state has.
        self._agent.last_lr = state["optimizer"]["param_groups"][0]["lr"]

    def actor(self) -> ActorNetwork:
        model = self._agent.model
        layers = nn.Sequential(model.a2c_network.actor_mlp, model.a2c_network.mu)
        if not self.settings.normalize_observations:
            return perceptron_actor(layers)
        # rl-games keeps the variance in double precision, and adds epsilon before the root.
        seen = model.running_mean_std
        std = (seen.running_var.float() + seen.epsilon).sqrt()
        return perceptron_actor(layers, seen.running_mean, std, 5.0)  # rl-games clips by a constant in its code

    def _central_value(self) -> dict[str, Any]:
        """Return the configuration of a critic that sees ``states``, if the task has that group."""
        if critic_group(self.environment) != CRITIC:
            return {}
        settings = self.settings
        units = {"units": list(settings.hidden_sizes), "activation": "elu", "initializer": {"name": "default"}}
        critic = {
            "minibatch_size": self.batch // settings.minibatches,
            "mini_epochs": settings.epochs,
            "learning_rate": settings.learning_rate,
            "lr_schedule": None,
            "clip_value": False,
            "normalize_input": settings.normalize_observations,
            "truncate_grads": True,
            "grad_norm": 1.0,
            "network": {"name": "actor_critic", "central_value": True, "mlp": units},
        }
        return {"central_value_config": critic}

    def _parameters(self, environment: RlGamesEnvironment) -> dict[str, Any]:
        settings = self.settings
        return {
            "model": {"name": "continuous_a2c_logstd"},
            "network": _network(settings),
            "config": {
                "name": "orbit",
                "full_experiment_name": "tensorboard_rl_games",
                "env_name": "orbit",
                "env_info": environment.get_env_info(),
                "vec_env": environment,
                "train_dir": str(self.folder),
                "device": str(self.environment.device),
                "features": {"observer": _Observer(self)},
                "num_actors": self.environment.num_envs,
                "reward_shaper": DefaultRewardsShaper(),
                "horizon_length": settings.steps_per_iteration,
                "minibatch_size": self.batch // settings.minibatches,
                "mini_epochs": settings.epochs,
                "learning_rate": settings.learning_rate,
                "lr_schedule": "adaptive",
                "kl_threshold": settings.target_kl,
                "gamma": settings.discount,
                "tau": settings.gae_lambda,
                "e_clip": settings.clip,
                "entropy_coef": settings.entropy_weight,
                "critic_coef": 2.0,  # rl-games halves the critic's loss
                "clip_value": False,
                "bounds_loss_coef": 1e-4,
                "truncate_grads": True,
                "grad_norm": 1.0,
                "normalize_advantage": True,
                "normalize_input": settings.normalize_observations,
                "normalize_value": True,
                "value_bootstrap": True,
                **self._central_value(),
            },
        }


class _Observer(AlgoObserver):
    """Observer that adds every step's episodes to the trainer's tally."""

    def __init__(self, trainer: RlGamesTrainer) -> None:
        self._trainer = trainer

    def process_infos(self, infos: dict[str, Any], done_indices: Tensor) -> None:
        self._trainer.tally.add(infos["ends"], self._trainer.environment.num_envs)


def _network(settings: PpoSettings) -> dict[str, Any]:
    return {
        "name": "actor_critic",
        "separate": True,
        "space": {
            "continuous": {
                "mu_activation": "None",
                "sigma_activation": "None",
                "mu_init": {"name": "default"},
                "sigma_init": {"name": "const_initializer", "val": math.log(settings.initial_std)},
                "fixed_sigma": True,
            }
        },
        "mlp": {"units": list(settings.hidden_sizes), "activation": "elu", "initializer": {"name": "default"}},
    }


def _quiet() -> contextlib.redirect_stdout[io.StringIO]:
    """Return a context that suppresses rl-games' printed messages."""
    return contextlib.redirect_stdout(io.StringIO())
