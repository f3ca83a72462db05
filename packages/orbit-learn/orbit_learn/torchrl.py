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
from orbit_core.envs.observation_layout import Observation
from orbit_core.envs.ppo import PpoSettings
from orbit_learn.ends import EpisodeTally, true_next
from orbit_learn.groups import ACTOR, check_groups, critic_group
from orbit_learn.loop import LoopTrainer
from orbit_learn.networks import ActorNetwork
from orbit_learn.torchrl_groups import ObservedGroup, group_spec


class TorchRlEnvironment(EnvBase):
    """An environment as TorchRL expects it: a step ends with an episode's last observation, and the reset that TorchRL
    asks for then gives the next one's first, which the environment has made by itself.

    Args:
        environment: that is stepped.
        tally: told of every step, if there is one.
    """

    def __init__(self, environment: Environment, tally: EpisodeTally | None = None) -> None:
        batch, device = torch.Size([environment.num_envs]), environment.device
        super().__init__(device=device, batch_size=batch)
        self.environment = environment
        self._tally = tally
        self._begun = torch.zeros(batch, dtype=torch.bool, device=device)
        """(N,) whose next episode the environment has begun by itself."""
        commanded, single = (torch.Size((environment.num_envs, size)) for size in (environment.action_size, 1))
        groups = {
            name: group_spec(environment.observation[name], environment.num_envs, device)
            for name in dict.fromkeys((ACTOR, critic_group(environment)))
        }
        self.observation_spec = Composite(groups, shape=batch, device=device)
        self.action_spec = Bounded(-1.0, 1.0, commanded, device=device)
        self.reward_spec = Unbounded(single, device=device)
        flag = Binary(1, single, dtype=torch.bool, device=device)
        flags = {name: flag.clone() for name in ("done", "terminated", "truncated")}
        self.full_done_spec = Composite(flags, shape=batch, device=device)

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDict:
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
    """PPO with a constant learning rate; an update ends early where the policy moves too far."""

    name: ClassVar[str] = "torchrl"

    def __init__(self, environment: Environment, settings: PpoSettings, folder: Path | str, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        check_groups(environment, self.name)
        environment.reset(seed)
        groups, critic = environment.observation, critic_group(environment)
        self._groups = {
            name: ObservedGroup(groups[name], settings, environment.device) for name in dict.fromkeys((ACTOR, critic))
        }
        self._layers = self._groups[ACTOR].network(environment.action_size)
        self.policy = _actor(self._layers, self._groups[ACTOR].keys, environment, settings)
        self.critic = ValueOperator(self._groups[critic].network(1), in_keys=self._groups[critic].keys)
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
        flat["advantage"] = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        self._update(flat)
        for group in self._groups.values():
            group.take_in(flat)

    def _update(self, batch: TensorDictBase) -> None:
        for _ in range(self.settings.epochs):
            for rows in torch.randperm(self.batch, device=self.environment.device).chunk(self.settings.minibatches):
                losses = self._loss(batch[rows])
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
    """Normal about what the network gives, with a deviation that is learned but no function of the observation."""
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
    """A network of any number of inputs, and the deviation about what it gives."""

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride] - TorchRL gives the inputs by position
        self, *inputs: Tensor
    ) -> tuple[Tensor, Tensor]:
        network, spread = self
        return spread(network(*inputs))
