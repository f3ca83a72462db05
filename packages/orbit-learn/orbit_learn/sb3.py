"""Stable-Baselines3: Raffin et al., Stable-Baselines3: Reliable Reinforcement Learning Implementations (2021)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from torch import Tensor, nn

from orbit_core.envs.environment import Environment
from orbit_core.envs.observation_layout import GroupLayout
from orbit_core.envs.ppo import PpoSettings
from orbit_learn.description import group_parts
from orbit_learn.networks import (
    MOST_DEVIATIONS,
    ActorNetwork,
    Convolutional,
    PictureFeatures,
    convolutional,
    convolutional_actor,
    perceptron_actor,
)
from orbit_learn.spaces import ACTOR, check_groups, group_space
from orbit_learn.trainer import Progress, Trainer

Seen = npt.NDArray[Any] | dict[str, npt.NDArray[Any]]
"""Group of observations: one array, or its terms by name."""


class PicturePpo(PPO):
    """PPO that does not transpose pictures (H, W, C), because :class:`PictureExtractor` reads them so."""

    @staticmethod
    def _wrap_env(env: Any, verbose: int = 0, monitor_wrapper: bool = True) -> VecEnv:
        # The base class would wrap the environment in VecTransposeImage.
        return env


class PictureExtractor(BaseFeaturesExtractor):
    """Features extractor of ``MultiInputPolicy`` by the layers of ORBIT's network ``convolutional``.

    Args:
        observation_space: space of the group.
        network: network of the group's terms.
    """

    def __init__(self, observation_space: spaces.Dict, network: Convolutional) -> None:
        features = PictureFeatures(network)  # before the base class, which needs its size; kept as a module after it
        super().__init__(observation_space, features.size)
        self.features = features
        """Encoder of the group's terms."""

    def forward(self, terms: dict[str, Tensor]) -> Tensor:
        return self.features(terms)


def observed_space(layout: GroupLayout) -> spaces.Space[Any]:
    """Return the space of a group: pictures as they are, other terms as unbounded float32, which is normalised."""
    if layout.concatenated:
        return spaces.Box(-np.inf, np.inf, (layout.size,), np.float32)
    whole: Any = group_space(layout)
    return spaces.Dict(
        {
            part.name: whole[part.name] if part.is_picture else spaces.Box(-np.inf, np.inf, part.shape, np.float32)
            for part in group_parts(layout)
        }
    )


def seen_arrays(group: Tensor | Mapping[str, Tensor]) -> Seen:
    """Return a group on the host, of the dtypes of :func:`observed_space`."""
    if isinstance(group, Tensor):
        return array_of(group)
    return {name: array_of(value if value.dim() == 4 else value.float()) for name, value in group.items()}


def row_of(seen: Seen, row: int) -> Seen:
    """Return the observation of one environment."""
    return {name: values[row] for name, values in seen.items()} if isinstance(seen, dict) else seen[row]


def array_of(values: Tensor) -> npt.NDArray[Any]:
    """Return a copy on the host."""
    return values.cpu().numpy().copy()


# Number of episodes over which success is averaged, the same as the library's for returns.
_RECENT = 100


class Sb3Environment(VecEnv):
    """Environment with Stable-Baselines3's interface, with NumPy arrays.

    At an episode's end ``infos`` has its last observation, and whether the time limit ended it. If the group ``policy``
    is a dictionary, so is the observation: pictures (H, W, C) as they are, other terms as float32.
    """

    def __init__(self, environment: Environment, seed: int | None = None) -> None:
        self.environment = environment
        """ORBIT's environment behind the interface."""
        # Stable-Baselines3 handles one environment per row; ORBIT steps all rows at once.
        super().__init__(
            environment.num_envs,
            observed_space(environment.observation[ACTOR]),
            spaces.Box(-1.0, 1.0, (environment.action_size,)),
        )
        self._seed = seed
        self._action = torch.zeros(environment.num_envs, environment.action_size)

    def reset(self) -> Seen:
        observation, _ = self.environment.reset(self._seed)
        self._seed = None
        return seen_arrays(observation[ACTOR])

    def step_async(self, actions: npt.NDArray[np.float32]) -> None:
        # Kept until step_wait: Stable-Baselines3 splits a step for environments in other processes.
        self._action = torch.as_tensor(actions, dtype=torch.float32, device=self.environment.device)

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        observation, reward, terminated, truncated, info = self.environment.step(self._action)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if "final" in info:
            self._tell(infos, info["final"], truncated)
        return seen_arrays(observation[ACTOR]), array_of(reward), array_of(done), infos

    def _tell(self, infos: list[dict[str, Any]], end: Any, truncated: Tensor) -> None:
        last = seen_arrays(end.observation[ACTOR])
        returns = torch.stack(list(end.rewards.values())).sum(0)
        for row, i in enumerate(end.env_ids.tolist()):
            infos[i]["terminal_observation"] = row_of(last, row)
            infos[i]["TimeLimit.truncated"] = bool(truncated[i])
            # Successes of starts on the expert's way would be too optimistic.
            if bool(end.usual[row]):
                infos[i]["is_success"] = bool(end.success[row])
            infos[i]["episode"] = {"r": float(returns[row]), "l": int(end.steps[row]), "t": time.time()}

    def close(self) -> None:
        """Do nothing: the owner of the environment closes it."""

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        return [getattr(self.environment, attr_name, None)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None:
        setattr(self.environment, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: int | Iterable[int] | None = None, **method_kwargs: Any
    ) -> list[Any]:
        result = getattr(self.environment, method_name)(*method_args, **method_kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: type[Any], indices: int | Iterable[int] | None = None) -> list[bool]:
        return [False] * len(list(self._get_indices(indices)))

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        self._seed = seed  # used by the next reset
        return [seed] * self.num_envs


class Sb3Trainer(Trainer[PpoSettings]):
    """PPO with a constant learning rate; an update ends early if the policy changes too much."""

    name: ClassVar[str] = "sb3"

    def __init__(self, environment: Environment, settings: PpoSettings, folder: Path | str, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        check_groups(environment, self.name)
        layout = environment.observation[ACTOR]
        self._network = None if layout.concatenated else convolutional(group_parts(layout), settings.hidden_sizes)
        self._environment = VecNormalize(
            Sb3Environment(environment, seed),
            norm_obs=settings.normalize_observations,
            norm_reward=False,
            clip_obs=MOST_DEVIATIONS,
            norm_obs_keys=None if self._network is None else [part.name for part in self._network.vectors],
        )
        batch = environment.num_envs * settings.steps_per_iteration
        self._model = PicturePpo(
            "MlpPolicy" if self._network is None else "MultiInputPolicy",
            self._environment,
            learning_rate=settings.learning_rate,
            n_steps=settings.steps_per_iteration,
            batch_size=max(1, batch // settings.minibatches),
            n_epochs=settings.epochs,
            gamma=settings.discount,
            gae_lambda=settings.gae_lambda,
            clip_range=settings.clip,
            ent_coef=settings.entropy_weight,
            # Libraries with adaptive rates slow down from twice the target on; this one stops an update instead.
            target_kl=2.0 * settings.target_kl,
            policy_kwargs={
                "net_arch": list(settings.hidden_sizes),
                "activation_fn": nn.ELU,
                "log_std_init": math.log(settings.initial_std),
                "ortho_init": False,  # its last layer starts so small that short trainings gain half as much
                **_reading(self._network),
            },
            tensorboard_log=str(folder),
            seed=seed,
            device=environment.device,
        )
        self._batch = batch

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
        """Return weights, the optimiser's state and the observations' statistics."""
        return {"parameters": self._model.get_parameters(), "observations": self._statistics()}

    def restore(self, state: Any, iteration: int) -> None:
        self._model.set_parameters(state["parameters"], device=self.environment.device)
        self._model.num_timesteps = (iteration + 1) * self._batch
        for name, seen in self._moments().items():
            saved = state["observations"] if self._network is None else state["observations"][name]
            seen.mean, seen.var, seen.count = saved["mean"].numpy(), saved["var"].numpy(), saved["count"]

    def actor(self) -> ActorNetwork:
        policy: Any = self._model.policy
        layers = nn.Sequential(policy.mlp_extractor.policy_net, policy.action_net)
        mean, std, limit = None, None, None
        if self.settings.normalize_observations:
            seen = list(self._moments().values())
            mean, var = (
                torch.cat([torch.zeros(0), *(torch.as_tensor(getattr(each, name)).float().flatten() for each in seen)])
                for name in ("mean", "var")
            )
            std, limit = (var + self._environment.epsilon).sqrt(), MOST_DEVIATIONS
        if self._network is None:
            return perceptron_actor(layers, mean, std, limit)
        encoders = policy.pi_features_extractor.features.encoders
        return convolutional_actor(self._network, encoders, layers, mean, std)

    def _moments(self) -> dict[str, Any]:
        """Return mean, variance and count of the observation, or of each vector by name; empty if not normalised."""
        if not self.settings.normalize_observations:
            return {}
        seen: Any = self._environment.obs_rms
        return {"": seen} if self._network is None else seen

    def _statistics(self) -> Any:
        moments = {
            name: {"mean": seen.mean, "var": seen.var, "count": seen.count} for name, seen in self._moments().items()
        }
        return moments.get("") if self._network is None else moments


def _reading(network: Convolutional | None) -> dict[str, Any]:
    """Return the policy's options for a dictionary: actor and critic have separate encoders."""
    if network is None:
        return {}
    return {
        "features_extractor_class": PictureExtractor,
        "features_extractor_kwargs": {"network": network},
        "share_features_extractor": False,
        "normalize_images": False,  # the extractor does
    }


class IterationCallback(BaseCallback):
    """Callback that reports after each iteration."""

    def __init__(self, batch: int, report: Callable[[Progress], None]) -> None:
        super().__init__()
        self._batch, self._report = batch, report
        self._begin = time.perf_counter()
        self._first_step = -1
        self._successes: list[bool] = []

    def _on_rollout_start(self) -> None:
        if self._first_step < 0:
            self._first_step = self.model.num_timesteps
        else:
            self.finish_iteration()  # the library reports no end of learning, only the next rollout's start

    def _on_step(self) -> bool:
        self._successes += [info["is_success"] for info in self.locals["infos"] if "is_success" in info]
        del self._successes[:-_RECENT]  # in place: only the last ones count
        return True

    def finish_iteration(self) -> None:
        """Report an iteration that has collected and learned."""
        episodes: Any = self.model.ep_info_buffer
        self._report(
            Progress(
                iteration=self.model.num_timesteps // self._batch - 1,
                env_steps=self.model.num_timesteps - self._first_step,
                seconds=time.perf_counter() - self._begin,
                episode_return=float(np.mean([episode["r"] for episode in episodes])) if episodes else math.nan,
                success_rate=float(np.mean(self._successes)) if self._successes else math.nan,
                episodes=len(self._successes),
            )
        )
