"""SAC and TD3 by Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.noise import NormalActionNoise, VectorizedActionNoise
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from orbit_core.envs.environment import Environment
from orbit_core.envs.off_policy import OffPolicySettings
from orbit_core.interfaces import ConfigurationError
from orbit_learn.networks import MOST_DEVIATIONS, ActorNetwork, perceptron_actor
from orbit_learn.sb3 import IterationCallback, Sb3Environment
from orbit_learn.spaces import ACTOR, check_groups
from orbit_learn.trainer import Progress, Trainer

# Transitions in a gradient step where the settings name no size; the library's own.
_BATCH = 256


class Sb3OffPolicyTrainer(Trainer[OffPolicySettings]):
    """Trainer by SAC or TD3 whose environment and kept transitions are NumPy arrays on the host.

    An iteration collects all of its steps, then takes all of its gradient steps. SAC improves its actor in every one
    of them, as the library has it.

    Raises:
        ConfigurationError: the policy's observation group holds pictures, or a setting needs another library.
    """

    name: ClassVar[str] = "sb3"
    chooses_arithmetic: ClassVar[bool] = True
    settings_type: ClassVar[type[Any]] = OffPolicySettings
    options: ClassVar[tuple[str, ...]] = ("off_policy", "algorithm")

    def __init__(self, environment: Environment, settings: OffPolicySettings, folder: Path | str, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        check_groups(environment, self.name)
        if not environment.observation[ACTOR].concatenated:
            raise ConfigurationError(
                f"{settings.algorithm} of library '{self.name}' reads no pictures here: use --algorithm ppo"
            )
        self._environment = VecNormalize(
            Sb3Environment(environment, seed),
            norm_obs=settings.normalize_observations, norm_reward=False, clip_obs=MOST_DEVIATIONS,
        )  # fmt: skip
        metadata, steps = environment.task.metadata, settings.steps_per_iteration
        common: dict[str, Any] = {
            "learning_rate": settings.learning_rate,
            "buffer_size": max(settings.buffer_size, settings.horizon * environment.num_envs),
            "learning_starts": settings.warm_up * environment.num_envs,
            "batch_size": settings.batch_size or _BATCH,
            "tau": settings.target_rate,
            "gamma": metadata.ppo.discount if settings.discount is None else settings.discount,
            "train_freq": (steps, "step"),
            "gradient_steps": steps * settings.updates_per_step,
            "n_steps": settings.horizon,
            "policy_kwargs": {
                "net_arch": {"pi": list(settings.hidden_sizes), "qf": list(settings.critic_sizes)},
                "activation_fn": nn.ELU,
            },
            "tensorboard_log": str(folder),
            "seed": seed,
            "device": environment.device,
        }
        actions = environment.action_size
        self._model: SAC | TD3
        if settings.algorithm == "sac":
            target = settings.target_entropy * actions
            entropy = f"auto_{settings.temperature}"
            self._model = SAC("MlpPolicy", self._environment, ent_coef=entropy, target_entropy=target, **common)
        else:
            noise = _noise(np.linspace(*settings.noise, environment.num_envs), actions)
            delay = settings.policy_delay
            self._model = TD3("MlpPolicy", self._environment, policy_delay=delay, action_noise=noise, **common)
        self._batch = environment.num_envs * steps

    def learn(self, iterations: int, report: Callable[[Progress], None]) -> None:
        callback = IterationCallback(self._batch, report)
        self._model.learn(
            iterations * self._batch,
            callback=callback,
            reset_num_timesteps=self._model.num_timesteps == 0,  # a resumed training counts on
            tb_log_name="tensorboard",
        )
        callback.finish_iteration()  # the last one, after which no rollout starts

    def state(self) -> Any:
        """Return weights, the optimisers' states and the observations' statistics."""
        seen: Any = self._environment.obs_rms if self.settings.normalize_observations else None
        moments = None if seen is None else {"mean": seen.mean, "var": seen.var, "count": seen.count}
        return {"parameters": self._model.get_parameters(), "observations": moments}

    def restore(self, state: Any, iteration: int) -> None:
        self._model.set_parameters(state["parameters"], device=self.environment.device)
        self._model.num_timesteps = (iteration + 1) * self._batch
        # Transitions are not part of checkpoints: the policy collects some before it learns again.
        self._model.learning_starts += self._model.num_timesteps
        if self.settings.normalize_observations:
            seen, saved = self._environment.obs_rms, state["observations"]
            seen.mean, seen.var, seen.count = saved["mean"].numpy(), saved["var"].numpy(), saved["count"]  # pyright: ignore

    def actor(self) -> ActorNetwork:
        policy: Any = self._model.policy.actor
        layers = policy.mu if self.settings.algorithm == "td3" else nn.Sequential(policy.latent_pi, policy.mu)
        if not self.settings.normalize_observations:
            return perceptron_actor(layers, squashed=True)
        seen: Any = self._environment.obs_rms
        mean, var = (torch.as_tensor(values).float() for values in (seen.mean, seen.var))
        std = (var + self._environment.epsilon).sqrt()
        return perceptron_actor(layers, mean, std, MOST_DEVIATIONS, squashed=True)


def _noise(deviations: Any, actions: int) -> VectorizedActionNoise:
    """Return noise whose deviation differs between environments."""
    noise = VectorizedActionNoise(NormalActionNoise(np.zeros(actions), np.ones(actions)), len(deviations))
    noise.noises = [NormalActionNoise(np.zeros(actions), np.full(actions, one)) for one in deviations]
    return noise
