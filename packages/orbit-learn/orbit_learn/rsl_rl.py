"""RSL-RL: Schwarke et al., RSL-RL: A Learning Library for Robotics Research (2025)."""

from __future__ import annotations

import contextlib
import io
import math
import os
import statistics
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar, cast

os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")  # its logger imports git, which need not be there

import torch
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict
from torch import Tensor, nn

from orbit_core.envs.environment import Environment, Observation
from orbit_core.envs.ppo import PpoSettings
from orbit_core.interfaces import ConfigurationError
from orbit_learn.convolutional import convolutional, convolutional_actor
from orbit_learn.description import group_parts
from orbit_learn.groups import ACTOR, check_groups, critic_group, tensor_names, tensors_by_name
from orbit_learn.imitation import imitate_expert
from orbit_learn.networks import ActorNetwork, NormalizedActor, Perceptron, perceptron_actor
from orbit_learn.policy import Policy, load_policy
from orbit_learn.pretrained import policy_path
from orbit_learn.rsl_rl_models import PartlyKnown, PictureModel
from orbit_learn.trainer import Progress, Trainer
from orbit_learn.warm_start import columns_seen, started_from

MOST_STD = 1.0
"""Most that the deviation of actions grows to, where it does not begin wider."""

# Iterations that what the environment showed at first counts for in the statistics of what a policy to begin with had
# not seen.
_START_WEIGHT = 5


class RslRlEnvironment(VecEnv):
    """An environment as RSL-RL expects it. Time-outs are told apart in ``extras``, for bootstrapping."""

    def __init__(self, environment: Environment, seed: int | None = None) -> None:
        self.environment = environment
        self.num_envs = environment.num_envs
        self.num_actions = environment.action_size
        self.max_episode_length = environment.max_episode_steps
        self.device = environment.device
        self.cfg = {"task": type(environment.task).__name__}
        self._observation, _ = environment.reset(seed)  # the runner never resets

    @property
    def episode_length_buf(self) -> Tensor:  # pyright: ignore[reportIncompatibleVariableOverride]
        """(N,) steps since reset; the runner sets it to spread the first episodes' ends."""
        return self.environment.state.episode_step

    @episode_length_buf.setter
    def episode_length_buf(self, steps: Tensor) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        self.environment.state.episode_step.copy_(steps)

    def get_observations(self) -> TensorDict:
        return self._dict(self._observation)

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Any]]:
        # The runner collects in inference mode, whose tensors an environment could not write to later.
        with torch.inference_mode(False), torch.no_grad():
            self._observation, reward, terminated, truncated, info = self.environment.step(actions.clone())
            extras: dict[str, Any] = {"time_outs": truncated}
            if "final" in info:
                end = info["final"]
                # Those that began on the expert's way tell little of how far learning has come.
                extras["log"] = {"success": end.success.float()[end.usual], **end.metrics}
            return self._dict(self._observation), reward, (terminated | truncated).long(), extras

    def _dict(self, observation: Observation) -> TensorDict:
        return TensorDict(tensors_by_name(observation), batch_size=[self.num_envs], device=self.device)  # pyright: ignore[reportArgumentType]


class RslRlTrainer(Trainer[PpoSettings]):
    """PPO with the learning rate following the Kullback-Leibler divergence."""

    name: ClassVar[str] = "rsl-rl"
    several_gpus: ClassVar[bool] = True
    imitates: ClassVar[bool] = True
    begins_with_policies: ClassVar[bool] = True

    def __init__(self, environment: Environment, settings: PpoSettings, folder: Path | str, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        torch.manual_seed(seed)
        check_groups(environment, self.name)
        adapted = RslRlEnvironment(environment, seed)
        with contextlib.redirect_stdout(io.StringIO()):  # it prints its networks
            self._runner = _Runner(adapted, _configuration(settings, environment), str(folder), str(environment.device))
        self._runner.logger.git_status_repos = []
        if settings.start:
            self._begin_with(load_policy(policy_path(settings.start), environment.device))

    def learn(self, iterations: int, report: Callable[[Progress], None]) -> None:
        if self.settings.imitation_steps:
            policy: Any = self._runner.alg.get_policy()
            if self._runner.current_learning_iteration == 0:
                imitate_expert(self.environment, policy.mlp, policy.obs_normalizer, self.settings)
            policy.obs_normalizer.until = 0  # what was imitated holds for these statistics
        self._let_actor_learn(self._runner.current_learning_iteration)
        with self._reporting(report), contextlib.redirect_stdout(io.StringIO()):
            self._runner.learn(iterations, init_at_random_ep_len=True)

    def state(self) -> Any:
        return self._runner.alg.save()

    def restore(self, state: Any, iteration: int) -> None:
        self._runner.alg.load(state, None, strict=True)
        self._runner.current_learning_iteration = iteration + 1

    def actor(self) -> ActorNetwork:
        policy = self._runner.alg.get_policy()
        seen: Any = policy.obs_normalizer
        mean, std = None, None
        if self.settings.normalize_observations:
            mean, std = seen.mean, seen.std + seen.eps
        if isinstance(policy, PictureModel):
            return convolutional_actor(policy.network, policy.encoders, policy.mlp, mean, std)
        return perceptron_actor(policy.mlp, mean, std)

    def _begin_with(self, policy: Policy) -> None:
        """Give the actor the policy's layers, and the statistics that they were learned with."""
        started, actor = started_from(policy, self.environment), cast(Any, self._runner.alg.get_policy())
        sizes = cast(Perceptron, started.network).hidden_sizes
        if sizes != self.settings.hidden_sizes or not self.settings.normalize_observations:
            raise ConfigurationError(
                f"the policy to begin with has layers of {list(sizes)} and normalises what it sees: give "
                f"--ppo hidden_sizes={str(list(sizes)).replace(' ', '')} --ppo normalize_observations=true"
            )
        module = cast(NormalizedActor, started.module)
        for layer, given in zip(_linear(actor.mlp), _linear(module.layers), strict=True):
            layer.load_state_dict(given.state_dict())
        known = columns_seen(policy, self.environment.observation[ACTOR])
        weight = _START_WEIGHT * self.settings.steps_per_iteration * self.environment.num_envs
        actor.obs_normalizer = PartlyKnown(module.mean, module.std, known, weight).to(self.environment.device)

    def _let_actor_learn(self, iteration: int) -> None:
        """Or not, in the iterations in which the critic learns alone; an actor that stays would drive up the rate."""
        settings, algorithm = self.settings, self._runner.alg
        alone = settings.iterations_of_critic
        cast(Any, algorithm.get_policy()).requires_grad_(iteration >= alone)
        algorithm.schedule = "adaptive" if iteration >= alone else "fixed"
        if settings.start and iteration == alone:
            # The divergence of a step grows as it is over the deviation: the rate starts low, and adapts from there.
            algorithm.learning_rate = settings.learning_rate * min(settings.initial_std, 1.0)

    def _bound_exploration(self) -> None:
        """Actions are clipped to [-1, 1]: a wider deviation does the same and only earns more entropy, without end."""
        policy: Any = self._runner.alg.get_policy()
        deviation = policy.distribution.log_std_param
        with torch.no_grad():
            deviation.clamp_(max=math.log(max(MOST_STD, self.settings.initial_std)))

    @contextlib.contextmanager
    def _reporting(self, report: Callable[[Progress], None]) -> Iterator[None]:
        """Call ``report`` where the library would print."""
        logger = self._runner.logger
        log = logger.log

        def logged(*args: Any, **keywords: Any) -> None:
            ends = list(logger.ep_extras)  # which the library clears
            successes = [entry["success"] for entry in ends]
            log(*args, **keywords)
            self._bound_exploration()
            self._let_actor_learn(keywords["it"] + 1)
            report(
                Progress(
                    iteration=keywords["it"],
                    env_steps=logger.tot_timesteps,
                    seconds=logger.tot_time,
                    episode_return=statistics.mean(logger.rewbuffer) if logger.rewbuffer else math.nan,
                    success_rate=float(torch.cat(successes).mean()) if successes else math.nan,
                    episodes=sum(len(ended) for ended in successes),
                    metrics={name: _mean(ends, name) for name in (ends[0] if ends else {}) if name != "success"},
                )
            )

        logger.log = logged
        try:
            yield
        finally:
            logger.log = log


def _linear(layers: nn.Module) -> list[nn.Linear]:
    return [layer for layer in layers.modules() if isinstance(layer, nn.Linear)]


def _mean(ends: list[dict[str, Tensor]], name: str) -> float:
    return float(torch.cat([end[name] for end in ends]).float().mean())


class _Runner(OnPolicyRunner):
    """Leaves checkpoints to the training."""

    def save(self, path: str, infos: dict[str, Any] | None = None) -> None:
        """Nothing."""


def _model(settings: PpoSettings, environment: Environment, group: str) -> dict[str, Any]:
    """Settings of an actor or critic: linear layers, behind encoders where the group holds pictures."""
    linear = {
        "hidden_dims": list(settings.hidden_sizes),
        "activation": "elu",
        "obs_normalization": settings.normalize_observations,
    }
    layout = environment.observation[group]
    if layout.concatenated:
        return {"class_name": "MLPModel", **linear}
    network = convolutional(group_parts(layout), settings.hidden_sizes)
    return {"class_name": PictureModel, "network": network, **linear}


def _configuration(settings: PpoSettings, environment: Environment) -> dict[str, Any]:
    critic = critic_group(environment)
    distribution = {"class_name": "GaussianDistribution", "init_std": settings.initial_std, "std_type": "log"}
    return {
        "num_steps_per_env": settings.steps_per_iteration,
        "save_interval": settings.iterations,
        "obs_groups": {"actor": tensor_names(environment, ACTOR), "critic": tensor_names(environment, critic)},
        "actor": {**_model(settings, environment, ACTOR), "distribution_cfg": distribution},
        "critic": _model(settings, environment, critic),
        "check_for_nan": False,  # it would wait for the device at every step; the engine tells of divergence
        "logger": "tensorboard",
        "algorithm": {
            "class_name": "PPO",
            "num_learning_epochs": settings.epochs,
            "num_mini_batches": settings.minibatches,
            "clip_param": settings.clip,
            "gamma": settings.discount,
            "lam": settings.gae_lambda,
            "entropy_coef": settings.entropy_weight,
            "learning_rate": settings.learning_rate,
            "schedule": "adaptive",
            "desired_kl": settings.target_kl,
            "value_loss_coef": 1.0,
            "max_grad_norm": 1.0,
            "use_clipped_value_loss": True,
            "optimizer": "adam",
            "rnd_cfg": None,
            "symmetry_cfg": None,
        },
    }
