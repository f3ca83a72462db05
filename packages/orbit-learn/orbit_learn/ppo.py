"""Proximal policy optimisation whose iteration runs almost without Python: steps and update are recorded on a GPU.

Schulman et al., Proximal Policy Optimization Algorithms (2017), with a learning rate that follows the divergence of the
policies, as in Rudin et al., Learning to Walk in Minutes Using Massively Parallel Deep Reinforcement Learning (2021).
Its arithmetic is that of RSL-RL, so that settings and results carry over; tests compare both.
"""

from __future__ import annotations

import contextlib
import copy
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, cast

import torch
from torch import Tensor, nn

from orbit_core.envs.captured_step import StepResult
from orbit_core.envs.environment import Environment
from orbit_core.envs.observation_layout import Observation
from orbit_core.envs.policy_loop import PolicyLoop
from orbit_core.envs.ppo import PpoSettings
from orbit_core.interfaces import ConfigurationError
from orbit_learn.distill import RunningMoments, copied_actor
from orbit_learn.networks import ActorNetwork, NormalizedActor, Perceptron
from orbit_learn.processes import average, share, standardized
from orbit_learn.recorded import RecordedFunction
from orbit_learn.spaces import ACTOR, check_groups, critic_group
from orbit_learn.trainer import LoopTrainer

# The rate grows or shrinks by this factor, between these bounds, where the divergence is half or twice its target.
_RATE_FACTOR, _LEAST_RATE, _MOST_RATE = 1.5, 1e-5, 1e-2
_MOST_GRADIENT = 1.0
# A deviation above 1 only earns more entropy, because actions are clipped to [-1, 1]: that would grow without end.
_MOST_STD = 1.0
_HALF_LOG_TWO_PI = 0.5 * math.log(2.0 * math.pi)
# Numbers that an update averages over its gradient steps.
_NUMBERS = ("surrogate", "value", "entropy", "divergence")


class Samples(NamedTuple):
    """Steps to learn from; B rows each."""

    seen: Tensor
    """(B, O) normalised observation of the actor."""
    state: Tensor
    """(B, S) normalised observation of the critic."""
    action: Tensor
    """(B, A) before clipping."""
    mean: Tensor
    """(B, A) mean of the policy that acted."""
    value: Tensor
    """(B,) critic's estimate before the update."""
    returns: Tensor
    """(B,) return that the critic learns."""
    advantage: Tensor
    """(B,) normalised over all samples."""


class Rollout:
    """Memory of T steps of N environments, written at a step number that lies on the device.

    Args:
        steps: number T.
        num_envs: number N.
        sizes: components of the actor's observation, the critic's, and the action.
        device: device of all tensors.
    """

    def __init__(self, steps: int, num_envs: int, sizes: tuple[int, int, int], device: torch.device) -> None:
        seen, state, action = (torch.zeros(steps, num_envs, size, device=device) for size in sizes)
        self.seen, self.state, self.action = seen, state, action
        """(T, N, ...) observations of actor and critic, and actions."""
        self.mean, self.noise = torch.zeros_like(action), torch.zeros_like(action)
        """(T, N, A) means of the actions, and noise in standard deviations, drawn before the first step."""
        self.reward = torch.zeros(steps, num_envs, device=device)
        """(T, N)"""
        self.ended, self.late = torch.zeros((2, steps, num_envs), dtype=torch.bool, device=device)
        """(T, N) the episode ended; it ended by the time limit."""
        # On the device, because a recorded step must find its own place in each replay.
        self._step = torch.zeros(1, dtype=torch.int64, device=device)

    def begin(self) -> None:
        """Draw the noise, and go back to the first step."""
        self.noise.normal_()
        self._step.zero_()

    def next_noise(self) -> Tensor:
        """Return the noise (N, A) of the present step."""
        return self.noise.index_select(0, self._step)[0]

    def write(self, **rows: Tensor) -> None:
        """Write tensors (N, ...) of the present step, by name."""
        for name, row in rows.items():
            getattr(self, name).index_copy_(0, self._step, row[None])

    def advance(self) -> None:
        """Go on to the next step."""
        self._step.add_(1)


def advantages_of(rollout: Rollout, value: Tensor, discount: float, gae_lambda: float) -> Tensor:
    """Return generalised advantage estimates (T, N): Schulman et al. (2016).

    Args:
        rollout: rewards and ends of episodes. Where the time limit ended one, the return goes on with the value of the
            state before the last step, because the state after it belongs to the next episode.
        value: (T + 1, N) estimates before each step, and after the last.
        discount: weight of the next step's return.
        gae_lambda: weight of the next step's advantage, in addition.
    """
    going_on = discount * (1.0 - rollout.ended.float())
    reward = rollout.reward + discount * value[:-1] * rollout.late
    errors = reward + going_on * value[1:] - value[:-1]
    advantage, found = torch.zeros_like(errors[0]), []
    for error, weight in zip(errors.flip(0), (going_on * gae_lambda).flip(0), strict=True):
        advantage = error + weight * advantage
        found.append(advantage)
    return torch.stack(found[::-1])


class PpoTrainer(LoopTrainer[PpoSettings]):
    """Trainer by PPO of perceptrons that see one tensor each.

    Raises:
        ConfigurationError: an observation group holds pictures, or a setting needs another library.
    """

    name: ClassVar[str] = "orbit"
    several_gpus: ClassVar[bool] = True
    several_engines: ClassVar[bool] = True
    chooses_arithmetic: ClassVar[bool] = True

    def __init__(self, environment: Environment, settings: PpoSettings, folder: Path | str, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        check_groups(environment, self.name)
        device, groups, actions = environment.device, environment.observation, environment.action_size
        self._critic_group = critic_group(environment)
        sizes = (groups[ACTOR].size, groups[self._critic_group].size, actions)
        self._network = Perceptron(settings.hidden_sizes)
        shapes = (sizes[0], actions), (sizes[1], 1)
        networks = (cast(NormalizedActor, self._network.build(*shape)).to(device) for shape in shapes)
        self._actor, self._critic = networks
        self._log_std = nn.Parameter(torch.full((actions,), math.log(settings.initial_std), device=device))
        self._moments = {
            name: RunningMoments(groups[name].size, device) for name in dict.fromkeys((ACTOR, self._critic_group))
        }
        self._actor_weights = [*self._actor.parameters(), self._log_std]
        self._critic_weights = list(self._critic.parameters())
        # Each process has drawn its own: averaged gradients keep equal weights equal.
        share([*self._actor_weights, *self._critic_weights])
        # A tensor, because the recorded update changes it.
        self._rate = torch.tensor(settings.learning_rate, device=device)
        self._optimizer = torch.optim.Adam(
            [*self._actor_weights, *self._critic_weights], lr=self._rate, fused=True, capturable=device.type == "cuda"
        )
        steps, count = settings.steps_per_iteration, environment.num_envs
        self._rollout = Rollout(steps, count, sizes, device)
        if steps * count < settings.minibatches:
            raise ConfigurationError(
                f"{count} environments give {steps * count} steps in an iteration, fewer than minibatches="
                f"{settings.minibatches}: give more --num-envs, or fewer --ppo minibatches"
            )
        self._order = torch.arange(steps * count, device=device)
        self._numbers = torch.zeros(len(_NUMBERS), device=device)
        self._losses = torch.compile(self._losses_of) if settings.compile_update else self._losses_of
        self._update = RecordedFunction(self._learn, device)
        environment.reset(seed)
        # If all episodes began together, an iteration would hold one time of the episode.
        environment.spread_episodes()
        self._loop = PolicyLoop(environment, self._act, self._keep)

    def iterate(self, iteration: int) -> None:
        self._rollout.begin()
        for _ in range(self.settings.steps_per_iteration):
            self.environment.step_by(self._loop)
        # Outside of the recording, because torch cannot record a permutation.
        torch.randperm(len(self._order), out=self._order)
        self._update()

    def numbers(self) -> Mapping[str, float]:
        """Return the losses, the divergence, the learning rate and the mean deviation of the last iteration."""
        values = torch.cat((self._numbers, self._rate[None], self._log_std.detach().exp().mean()[None]))
        return dict(zip((*_NUMBERS, "rate", "std"), values.tolist(), strict=True))

    def state(self) -> Any:
        """Return weights, the optimiser's state, the learning rate and the observations' statistics."""
        return {
            "actor": self._actor.state_dict(),
            "critic": self._critic.state_dict(),
            "log_std": self._log_std.detach(),
            "optimizer": self._optimizer.state_dict()["state"],
            "rate": self._rate,
            "moments": {name: moments.state() for name, moments in self._moments.items()},
        }

    def load(self, state: Any) -> None:
        self._actor.load_state_dict(state["actor"])
        self._critic.load_state_dict(state["critic"])
        groups = self._optimizer.state_dict()["param_groups"]
        # Copied, for loading keeps tensors of the same device as they are: two trainers would share their moments.
        moments = copy.deepcopy(state["optimizer"])
        self._optimizer.load_state_dict({"state": moments, "param_groups": groups})
        with torch.no_grad():
            self._log_std.copy_(state["log_std"])
            self._rate.copy_(state["rate"])
        self._optimizer.param_groups[0]["lr"] = self._rate  # of which loading has made a copy
        for name, moments in self._moments.items():
            moments.load(state["moments"][name])
        self._update = RecordedFunction(self._learn, self.environment.device)  # the optimiser's state has moved

    def close(self) -> None:
        self._update.forget()

    def actor(self) -> ActorNetwork:
        return copied_actor(self._network, self._actor)

    # Collecting: both functions are recorded with the environment's step ---------------------------------------------

    def _act(self, observation: Observation) -> Tensor:
        seen, state = self._tensors_of(observation)
        mean = self._actor.unclipped(seen)
        action = mean + self._log_std.exp() * self._rollout.next_noise()
        self._rollout.write(seen=seen, state=state, mean=mean, action=action)
        return action

    def _keep(self, result: StepResult) -> None:
        _, reward, terminated, truncated, info = result
        self._rollout.write(reward=reward, ended=terminated | truncated, late=truncated)
        self._rollout.advance()
        self.tally.add(info, self.environment.num_envs)

    def _tensors_of(self, observation: Observation) -> tuple[Tensor, Tensor]:
        return cast(Tensor, observation[ACTOR]), cast(Tensor, observation[self._critic_group])

    # Learning: all of it is recorded as one graph --------------------------------------------------------------------

    def _learn(self) -> None:
        """Update the networks by the rollout, in the order of the samples that was drawn."""
        settings, count = self.settings, len(self._order) // self.settings.minibatches
        with torch.no_grad(), self._matrix_products():
            samples, old_log_std = self._samples(count * settings.minibatches), self._log_std.clone()
            self._numbers.zero_()
        for _ in range(settings.epochs):
            for first in range(0, count * settings.minibatches, count):
                self._descend(Samples(*(rows[first : first + count] for rows in samples)), old_log_std)
        with torch.no_grad():
            self._numbers.div_(settings.epochs * settings.minibatches)
            self._log_std.clamp_(max=math.log(max(_MOST_STD, settings.initial_std)))
            if settings.normalize_observations:
                self._take_in_statistics()

    def _samples(self, count: int) -> Samples:
        """Return the first ``count`` samples in the order drawn, with values, returns and normalised advantages."""
        rollout, settings = self._rollout, self.settings
        state = self._critic.encode(rollout.state)
        after = self._critic.encode(self._tensors_of(self._loop.observation)[1])
        value = self._critic.layers(torch.cat((state, after[None]))).squeeze(-1)
        advantage = advantages_of(rollout, value, settings.discount, settings.gae_lambda)
        returns, value = advantage + value[:-1], value[:-1]
        advantage = standardized(advantage)
        seen = self._actor.encode(rollout.seen)
        whole = Samples(seen, state, rollout.action, rollout.mean, value, returns, advantage)
        # Gathered once: every pass goes through the same order.
        order = self._order[:count]
        return Samples(*(rows.flatten(0, 1).index_select(0, order) for rows in whole))

    def _descend(self, samples: Samples, old_log_std: Tensor) -> None:
        """Take one gradient step, with the rate that follows from the divergence before it."""
        with self._matrix_products():
            loss, numbers = self._losses(samples, old_log_std)
            self._optimizer.zero_grad()
            loss.backward()
        average([numbers, *(cast(Tensor, weight.grad) for weight in (*self._actor_weights, *self._critic_weights))])
        with torch.no_grad():
            self._numbers += numbers
            self._adapt_rate(numbers[-1])
        nn.utils.clip_grad_norm_(self._actor_weights, _MOST_GRADIENT)
        nn.utils.clip_grad_norm_(self._critic_weights, _MOST_GRADIENT)
        self._optimizer.step()

    def _losses_of(self, samples: Samples, old_log_std: Tensor) -> tuple[Tensor, Tensor]:
        """Return the loss, and the numbers of :data:`_NUMBERS` without gradients."""
        kind, clip, narrow = samples.seen.device.type, self.settings.clip, self.settings.precision == "bfloat16"
        # The cache of converted weights would outlast the step that changes them, in a recording.
        with torch.autocast(kind, torch.bfloat16, enabled=narrow, cache_enabled=False):
            mean, value = self._actor.layers(samples.seen), self._critic.layers(samples.state).squeeze(1)
        mean, value, log_std = mean.float(), value.float(), self._log_std
        old = _log_density(samples.action, samples.mean, old_log_std)
        ratio = (_log_density(samples.action, mean, log_std) - old).exp()
        surrogates = -samples.advantage * ratio, -samples.advantage * ratio.clamp(1.0 - clip, 1.0 + clip)
        surrogate = torch.max(*surrogates).mean()
        error = (value - samples.returns).square()
        if self.settings.clip_value:
            near = samples.value + (value - samples.value).clamp(-clip, clip)
            error = torch.max(error, (near - samples.returns).square())
        error = error.mean()
        entropy = (log_std + 0.5 + _HALF_LOG_TWO_PI).sum()
        loss = surrogate + error - self.settings.entropy_weight * entropy
        with torch.no_grad():  # of two normal distributions
            scaled = ((samples.mean - mean).square() + (2.0 * old_log_std).exp()) * (-2.0 * log_std).exp()
            divergence = (log_std - old_log_std + 0.5 * scaled - 0.5).sum(1).mean()
        return loss, torch.stack((surrogate.detach(), error.detach(), entropy.detach(), divergence))

    def _adapt_rate(self, divergence: Tensor) -> None:
        rate, target = self._rate, self.settings.target_kl
        faster = (rate * _RATE_FACTOR).clamp(max=_MOST_RATE)
        slower = (rate / _RATE_FACTOR).clamp(min=_LEAST_RATE)
        near = (divergence < target / 2.0) & (divergence > 0.0)
        rate.copy_(torch.where(divergence > 2.0 * target, slower, torch.where(near, faster, rate)))

    def _take_in_statistics(self) -> None:
        for network, group, rows in (
            (self._actor, ACTOR, self._rollout.seen), (self._critic, self._critic_group, self._rollout.state)
        ):  # fmt: skip
            moments = self._moments[group]
            if network is self._actor or group != ACTOR:  # once, if both see the same
                moments.add(rows.flatten(0, 1))
            network.mean.copy_(moments.mean)
            network.std.copy_(moments.std)

    @contextlib.contextmanager
    def _matrix_products(self) -> Iterator[None]:
        """Let float32 products use tensor cores where the settings allow it."""
        before = torch.backends.cuda.matmul.allow_tf32
        torch.backends.cuda.matmul.allow_tf32 = before or self.settings.precision == "tf32"
        try:
            yield
        finally:
            torch.backends.cuda.matmul.allow_tf32 = before


def _log_density(action: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
    """Return the logarithm (B,) of the normal density."""
    return (-0.5 * ((action - mean) * (-log_std).exp()).square() - log_std - _HALF_LOG_TWO_PI).sum(1)
