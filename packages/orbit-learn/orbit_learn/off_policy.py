"""Off-policy algorithms for many environments: SAC and TD3, with large batches and returns over several steps.

On a GPU a step with the policy's action and what is kept of it is one recording, and a gradient step another: the host
launches both without any Python between their operations.

Haarnoja et al., Soft Actor-Critic Algorithms and Applications (2018); Fujimoto et al., Addressing Function
Approximation Error in Actor-Critic Methods (2018). Critics with layer normalisation, large batches and exploration of
another strength in each environment follow Seo et al., FastTD3 (2025).
"""

from __future__ import annotations

import contextlib
import copy
import itertools
import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from orbit_core.envs.captured_step import StepResult
from orbit_core.envs.environment import Environment
from orbit_core.envs.observation_layout import Observation
from orbit_core.envs.off_policy import OffPolicySettings
from orbit_core.envs.policy_loop import PolicyLoop
from orbit_learn.distill import RunningMoments, copied_actor
from orbit_learn.ends import true_next
from orbit_learn.networks import ActorNetwork, NormalizedActor, Perceptron
from orbit_learn.recorded import RecordedFunction
from orbit_learn.spaces import ACTOR, check_groups, critic_group
from orbit_learn.trainer import LoopTrainer

# Steps of each environment in a batch, where the settings name no size, and the bounds of that size.
_BATCH_STEPS, _LEAST_BATCH, _MOST_BATCH = 8, 256, 32_768
# Bounds of the logarithm of SAC's deviation, before tanh.
_LOG_STD = (-5.0, 1.0)
# Noise of TD3's target actions and its bound; Fujimoto et al., section 6.1.
_TARGET_NOISE, _MOST_NOISE = 0.2, 0.5
_MOST_DEVIATIONS = 10.0


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
    """Ring of the last steps of all environments; no method waits for the device, so that all of them can be recorded.

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
        # On the device, because a recorded step must find its own place in each replay: (1,) place of the next step,
        # and number of steps of each environment that are kept.
        self._next, self._steps = torch.zeros((2, 1), dtype=torch.int64, device=device)

    def add(self, rows: tuple[Tensor, ...], reward: Tensor, terminated: Tensor, ended: Tensor) -> None:
        """Copy one step of all environments.

        Args:
            rows: observation (N, O), state (N, S), action (N, A), and the next observation and state.
            reward: (N,).
            terminated: (N,) bool, a terminal state was reached.
            ended: (N,) bool, the episode ended, by a terminal state or the time limit.
        """
        kept = (*self._rows, self._reward, self._terminated, self._ended)
        for memory, row in zip(kept, (*rows, reward, terminated, ended), strict=True):
            memory.index_copy_(0, self._next, row[None])
        self._next.add_(1).remainder_(self._length)
        self._steps.add_(1).clamp_(max=self._length)

    def sample(self, count: int, discount: float) -> Transitions:
        """Return ``count`` transitions that begin at random kept steps, of which there must be a whole horizon.

        A transition ends with its episode. The newest steps, which have no whole horizon after them yet, are not
        begun with.
        """
        device = self._reward.device
        span = self._steps - self._horizon + 1
        # A number below 1 may be rounded up to the span itself.
        drawn = (torch.rand(count, device=device) * span).long().minimum(span - 1)
        first = drawn + self._next - self._steps
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
    chooses_arithmetic: ClassVar[bool] = True
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
        adam = partial(torch.optim.Adam, lr=rate, fused=True, capturable=device.type == "cuda")
        self._actor_optimizer = adam([*self._actor.parameters(), *self._spread.parameters()])
        self._critic_optimizer = adam(self._critic.parameters())
        self._temperature_optimizer = adam([self._log_temperature])
        self._moments = {
            name: RunningMoments(groups[name].size, device) for name in dict.fromkeys((ACTOR, self._critic_group))
        }
        self._buffer = TransitionBuffer(settings.buffer_size, environment.num_envs, sizes, settings.horizon, device)
        count = environment.num_envs
        # Normal numbers (N, A) of the next step, and TD3's deviations (N, 1), those of episodes that begin drawn ahead.
        self._drawn, self._action = torch.zeros((2, count, actions), device=device)
        self._noise, self._next_noise = torch.empty((2, count, 1), device=device).uniform_(*settings.noise)
        environment.reset(seed)
        # If all episodes began together, a batch would hold one time of the episode at first.
        environment.spread_episodes()
        self._loop = PolicyLoop(environment, self._act, self._keep)
        self._collected, self._updates = 0, 0
        self._loss = torch.zeros((), device=device)
        self._record()

    def _record(self) -> None:
        """Have gradient steps recorded, without and with one of the actor."""
        learn = (partial(self._learn, improves) for improves in (False, True))
        self._learning = tuple(RecordedFunction(function, self.environment.device) for function in learn)

    def iterate(self, iteration: int) -> None:
        ahead = max(0, max(self.settings.warm_up, self.settings.horizon) - 1 - self._collected)
        self.steps_ahead += ahead * self.environment.num_envs
        for _ in range(ahead):
            self._collect()
        self._loss.zero_()
        for _ in range(self.settings.steps_per_iteration):
            self._collect()
            for _ in range(self.settings.updates_per_step):
                self._updates += 1
                self._learning[self._updates % self.settings.policy_delay == 0]()

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
        self._record()  # the optimisers' states have moved

    def _saved(self) -> dict[str, Any]:
        return {
            "actor": self._actor, "spread": self._spread, "critic": self._critic, "target": self._target,
            "actor_target": self._actor_target, "actor_optimizer": self._actor_optimizer,
            "critic_optimizer": self._critic_optimizer, "temperature_optimizer": self._temperature_optimizer,
        }  # fmt: skip

    def actor(self) -> ActorNetwork:
        return copied_actor(self._network, self._actor)

    # Collecting: both functions are recorded with the environment's step ---------------------------------------------

    def _collect(self) -> None:
        """Take one step of all environments, and keep it."""
        self._drawn.normal_()
        self._next_noise.uniform_(*self.settings.noise)
        self.environment.step_by(self._loop)
        self._collected += 1

    def _act(self, observation: Observation) -> Tensor:
        for name, moments in self._moments.items():
            moments.add(cast(Tensor, observation[name]))
        self._take_in_statistics()
        seen = cast(Tensor, observation[ACTOR])
        if self.settings.algorithm == "sac":
            action = self._sampled(seen, self._drawn)[0]
        else:
            action = (self._actor(seen) + self._noise * self._drawn).clamp(-1.0, 1.0)
        return self._action.copy_(action)

    def _keep(self, result: StepResult) -> None:
        following, reward, terminated, truncated, info = result
        self.tally.add(info, self.environment.num_envs)
        after, ended = true_next(following, info), terminated | truncated
        groups = (ACTOR, self._critic_group)
        (seen, state), (next_seen, next_state) = (
            [cast(Tensor, group[name]) for name in groups] for group in (self._loop.observation, after)
        )
        self._buffer.add((seen, state, self._action, next_seen, next_state), reward, terminated, ended)
        self._noise.copy_(torch.where(ended[:, None], self._next_noise, self._noise))

    def _take_in_statistics(self) -> None:
        """Normalise by the statistics so far."""
        if self.settings.normalize_observations:
            moments = self._moments[ACTOR]
            for actor in (self._actor, self._actor_target):
                actor.mean.copy_(moments.mean)
                actor.std.copy_(moments.std)

    # Learning: a gradient step is recorded as one graph --------------------------------------------------------------

    def _sampled(self, seen: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Return SAC's actions (B, A) for normal numbers (B, A), and the logarithm (B,) of their density."""
        *hidden, last = self._actor.layers
        features = self._actor.encode(seen)
        for layer in hidden:
            features = layer(features)
        mean, log_std = last(features), self._spread(features).clamp(*_LOG_STD)
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

    def _learn(self, improves: bool) -> None:
        """Take one gradient step of the critics, and one of the actor if it ``improves``."""
        with self._matrix_products():
            batch = self._buffer.sample(self._batch_size, self._discount)
            with torch.no_grad():
                action, density = self._following(batch.next_observation)
                # The smaller of both estimates, because the larger one is the one that errs upwards.
                worth = self._judged(self._target, batch.next_state, action).amin(0)
                wanted = batch.reward + batch.discount * (worth - self._log_temperature.exp() * density)
            loss = F.mse_loss(self._judged(self._critic, batch.state, batch.action), wanted.expand(2, -1))
            self._descend(self._critic_optimizer, loss)
            if improves:
                self._improve(batch)
        with torch.no_grad():
            self._loss += loss.detach()
            _follow(self._target, self._critic, self.settings.target_rate)
            _follow(self._actor_target, self._actor, self.settings.target_rate)

    def _following(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Return the actions (B, A) that a target assumes, and the logarithm (B,) of their density; 0 for TD3."""
        if self.settings.algorithm == "sac":
            return self._sampled(seen, torch.randn(len(seen), self._action.shape[1], device=seen.device))
        action = self._actor_target(seen)
        noise = (_TARGET_NOISE * torch.randn_like(action)).clamp(-_MOST_NOISE, _MOST_NOISE)
        return (action + noise).clamp(-1.0, 1.0), action.new_zeros(len(action))

    def _improve(self, batch: Transitions) -> None:
        """Improve the actor, and SAC's temperature."""
        if self.settings.algorithm == "td3":
            worth = self._judged(self._critic, batch.state, self._actor(batch.observation))
            self._descend(self._actor_optimizer, -worth.mean())
            return
        action, density = self._sampled(batch.observation, torch.randn_like(batch.action))
        worth = self._judged(self._critic, batch.state, action).amin(0)
        self._descend(self._actor_optimizer, (self._log_temperature.detach().exp() * density - worth).mean())
        surplus = density.detach().mean() + self.settings.target_entropy * action.shape[1]
        self._descend(self._temperature_optimizer, -self._log_temperature.exp() * surplus)

    @staticmethod
    def _descend(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
        optimizer.zero_grad()
        # The actor's loss goes through the critics, whose own gradients it does not need.
        loss.backward(inputs=[weight for group in optimizer.param_groups for weight in group["params"]])
        optimizer.step()

    @contextlib.contextmanager
    def _matrix_products(self) -> Iterator[None]:
        """Let float32 products use tensor cores where the settings allow it."""
        before = torch.backends.cuda.matmul.allow_tf32
        torch.backends.cuda.matmul.allow_tf32 = before or self.settings.precision == "tf32"
        try:
            yield
        finally:
            torch.backends.cuda.matmul.allow_tf32 = before


def _follow(target: nn.Module, source: nn.Module, rate: float) -> None:
    # One launch for all tensors.
    lerp = torch._foreach_lerp_  # pyright: ignore[reportPrivateImportUsage] - has no other name
    lerp([*target.parameters()], [*source.parameters()], rate)
