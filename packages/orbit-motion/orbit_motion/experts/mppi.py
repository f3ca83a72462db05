"""Model-predictive path integral control: a policy that samples actions in copies of the world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.envs.captured_step import remembered
from orbit_core.envs.environment import Environment
from orbit_core.interfaces import ConfigurationError, Node, Port


@dataclass(frozen=True, kw_only=True)
class MppiConfig:
    """Sampling of actions and weighting of their returns."""

    horizon: int = 20
    """Environment steps of each sample."""
    noise: float = 0.5
    """Standard deviation of the samples' actions from the plan, in units of action."""
    correlation: float = 0.7
    """Correlation of the noise between one step and the next; 0 is white."""
    temperature: float = 0.1
    """Temperature in standard deviations of the samples' returns: the lower, the more the best ones count."""
    discount: float = 1.0
    """Factor of a reward per step of delay."""
    seed: int = 0
    """Seed of the noise."""


class Mppi(Node):
    """Node that chooses each environment's next action by rolling samples out in a second environment of the same task.

    The plan U of ``horizon`` actions becomes ``sum_s w_s A_s`` over sampled action sequences A_s, with weights ``w_s``
    proportional to ``exp(R_s / lambda)`` of their returns R_s (Williams et al., Information Theoretic MPC for
    Model-Based Reinforcement Learning, ICRA 2017; the noise's own cost is left out). Its first action is taken, and the
    plan shifted by one step. One sample is the plan itself. After an episode's end a sample earns nothing more.

    Args:
        environment: that acts, N environments.
        model: another environment of the same task, on any backend and device: N times as many environments as samples
            are wanted. The environments are the samples' of the first environment, then of the next. Its state
            begins with :meth:`orbit_core.interfaces.World.copy_state`, and with the task's own tensors.
        config: how to sample.

    Raises:
        ConfigurationError: the model is of another task or action space, or its size is no multiple of N.
    """

    def __init__(self, environment: Environment, model: Environment, config: MppiConfig = MppiConfig()) -> None:
        if type(model.task) is not type(environment.task) or model.action_size != environment.action_size:
            raise ConfigurationError(
                f"the model is of task {type(model.task).__name__} with {model.action_size} components of action, the "
                f"environment of {type(environment.task).__name__} with {environment.action_size}: make both alike"
            )
        self.samples, rest = divmod(model.num_envs, environment.num_envs)
        """Samples for each environment."""
        if model is environment or rest or self.samples < 2:
            raise ConfigurationError(
                f"a model of {model.num_envs} environments gives {environment.num_envs} no equal number of samples: "
                "make it with two or more for each"
            )
        if not (
            config.horizon >= 1 and config.noise > 0.0 and config.temperature > 0.0 and 0 <= config.correlation < 1
        ):
            raise ConfigurationError(f"{config}: horizon, noise and temperature are above zero, correlation in [0, 1)")
        self.name = "policy"
        self.outputs = (Port("action", (environment.action_size,)),)
        self.config = config
        self._environment, self._model = environment, model
        self._plan = torch.zeros(environment.num_envs, config.horizon, environment.action_size, device=model.device)
        self._random = torch.Generator(model.device).manual_seed(config.seed)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        """Plan, and return the first action (N, A)."""
        # A new episode begins without a plan.
        write_rows(self._plan, 0.0, (self._environment.state.episode_step == 0).to(self._plan.device))
        actions = (self._plan.unsqueeze(1) + self._noise()).clamp(-1.0, 1.0)
        returns = self._returns(actions)
        # Relative to the spread of returns, one temperature suits tasks of any scale of reward.
        spread = returns.std(1, keepdim=True).clamp_min(1e-6)
        weights = torch.softmax((returns - returns.amax(1, keepdim=True)) / (self.config.temperature * spread), 1)
        plan = torch.einsum("ns,nsha->nha", weights, actions)
        action = plan[:, 0].clone()
        self._plan.copy_(torch.cat((plan[:, 1:], plan[:, -1:]), 1))
        return {"action": action.to(self._environment.device)}

    def reset(self, env_ids: Tensor | None = None) -> None:
        write_rows(self._plan, 0.0, env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return {"plan": self._plan}

    def _noise(self) -> Tensor:
        """Sample correlated noise (N, samples, horizon, A), zero in the first sample."""
        count, horizon, size = self._plan.shape
        shape = (horizon, count, self.samples, size)
        white = self.config.noise * torch.randn(shape, generator=self._random, device=self._plan.device)
        share = self.config.correlation
        steps = [white[0]]
        for drawn in white[1:]:
            # The factor keeps the variance the same at all steps.
            steps.append(share * steps[-1] + (1.0 - share**2) ** 0.5 * drawn)
        noise = torch.stack(steps, 2)
        noise[:, 0] = 0.0
        return noise

    def _returns(self, actions: Tensor) -> Tensor:
        """Compute returns (N, samples) of action sequences (N, samples, horizon, A), from the present state."""
        model, count = self._model, self._environment.num_envs
        self._begin()
        total = torch.zeros(count * self.samples, device=model.device)
        running, weight = torch.ones_like(total), 1.0
        for action in actions.flatten(0, 1).unbind(1):
            _, reward, terminated, truncated, _ = model.step(action)
            total = total + weight * running * reward
            # After an episode's end a sample earns nothing: the model has reset itself.
            running = running * (~(terminated | truncated)).to(total.dtype)
            weight *= self.config.discount
        return total.view(count, self.samples)

    def _begin(self) -> None:
        """Copy the environment's state into its samples."""
        environment, model, samples = self._environment, self._model, self.samples
        for env in range(environment.num_envs):
            rows = torch.arange(env * samples, (env + 1) * samples, device=model.device)
            model.world.copy_state(env, rows, environment.world)
        own = remembered(environment)
        for name, tensor in remembered(model).items():
            given = own.get(name)
            if (
                given is not None
                and given.dim()
                and len(given) == environment.num_envs
                and len(tensor) == model.num_envs
            ):
                tensor.copy_(given.to(tensor.device).repeat_interleave(samples, 0))
