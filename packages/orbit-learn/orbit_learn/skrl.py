"""skrl: Serrano-Munoz et al., skrl: Modular and Flexible Library for Reinforcement Learning (2023)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import torch
from gymnasium import Space
from skrl.agents.torch import ExperimentCfg
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import Wrapper
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.resources.preprocessors.torch import RunningStandardScaler
from skrl.resources.schedulers.torch import KLAdaptiveLR
from skrl.utils.spaces.torch import flatten_tensorized_space, unflatten_tensorized_space
from torch import Tensor, nn

from orbit_core.envs.environment import Environment
from orbit_core.envs.observation_layout import GroupLayout
from orbit_core.envs.ppo import PpoSettings
from orbit_learn.description import Part, group_parts
from orbit_learn.ends import true_next
from orbit_learn.networks import (
    MOST_DEVIATIONS,
    ActorNetwork,
    PictureFeatures,
    convolutional,
    convolutional_actor,
    perceptron,
    perceptron_actor,
)
from orbit_learn.spaces import (
    ACTOR,
    CRITIC,
    action_space,
    check_groups,
    critic_group,
    critic_space,
    group_space,
    observation_space,
)
from orbit_learn.trainer import LoopTrainer


class GroupModel(Model):
    """Model of linear layers, behind encoders if the group is a dictionary.

    Args:
        layout: layout of the group.
        hidden: units of the hidden layers.
        outputs: number of outputs.
        spaces: spaces and device, the arguments of skrl's models.
    """

    def __init__(self, layout: GroupLayout, hidden: Sequence[int], outputs: int, **spaces: Any) -> None:
        Model.__init__(self, **spaces)
        self._space = group_space(layout)
        self.features = None
        """Encoders of a dictionary of terms; None for a concatenated group."""
        if not layout.concatenated:
            self.features = PictureFeatures(convolutional(group_parts(layout), hidden))
        self.layers = perceptron(layout.size if self.features is None else self.features.size, hidden, outputs)
        """Linear layers from the features to the outputs."""

    def output(self, seen: Tensor) -> Tensor:
        """Compute the outputs (N, outputs) of a group as skrl flattens it, (N, K)."""
        if self.features is None:
            return self.layers(seen)
        return self.layers(self.features(unflatten_tensorized_space(self._space, seen)))


class Actor(GaussianMixin, GroupModel):
    """Normal distribution around the output; its deviation is learned, but independent of the observation."""

    def __init__(self, layout: GroupLayout, hidden: Sequence[int], initial_std: float, **spaces: Any) -> None:
        actions = spaces["action_space"].shape[0]
        GroupModel.__init__(self, layout, hidden, actions, **spaces)
        GaussianMixin.__init__(self)
        self.log_std = nn.Parameter(torch.full((actions,), math.log(initial_std)))
        """(A,) logarithms of the deviations."""

    def compute(  # pyright: ignore[reportIncompatibleMethodOverride] - its mixins give the role by position
        self, inputs: dict[str, Any], role: str = ""
    ) -> tuple[Tensor, dict[str, Any]]:
        return self.output(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, GroupModel):
    """Value of skrl's state if there is one, else of the observation."""

    def __init__(self, layout: GroupLayout, hidden: Sequence[int], **spaces: Any) -> None:
        GroupModel.__init__(self, layout, hidden, 1, **spaces)
        DeterministicMixin.__init__(self)
        self._seen = "observations" if self.state_space is None else "states"

    def compute(  # pyright: ignore[reportIncompatibleMethodOverride] - its mixins give the role by position
        self, inputs: dict[str, Any], role: str = ""
    ) -> tuple[Tensor, dict[str, Any]]:
        return self.output(inputs[self._seen]), {}


class VectorScaler(RunningStandardScaler):
    """Normalisation of the vectors of a flattened dictionary, which leaves its pictures as they are.

    Its mean and variance are those of the concatenated vectors, in the order of the group's terms.

    Args:
        size: layout of the group; skrl's configuration gives the argument this name.
        device: device of the statistics.
    """

    columns: Tensor
    """(V,) columns of the flattened dictionary that are no pictures."""

    def __init__(self, size: GroupLayout, *, device: torch.device) -> None:
        parts = group_parts(size)
        begins = _begins(parts)
        columns = [begins[part.name] + i for part in parts if not part.is_picture for i in range(part.size)]
        super().__init__(len(columns), clip_threshold=MOST_DEVIATIONS, device=device)
        self.register_buffer("columns", torch.tensor(columns, dtype=torch.long, device=device), persistent=False)

    def forward(
        self, x: Tensor | None, *, train: bool = False, inverse: bool = False, no_grad: bool = True
    ) -> Tensor | None:
        if x is None:
            return None
        vectors = super().forward(x[:, self.columns], train=train, inverse=inverse, no_grad=no_grad)
        assert vectors is not None
        return x.index_copy(1, self.columns, vectors)  # out of place: the agent's memory keeps the original


def _begins(parts: Sequence[Part]) -> dict[str, int]:
    """Return the first column of each term: skrl flattens dictionaries in the order of their names."""
    begins: dict[str, int] = {}
    end = 0
    for part in sorted(parts, key=lambda part: part.name):
        begins[part.name] = end
        end += part.size
    return begins


class SkrlEnvironment(Wrapper):
    """Environment with skrl's interface.

    Groups that are dictionaries are flattened to (N, K) of float32, in the order of their terms' names, which
    ``skrl.utils.spaces.torch.unflatten_tensorized_space`` undoes. skrl estimates the value of a step at the time limit
    from the observation after it, which here is the next episode's first. ``info["true_next"]`` (N, O) is the one to
    record: pass it to the agent as ``next_observations``, as :class:`SkrlTrainer` does. If the task has a group
    ``critic``, that is skrl's state, and ``info["true_next_state"]`` the one to record.
    """

    def __init__(self, environment: Environment, seed: int | None = None) -> None:
        super().__init__(environment)
        self.environment = environment
        """ORBIT's environment behind the interface."""
        self._seed = seed

    @property
    def observation_space(self) -> Space[Any]:
        return observation_space(self.environment)["policy"]  # pyright: ignore[reportIndexIssue]

    @property
    def action_space(self) -> Space[Any]:
        return action_space(self.environment)

    def reset(self) -> tuple[Tensor, dict[str, Any]]:
        """Return the current observation; only the first call begins episodes, because the environment renews them."""
        # Trainers reset before each iteration, which must not cut episodes.
        if self._seed is not None:
            self.environment.reset(self._seed)
            self._seed = None
        return _flat(self.environment.observe()[ACTOR]), {}

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.environment.step(actions)
        following = {name: _flat(group) for name, group in true_next(observation, info).items()}
        extras = {"true_next": following[ACTOR], "true_next_state": following.get(CRITIC), "ends": info}
        return _flat(observation[ACTOR]), reward[:, None], terminated[:, None], truncated[:, None], extras

    @property
    def state_space(self) -> Space[Any] | None:
        return critic_space(self.environment)

    def state(self) -> Tensor | None:
        """Return the critic's observation; None if the task has no group for it."""
        observation = self.environment.observe()
        return _flat(observation[CRITIC]) if CRITIC in observation else None

    def render(self, *args: Any, **kwargs: Any) -> None:
        """Do nothing: ``orbit view`` and ``orbit play`` show environments."""

    def close(self) -> None:
        """Do nothing: the owner of the environment closes it."""


def _flat(group: Tensor | dict[str, Tensor]) -> Tensor:
    # A concatenated group is flat already; colours become float32 with the rest.
    flat = flatten_tensorized_space(group)
    assert flat is not None
    return flat.float()


class SkrlTrainer(LoopTrainer[PpoSettings]):
    """PPO with the learning rate following the Kullback-Leibler divergence."""

    name: ClassVar[str] = "skrl"

    def __init__(self, environment: Environment, settings: PpoSettings, folder: Path | str, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        check_groups(environment, self.name)
        self._environment = SkrlEnvironment(environment, seed)
        spaces = {
            "observation_space": self._environment.observation_space,
            "state_space": self._environment.state_space,
            "action_space": self._environment.action_space,
            "device": environment.device,
        }
        groups = environment.observation
        self._actor = Actor(groups[ACTOR], settings.hidden_sizes, settings.initial_std, **spaces)
        critic = Critic(groups[critic_group(environment)], settings.hidden_sizes, **spaces)
        steps = settings.steps_per_iteration
        memory = RandomMemory(memory_size=steps, num_envs=environment.num_envs, device=environment.device)
        configuration = _configuration(settings, folder, groups, spaces)
        self._agent = PPO(models={"policy": self._actor, "value": critic}, memory=memory, cfg=configuration, **spaces)
        self._agent.init()
        self._agent.enable_training_mode(True)

    def iterate(self, iteration: int) -> None:
        seen, _ = self._environment.reset()
        steps = self.settings.steps_per_iteration
        for step in range(iteration * steps, (iteration + 1) * steps):
            time = {"timestep": step, "timesteps": self.settings.iterations * steps}
            with torch.no_grad():
                state = self._environment.state()
                state = None if state is None else state.clone()
                action, _ = self._agent.act(seen, state, **time)
                following, reward, terminated, truncated, extras = self._environment.step(action)
                self._agent.record_transition(
                    observations=seen,
                    states=state,  # pyright: ignore[reportArgumentType] - None is what its own trainers hand over
                    actions=action,
                    rewards=reward,
                    next_observations=extras["true_next"],
                    next_states=extras["true_next_state"],
                    terminated=terminated,
                    truncated=truncated,
                    infos=extras,
                    **time,
                )
            self.tally.add(extras["ends"], self._environment.num_envs)
            self._agent.post_interaction(**time)  # which learns once the memory is full
            seen = following

    def state(self) -> Any:
        return {name: module.state_dict() for name, module in self._agent.checkpoint_modules.items()}

    def load(self, state: Any) -> None:
        for name, module in self._agent.checkpoint_modules.items():
            module.load_state_dict(state[name])

    def actor(self) -> ActorNetwork:
        layers, features = self._actor.layers, self._actor.features
        mean, std, limit = None, None, None
        if self.settings.normalize_observations:
            scaler: Any = self._agent._observation_preprocessor
            limit = scaler.clip_threshold
            mean, std = scaler.running_mean, scaler.running_variance.sqrt() + scaler.epsilon
        if features is None:
            return perceptron_actor(layers, mean, std, limit)
        return convolutional_actor(features.network, features.encoders, layers, mean, std)


def _scaling(
    layout: GroupLayout | None, space: Space[Any] | None, settings: PpoSettings, device: torch.device
) -> tuple[type[RunningStandardScaler] | None, dict[str, Any]]:
    """Return the class that normalises a group, and its arguments; None if nothing is normalised."""
    if layout is None or not settings.normalize_observations:
        return None, {}
    if layout.concatenated:
        return RunningStandardScaler, {"size": space, "device": device}
    return VectorScaler, {"size": layout, "device": device}


def _configuration(
    settings: PpoSettings, folder: Path | str, groups: Mapping[str, GroupLayout], spaces: dict[str, Any]
) -> PPO_CFG:
    scaler, scaling = _scaling(groups[ACTOR], spaces["observation_space"], settings, spaces["device"])
    state_scaler, state_scaling = _scaling(groups.get(CRITIC), spaces["state_space"], settings, spaces["device"])
    return PPO_CFG(
        rollouts=settings.steps_per_iteration,
        learning_epochs=settings.epochs,
        mini_batches=settings.minibatches,
        discount_factor=settings.discount,
        gae_lambda=settings.gae_lambda,
        learning_rate=settings.learning_rate,
        learning_rate_scheduler=KLAdaptiveLR,
        learning_rate_scheduler_kwargs={"kl_threshold": settings.target_kl},
        observation_preprocessor=scaler,
        observation_preprocessor_kwargs=scaling,
        state_preprocessor=state_scaler,
        state_preprocessor_kwargs=state_scaling,
        grad_norm_clip=1.0,
        ratio_clip=settings.clip,
        value_clip=0.0,  # in units of the return, which the task chooses
        value_loss_scale=1.0,
        entropy_loss_scale=settings.entropy_weight,
        time_limit_bootstrap=True,
        experiment=ExperimentCfg(
            directory=str(folder),
            experiment_name="tensorboard_skrl",
            write_interval=settings.steps_per_iteration,
            checkpoint_interval=0,
        ),
    )
