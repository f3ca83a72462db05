"""Off-policy algorithms for many environments: SAC and TD3, with large batches and returns over several steps.

Haarnoja et al., Soft Actor-Critic Algorithms and Applications (2018); Fujimoto et al., Addressing Function
Approximation Error in Actor-Critic Methods (2018). Critics with layer normalisation, large batches and exploration of
another strength in each environment follow Seo et al., FastTD3 (2025).
"""

from __future__ import annotations

import copy
import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from orbit_core.envs.environment import Environment
from orbit_core.interfaces import ArgumentError, UnknownNameError
from orbit_learn.distill import RunningMoments, copied_actor
from orbit_learn.ends import true_next
from orbit_learn.networks import ActorNetwork, NormalizedActor, Perceptron
from orbit_learn.spaces import ACTOR, check_groups, critic_group
from orbit_learn.trainer import LoopTrainer

ALGORITHMS = ("sac", "td3")
# Steps of each environment in a batch, where the settings name no size, and the bounds of that size.
_BATCH_STEPS, _LEAST_BATCH, _MOST_BATCH = 8, 256, 32_768
# Bounds of the logarithm of SAC's deviation, before tanh.
_LOG_STD = (-5.0, 1.0)
# Noise of TD3's target actions and its bound; Fujimoto et al., section 6.1.
_TARGET_NOISE, _MOST_NOISE = 0.2, 0.5
_MOST_DEVIATIONS = 10.0


@dataclass(frozen=True)
class OffPolicySettings:
    """Soft actor-critic, or twin delayed deep deterministic policy gradients."""

    algorithm: str = "sac"
    """sac (stochastic, with a learned temperature) or td3 (deterministic, with noise)."""
    iterations: int = 500
    """Number of iterations, each of collecting steps and learning from them."""
    steps_per_iteration: int = 16
    """Environment steps that every environment contributes to an iteration."""
    updates_per_step: int = 2
    """Gradient steps for one step of all environments."""
    batch_size: int = 0
    """Transitions in a gradient step; 0 for eight of each environment, between 256 and 32,768."""
    buffer_size: int = 1_000_000
    """Transitions that are kept, of all environments together."""
    warm_up: int = 16
    """Steps of every environment before the first gradient step."""
    hidden_sizes: tuple[int, ...] = (256, 256)
    """Units of the actor's hidden layers."""
    critic_sizes: tuple[int, ...] = (256, 256)
    """Units of each critic's hidden layers."""
    learning_rate: float = 5e-4
    """Adam's rate for actor, critics and temperature."""
    discount: float | None = None
    """Weight of the next step's return, per environment step; that of the task's PPO settings if None."""
    horizon: int = 3
    """Steps whose rewards are summed before the critic's estimate; more than 1 is biased by older policies, and
    faster."""
    target_rate: float = 0.01
    """Share by which the target critics follow the critics in a gradient step."""
    policy_delay: int = 2
    """Gradient steps of the critics for one of the actor."""
    target_entropy: float = -1.0
    """Entropy that SAC's temperature holds, for each component of the action."""
    temperature: float = 0.01
    """SAC's weight of entropy at first; it is learned."""
    noise: tuple[float, float] = (0.05, 0.4)
    """Smallest and largest deviation of TD3's exploration; each environment draws its own for an episode."""
    normalize_observations: bool = True
    """Whether observations are shifted and scaled to mean 0 and deviation 1 by their own statistics."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UnknownNameError: there is no such algorithm.
            ArgumentError: a setting is out of its range.
        """
        if self.algorithm not in ALGORITHMS:
            raise UnknownNameError("algorithm", self.algorithm, ALGORITHMS, "library orbit")
        positive = ("iterations", "steps_per_iteration", "updates_per_step", "buffer_size", "warm_up", "horizon")
        for name in (*positive, "policy_delay"):
            if getattr(self, name) < 1:
                raise ArgumentError(f"{name} is {getattr(self, name)!r}: give at least 1")
        if self.batch_size < 0:
            raise ArgumentError(f"batch_size is {self.batch_size}: give at least 1, or 0 for the algorithm's own")
        for name in ("learning_rate", "temperature"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ArgumentError(f"{name} is {getattr(self, name)!r}: give a number above zero")
        if not 0.0 < self.target_rate <= 1.0:
            raise ArgumentError(f"target_rate is {self.target_rate!r}: give a share above 0 and up to 1")
        if self.discount is not None and not 0.0 <= self.discount <= 1.0:
            raise ArgumentError(f"discount is {self.discount!r}: give 0 to 1")
        if not 0.0 <= self.noise[0] <= self.noise[1]:
            raise ArgumentError(f"noise is {self.noise}: give two deviations, the smaller first")
        if not self.critic_sizes or min(self.critic_sizes) < 1:
            raise ArgumentError(f"critic_sizes are {self.critic_sizes}: give each layer one unit or more")
        Perceptron(self.hidden_sizes)  # which checks its own sizes


class Transitions(NamedTuple):
    """Batch of B transitions over several steps."""

    observation: Tensor
    """(B, O) what the actor saw."""
    state: Tensor
    """(B, S) what the critics see."""
    action: Tensor
    """(B, A)."""
    reward: Tensor
    """(B,) discounted sum of rewards up to the last step."""
    next_observation: Tensor
    """(B, O) after the last step."""
    next_state: Tensor
    """(B, S) after the last step."""
    discount: Tensor
    """(B,) weight of the return after the last step; 0 where the episode was terminated."""


class TransitionBuffer:
    """Ring of the last steps of all environments; none of its methods waits for the device.

    Args:
        capacity: steps of all environments together; at least two horizons of each are kept.
        num_envs: number N of environments.
        sizes: numbers of components of observation, critic's state and action.
        horizon: steps of a transition.
        device: device of the tensors.
    """

    def __init__(
        self, capacity: int, num_envs: int, sizes: tuple[int, int, int], horizon: int, device: torch.device
    ) -> None:
        self._length, self._count, self._horizon = max(2 * horizon, capacity // num_envs), num_envs, horizon
        seen, state, action = (torch.zeros(self._length, num_envs, size, device=device) for size in sizes)
        # The observation after a step is kept too: at an episode's end it is not the next step's.
        self._rows = (seen, state, action, torch.zeros_like(seen), torch.zeros_like(state))
        self._reward = torch.zeros(self._length, num_envs, device=device)
        self._ended, self._terminated = torch.zeros((2, self._length, num_envs), dtype=torch.bool, device=device)
        self._ahead = torch.arange(horizon, device=device)
        self._next, self.steps = 0, 0
        """Steps of each environment that are kept, at most the ring's length."""

    @property
    def ready(self) -> bool:
        """Return True if there is a transition of the whole horizon."""
        return self.steps >= self._horizon

    def add(self, rows: tuple[Tensor, ...], reward: Tensor, terminated: Tensor, ended: Tensor) -> None:
        """Copy one step of all environments.

        Args:
            rows: observation (N, O), state (N, S), action (N, A), and the next observation and state.
            reward: (N,).
            terminated: (N,) bool, a terminal state was reached.
            ended: (N,) bool, the episode ended, by a terminal state or the time limit.
        """
        for kept, row in zip(self._rows, rows, strict=True):
            kept[self._next] = row
        self._reward[self._next], self._terminated[self._next], self._ended[self._next] = reward, terminated, ended
        self._next = (self._next + 1) % self._length
        self.steps = min(self.steps + 1, self._length)

    def sample(self, count: int, discount: float) -> Transitions:
        """Return ``count`` transitions that begin at random kept steps.

        A transition ends with its episode. The newest steps, which have no whole horizon after them yet, are not
        begun with.
        """
        device = self._reward.device
        span = self.steps - self._horizon + 1
        first = torch.randint(span, (count,), device=device) + (self._next - self.steps)
        return self._transitions(first, torch.randint(self._count, (count,), device=device), discount)

    def _transitions(self, first: Tensor, environment: Tensor, discount: float) -> Transitions:
        """Return the transitions that begin at steps ``first`` (B,), of environments (B,)."""
        times = (first[:, None] + self._ahead) % self._length
        column = environment[:, None]
        ended = self._ended[times, column]
        # Steps after an end belong to the next episode.
        counted = torch.cat((torch.ones_like(ended[:, :1]), (~ended[:, :-1]).cumprod(1).bool()), 1)
        reward = (self._reward[times, column] * counted * discount**self._ahead).sum(1)
        length = counted.sum(1)
        last = times.gather(1, length[:, None] - 1).squeeze(1)
        begin = times[:, 0]
        seen, state, action, next_seen, next_state = self._rows
        weight = discount**length * ~self._terminated[last, environment]
        return Transitions(
            seen[begin, environment], state[begin, environment], action[begin, environment], reward,
            next_seen[last, environment], next_state[last, environment], weight,
        )  # fmt: skip


class TwinCritic(nn.Module):
    """Two estimates of the return of a state and an action, by separate perceptrons with layer normalisation.

    Args:
        inputs: components of state and action together.
        sizes: units of the hidden layers.
    """

    def __init__(self, inputs: int, sizes: tuple[int, ...]) -> None:
        super().__init__()
        self.critics = nn.ModuleList(_critic(inputs, sizes) for _ in range(2))
        """Both perceptrons, from state and action to the return."""

    def forward(self, state: Tensor, action: Tensor) -> Tensor:
        """Return the estimates (2, B)."""
        inputs = torch.cat((state, action), dim=1)
        return torch.stack([critic(inputs).squeeze(1) for critic in self.critics])


def _critic(inputs: int, sizes: tuple[int, ...]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for taken, given in itertools.pairwise((inputs, *sizes)):
        layers += [nn.Linear(taken, given), nn.LayerNorm(given), nn.SiLU()]
    return nn.Sequential(*layers, nn.Linear(sizes[-1], 1))


class OffPolicyTrainer(LoopTrainer[OffPolicySettings]):
    """Trainer by SAC or TD3. The policy file holds the deterministic actor.

    Kept transitions are not part of checkpoints, because they take gigabytes: a training that resumes collects
    ``warm_up`` steps by its policy before it learns again.

    Raises:
        ConfigurationError: the policy's observation group holds pictures.
    """

    name: ClassVar[str] = "orbit"
    settings_type: ClassVar[type[Any]] = OffPolicySettings
    options: ClassVar[tuple[str, ...]] = ("off_policy", "algorithm")

    def __init__(self, environment: Environment, settings: OffPolicySettings, folder: Path | str, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        check_groups(environment, self.name)
        device, groups, actions = environment.device, environment.observation, environment.action_size
        self._critic_group = critic_group(environment)
        discount = environment.task.metadata.ppo.discount if settings.discount is None else settings.discount
        self._discount = discount
        sizes = (groups[ACTOR].size, groups[self._critic_group].size, actions)
        fitting = min(max(_BATCH_STEPS * environment.num_envs, _LEAST_BATCH), _MOST_BATCH)
        self._batch_size = settings.batch_size or fitting
        self._network = Perceptron(settings.hidden_sizes, observation_limit=_MOST_DEVIATIONS, squashed=True)
        actor = self._network.build(sizes[0], actions)
        assert isinstance(actor, NormalizedActor)
        self._actor = actor.to(device)
        # SAC's deviation is read from the layer that the mean is read from.
        self._spread = nn.Linear((sizes[0], *settings.hidden_sizes)[-1], actions, device=device)
        self._critic = TwinCritic(sizes[1] + actions, settings.critic_sizes).to(device)
        self._target = copy.deepcopy(self._critic).requires_grad_(False)
        self._actor_target = copy.deepcopy(self._actor).requires_grad_(False)
        self._log_temperature = torch.tensor(math.log(settings.temperature), device=device, requires_grad=True)
        rate = settings.learning_rate
        self._actor_optimizer = torch.optim.Adam([*self._actor.parameters(), *self._spread.parameters()], lr=rate)
        self._critic_optimizer = torch.optim.Adam(self._critic.parameters(), lr=rate)
        self._temperature_optimizer = torch.optim.Adam([self._log_temperature], lr=rate)
        self._moments = {
            name: RunningMoments(groups[name].size, device) for name in dict.fromkeys((ACTOR, self._critic_group))
        }
        self._buffer = TransitionBuffer(settings.buffer_size, environment.num_envs, sizes, settings.horizon, device)
        self._noise = torch.empty(environment.num_envs, 1, device=device).uniform_(*settings.noise)
        self._seen, _ = environment.reset(seed)
        # If all episodes began together, a batch would hold one time of the episode at first.
        environment.state.episode_step.random_(environment.max_episode_steps)
        self._updates = 0
        self._loss = torch.zeros((), device=device)

    def iterate(self, iteration: int) -> None:
        ahead = max(0, max(self.settings.warm_up, self.settings.horizon) - 1 - self._buffer.steps)
        self.steps_ahead += ahead * self.environment.num_envs
        for _ in range(ahead):
            self._collect()
        self._loss.zero_()
        for _ in range(self.settings.steps_per_iteration):
            self._collect()
            self._take_in_statistics()
            for _ in range(self.settings.updates_per_step):
                self._update()

    def loss(self) -> float:
        """Return the critics' mean squared error of the last iteration."""
        return float(self._loss) / (self.settings.steps_per_iteration * self.settings.updates_per_step)

    def state(self) -> Any:
        """Return weights, the optimisers' states, the temperature and the observations' statistics."""
        return {
            **{name: part.state_dict() for name, part in self._saved().items()},
            "log_temperature": self._log_temperature.detach(),
            "moments": {name: moments.state() for name, moments in self._moments.items()},
            "updates": self._updates,
        }

    def load(self, state: Any) -> None:
        for name, part in self._saved().items():
            part.load_state_dict(state[name])
        with torch.no_grad():
            self._log_temperature.copy_(state["log_temperature"])
        for name, moments in self._moments.items():
            moments.load(state["moments"][name])
        self._updates = state["updates"]

    def _saved(self) -> dict[str, Any]:
        return {
            "actor": self._actor, "spread": self._spread, "critic": self._critic, "target": self._target,
            "actor_target": self._actor_target, "actor_optimizer": self._actor_optimizer,
            "critic_optimizer": self._critic_optimizer, "temperature_optimizer": self._temperature_optimizer,
        }  # fmt: skip

    def actor(self) -> ActorNetwork:
        return copied_actor(self._network, self._actor)

    # Collecting ------------------------------------------------------------------------------------------------------

    @torch.no_grad()
    def _collect(self) -> None:
        """Take one step of all environments, and keep it."""
        environment, seen, state = self.environment, self._seen[ACTOR], self._seen[self._critic_group]
        assert isinstance(seen, Tensor)
        assert isinstance(state, Tensor)
        for name, moments in self._moments.items():
            moments.add(self._seen[name])  # pyright: ignore[reportArgumentType] - groups are concatenated
        action = self._explore(seen)
        following, reward, terminated, truncated, info = environment.step(action)
        self.tally.add(info, environment.num_envs)
        after, ended = true_next(following, info), terminated | truncated
        rows: Any = (seen, state, action, after[ACTOR], after[self._critic_group])
        self._buffer.add(rows, reward, terminated, ended)
        if self.settings.algorithm == "td3":
            drawn = torch.empty_like(self._noise).uniform_(*self.settings.noise)
            self._noise = torch.where(ended[:, None], drawn, self._noise)
        self._seen = following

    def _explore(self, seen: Tensor) -> Tensor:
        if self.settings.algorithm == "sac":
            return self._sampled(seen)[0]
        action = self._actor(seen)
        return (action + self._noise * torch.randn_like(action)).clamp(-1.0, 1.0)

    def _take_in_statistics(self) -> None:
        """Normalise by the statistics so far."""
        if self.settings.normalize_observations:
            moments = self._moments[ACTOR]
            for actor in (self._actor, self._actor_target):
                actor.mean.copy_(moments.mean)
                actor.std.copy_(moments.std)

    # Learning --------------------------------------------------------------------------------------------------------

    def _sampled(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Draw SAC's actions (B, A), and return them with the logarithm (B,) of their density."""
        *hidden, last = self._actor.layers
        features = self._actor.encode(seen)
        for layer in hidden:
            features = layer(features)
        mean, log_std = last(features), self._spread(features).clamp(*_LOG_STD)
        noise = torch.randn_like(mean)
        free = mean + log_std.exp() * noise
        # The density of tanh(x) by the change of variables: log(1 - tanh(x)^2) = 2 (log 2 - x - softplus(-2 x)).
        change = 2.0 * (math.log(2.0) - free - F.softplus(-2.0 * free))
        density = -0.5 * noise.square() - log_std - 0.5 * math.log(2.0 * math.pi) - change
        return torch.tanh(free), density.sum(1)

    def _judged(self, critic: TwinCritic, state: Tensor, action: Tensor) -> Tensor:
        """Return the estimates (2, B) for a state before normalisation."""
        if self.settings.normalize_observations:
            # The buffer keeps states as they were measured, because the statistics go on changing meanwhile.
            moments = self._moments[self._critic_group]
            state = ((state - moments.mean) / moments.std).clamp(-_MOST_DEVIATIONS, _MOST_DEVIATIONS)
        return critic(state, action)

    def _update(self) -> None:
        batch = self._buffer.sample(self._batch_size, self._discount)
        with torch.no_grad():
            action, density = self._following(batch.next_observation)
            # The smaller of both estimates, because the larger one is the one that errs upwards.
            worth = self._judged(self._target, batch.next_state, action).amin(0)
            wanted = batch.reward + batch.discount * (worth - self._log_temperature.exp() * density)
        loss = F.mse_loss(self._judged(self._critic, batch.state, batch.action), wanted.expand(2, -1))
        self._descend(self._critic_optimizer, loss)
        self._loss += loss.detach()
        self._updates += 1
        if self._updates % self.settings.policy_delay == 0:
            self._improve(batch)
        with torch.no_grad():
            _follow(self._target, self._critic, self.settings.target_rate)
            _follow(self._actor_target, self._actor, self.settings.target_rate)

    def _following(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Return the actions (B, A) that a target assumes, and the logarithm (B,) of their density; 0 for TD3."""
        if self.settings.algorithm == "sac":
            return self._sampled(seen)
        action = self._actor_target(seen)
        noise = (_TARGET_NOISE * torch.randn_like(action)).clamp(-_MOST_NOISE, _MOST_NOISE)
        return (action + noise).clamp(-1.0, 1.0), action.new_zeros(len(action))

    def _improve(self, batch: Transitions) -> None:
        """Improve the actor, and SAC's temperature."""
        if self.settings.algorithm == "td3":
            worth = self._judged(self._critic, batch.state, self._actor(batch.observation))
            self._descend(self._actor_optimizer, -worth.mean())
            return
        action, density = self._sampled(batch.observation)
        worth = self._judged(self._critic, batch.state, action).amin(0)
        self._descend(self._actor_optimizer, (self._log_temperature.detach().exp() * density - worth).mean())
        surplus = density.detach().mean() + self.settings.target_entropy * action.shape[1]
        self._descend(self._temperature_optimizer, -self._log_temperature.exp() * surplus)

    @staticmethod
    def _descend(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()


def _follow(target: nn.Module, source: nn.Module, rate: float) -> None:
    for kept, new in zip(target.parameters(), source.parameters(), strict=True):
        kept.lerp_(new, rate)
