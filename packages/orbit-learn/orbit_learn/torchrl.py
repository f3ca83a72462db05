"""TorchRL: Bou et al., TorchRL: A Data-driven Decision-making Library for PyTorch (2023)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, ClassVar

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import AddStateIndependentNormalScale, TensorDictModule
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from orbit_core.envs.environment import Environment
from orbit_core.envs.observation_layout import GroupLayout, Observation
from orbit_core.envs.ppo import PpoSettings
from orbit_learn.description import group_parts
from orbit_learn.ends import EpisodeTally, true_next
from orbit_learn.networks import (
    ActorNetwork,
    PictureFeatures,
    convolutional,
    convolutional_actor,
    joined_vectors,
    perceptron,
    perceptron_actor,
)
from orbit_learn.spaces import ACTOR, check_groups, critic_group
from orbit_learn.trainer import LoopTrainer


class ObservedGroup:
    """Keys, statistics and networks of an observation group.

    Args:
        layout: layout of the group.
        settings: settings of the algorithm.
        device: device of the networks.
    """

    def __init__(self, layout: GroupLayout, settings: PpoSettings, device: torch.device) -> None:
        self._layout, self._hidden, self._device = layout, settings.hidden_sizes, device
        self._network = None if layout.concatenated else convolutional(group_parts(layout), settings.hidden_sizes)
        self._size = layout.size if self._network is None else self._network.vector_size
        self._norm: Normalization | None = None
        if settings.normalize_observations and self._size > 0:
            self._norm = Normalization(self._size, momentum=None, affine=False, device=device).eval()

    @property
    def keys(self) -> list[NestedKey]:
        """Keys of the group's tensors."""
        name = self._layout.name
        return [name] if self._network is None else [(name, term) for term in self._layout.terms]

    def network(self, outputs: int) -> nn.Module:
        """Return a module from tensors in the order of :attr:`keys` to (..., outputs).

        All modules share this group's statistics.
        """
        if self._network is None:
            normalize = nn.Identity() if self._norm is None else self._norm
            return nn.Sequential(normalize, perceptron(self._size, self._hidden, outputs).to(self._device))
        features = PictureFeatures(self._network, self._norm)
        layers = perceptron(features.size, self._hidden, outputs)
        return TermLayers(self._layout, features, layers).to(self._device)

    def take_in(self, batch: TensorDictBase) -> None:
        """Add a batch (M,) to the statistics."""
        if self._norm is None:
            return
        seen: Any = batch[self._layout.name]
        # In training mode only here, so that evaluations do not change the statistics.
        self._norm.train()(seen if self._network is None else joined_vectors(self._network, seen))
        self._norm.eval()

    def actor(self, built: nn.Module) -> ActorNetwork:
        """Return ORBIT's own copy of a module that :meth:`network` built."""
        mean, std = None, None
        if self._norm is not None and self._norm.running_mean is not None and self._norm.running_var is not None:
            mean, std = self._norm.running_mean, (self._norm.running_var + self._norm.eps).sqrt()
        if not isinstance(built, TermLayers):
            return perceptron_actor(built, mean, std)
        return convolutional_actor(built.features.network, built.features.encoders, built.layers, mean, std)


class TermLayers(nn.Module):
    """Encoders and linear layers over any leading dimensions, because TorchRL evaluates whole rollouts at once.

    Args:
        layout: layout of the group whose terms are the inputs.
        features: encoder of the terms.
        layers: linear layers behind it.
    """

    def __init__(self, layout: GroupLayout, features: PictureFeatures, layers: nn.Sequential) -> None:
        super().__init__()
        self._dims = {name: len(term.shape) for name, term in layout.terms.items()}
        self.features, self.layers = features, layers

    def forward(self, *terms: Tensor) -> Tensor:
        leading = terms[0].shape[: terms[0].dim() - next(iter(self._dims.values()))]
        last = len(leading) - 1
        rows = {name: term.flatten(0, last) for name, term in zip(self._dims, terms, strict=True)}
        return self.layers(self.features(rows)).unflatten(0, leading)


class Normalization(nn.BatchNorm1d):
    """Normalisation by the mean and variance of all batches so far with equal weights, over any leading dimensions."""

    def forward(self, input: Tensor) -> Tensor:
        # BatchNorm1d takes rows; rollouts have dimensions of time and environments before them.
        return super().forward(input.reshape(-1, self.num_features)).view_as(input)


def group_spec(layout: GroupLayout, count: int, device: torch.device) -> Composite | Unbounded:
    """Return the specification of a group of ``count`` environments: one tensor, or its terms with their dtypes."""
    if layout.concatenated:
        return Unbounded(torch.Size((count, layout.size)), device=device)
    terms = {
        name: Unbounded(torch.Size((count, *term.shape)), device=device, dtype=term.dtype)
        for name, term in layout.terms.items()
    }
    return Composite(terms, shape=torch.Size([count]), device=device)


class TorchRlEnvironment(EnvBase):
    """Environment with TorchRL's interface.

    A step returns an episode's last observation, and the reset that TorchRL then calls the next one's first, which the
    environment has made already.

    Args:
        environment: environment that is stepped.
        tally: counts the episodes of every step, if there is one.
    """

    def __init__(self, environment: Environment, tally: EpisodeTally | None = None) -> None:
        batch, device = torch.Size([environment.num_envs]), environment.device
        super().__init__(device=device, batch_size=batch)
        self.environment = environment
        self._tally = tally
        # Whether (N,) the environment has begun the next episode already.
        self._begun = torch.zeros(batch, dtype=torch.bool, device=device)
        commanded, single = (torch.Size((environment.num_envs, size)) for size in (environment.action_size, 1))
        groups = {
            name: group_spec(environment.observation[name], environment.num_envs, device)
            for name in dict.fromkeys((ACTOR, critic_group(environment)))
        }
        self.observation_spec = Composite(groups, shape=batch, device=device)
        """Specification of each group, (N, ...)."""
        self.action_spec = Bounded(-1.0, 1.0, commanded, device=device)
        """Specification of the actions (N, A), in [-1, 1]."""
        self.reward_spec = Unbounded(single, device=device)
        """Specification of the rewards, (N, 1)."""
        flag = Binary(1, single, dtype=torch.bool, device=device)
        flags = {name: flag.clone() for name in ("done", "terminated", "truncated")}
        self.full_done_spec = Composite(flags, shape=batch, device=device)
        """Specification of the flags done, terminated and truncated, (N, 1) each."""

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDict:
        # The environment has begun the next episodes already, except those that the caller ends early.
        asked = None if tensordict is None else tensordict.get("_reset", None)
        rows = torch.ones_like(self._begun) if asked is None else asked.view(-1)
        stale = rows & ~self._begun
        if bool(stale.any()):
            self.environment.reset(env_ids=stale.nonzero().squeeze(-1))
        self._begun = self._begun & ~rows
        return self._told(self.environment.observe())

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        observation, reward, terminated, truncated, info = self.environment.step(tensordict["action"])
        if self._tally is not None:
            self._tally.add(info, self.environment.num_envs)
        self._begun = terminated | truncated
        told = self._told(true_next(observation, info))
        flags = {"terminated": terminated, "truncated": truncated, "done": self._begun}
        told.update({name: flag[:, None].clone() for name, flag in flags.items()})
        return told.set("reward", reward[:, None])

    def _set_seed(self, seed: int | None) -> None:
        self.environment.reset(seed)

    def _told(self, observation: Observation) -> TensorDict:
        groups: Any = {name: observation[name] for name in dict.fromkeys((ACTOR, critic_group(self.environment)))}
        return TensorDict(groups, batch_size=self.batch_size, device=self.device)


class TorchRlTrainer(LoopTrainer[PpoSettings]):
    """PPO with a constant learning rate; an update ends early if the policy changes too much."""

    name: ClassVar[str] = "torchrl"

    def __init__(self, environment: Environment, settings: PpoSettings, folder: Path | str, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        check_groups(environment, self.name)
        environment.reset(seed)  # before the collector, which only resets without a seed
        groups, critic = environment.observation, critic_group(environment)
        self._groups = {
            name: ObservedGroup(groups[name], settings, environment.device) for name in dict.fromkeys((ACTOR, critic))
        }
        self._layers = self._groups[ACTOR].network(environment.action_size)
        self.policy = _actor(self._layers, self._groups[ACTOR].keys, environment, settings)
        """Actor, with its distribution of actions."""
        self.critic = ValueOperator(self._groups[critic].network(1), in_keys=self._groups[critic].keys)
        """Value of an observation."""
        self._advantages = GAE(
            gamma=settings.discount, lmbda=settings.gae_lambda, value_network=self.critic, deactivate_vmap=True
        )
        self._loss = ClipPPOLoss(
            self.policy,
            self.critic,
            clip_epsilon=settings.clip,
            entropy_coeff=settings.entropy_weight,
            critic_coeff=1.0,
            loss_critic_type="l2",
            functional=False,
        )
        self._optimizer = torch.optim.Adam(self._loss.parameters(), lr=settings.learning_rate)
        adapted = TorchRlEnvironment(environment, self.tally)
        collector = Collector(
            adapted, self.policy, frames_per_batch=self.batch, total_frames=-1, auto_register_policy_transforms=False
        )
        self._batches = iter(collector)

    def iterate(self, iteration: int) -> None:
        batch = next(self._batches)
        with torch.no_grad():
            self._advantages(batch)
        flat = batch.reshape(-1)
        advantage = flat["advantage"]
        # Normalised over the iteration, so that the scale of rewards does not change the step.
        flat["advantage"] = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        self._update(flat)
        # After learning: the statistics must not change between collecting a step and learning from it.
        for group in self._groups.values():
            group.take_in(flat)

    def _update(self, batch: TensorDictBase) -> None:
        for _ in range(self.settings.epochs):
            for rows in torch.randperm(self.batch, device=self.environment.device).chunk(self.settings.minibatches):
                losses = self._loss(batch[rows])
                # Twice the target, from which on libraries with adaptive rates slow down.
                if losses["kl_approx"] > 2.0 * self.settings.target_kl:
                    return
                self._descend(losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"])

    def _descend(self, loss: Tensor) -> None:
        self._optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self._loss.parameters(), 1.0)
        self._optimizer.step()

    def state(self) -> Any:
        return {name: module.state_dict() for name, module in self._saved().items()}

    def load(self, state: Any) -> None:
        for name, module in self._saved().items():
            module.load_state_dict(state[name])

    def actor(self) -> ActorNetwork:
        return self._groups[ACTOR].actor(self._layers)

    def _saved(self) -> dict[str, Any]:
        return {"policy": self.policy, "critic": self.critic, "optimizer": self._optimizer}


def _actor(
    mean: nn.Module, keys: list[NestedKey], environment: Environment, settings: PpoSettings
) -> ProbabilisticActor:
    """Return a normal distribution around a network's output; its deviation is learned, but without inputs."""
    size = environment.action_size
    spread = AddStateIndependentNormalScale(
        size, scale_mapping="exp", init_value=math.log(settings.initial_std), device=environment.device
    )
    return ProbabilisticActor(
        TensorDictModule(_Spread(mean, spread), in_keys=keys, out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )


class _Spread(nn.Sequential):
    """Network with any number of inputs, and the deviation around its output."""

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride] - TorchRL gives the inputs by position
        self, *inputs: Tensor
    ) -> tuple[Tensor, Tensor]:
        network, spread = self
        return spread(network(*inputs))
