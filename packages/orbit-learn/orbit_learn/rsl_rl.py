"""RSL-RL: Schwarke et al., RSL-RL: A Learning Library for Robotics Research (2025)."""

from __future__ import annotations

import contextlib
import io
import math
import os
import statistics
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar, cast

os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")  # its logger imports git, which need not be there

import torch
from rsl_rl.env import VecEnv
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict
from torch import Tensor, nn

from orbit_core.envs.environment import Environment, Observation
from orbit_core.envs.observation_layout import POLICY, GroupLayout, one_tensor
from orbit_core.envs.ppo import PpoSettings
from orbit_core.interfaces import ConfigurationError
from orbit_learn.description import group_parts
from orbit_learn.networks import (
    MOST_DEVIATIONS,
    ActorNetwork,
    Convolutional,
    NormalizedActor,
    Perceptron,
    convolutional,
    convolutional_actor,
    encoded_pictures,
    joined_vectors,
    perceptron_actor,
)
from orbit_learn.policy import Policy, load_policy
from orbit_learn.pretrained import policy_path
from orbit_learn.processes import meet, met, rank
from orbit_learn.spaces import ACTOR, check_groups, critic_group, tensor_names, tensors_by_name
from orbit_learn.trainer import Progress, Trainer

# Parts of RSL-RL's models: one that sees a dictionary of terms, pictures among them, as ORBIT's own network does, and
# statistics of observations that go on from those of a policy.


class PictureModel(MLPModel):
    """RSL-RL's model of linear layers, behind the encoders of a network ``convolutional``.

    RSL-RL's own CNNModel takes one floating-point picture a camera, channels first; this one keeps colours as uint8
    until it sees them, so that the steps that are remembered take a fourth of the memory.

    Args:
        obs: an example.
        obs_groups: names of the tensors of each set, ``<group>/<term>``.
        obs_set: "actor" or "critic".
        output_dim: components of the output.
        network: of the group's terms.
        settings: of the linear layers, as RSL-RL has them.
    """

    def __init__(
        self,
        obs: TensorDict,
        obs_groups: dict[str, list[str]],
        obs_set: str,
        output_dim: int,
        network: Convolutional,
        **settings: Any,
    ) -> None:
        self.network: Convolutional
        object.__setattr__(self, "network", network)  # which the base class asks for before it is a module
        self._prefix = obs_groups[obs_set][0].partition("/")[0] + "/"
        super().__init__(obs, obs_groups, obs_set, output_dim, **settings)
        self.encoders = network.build_encoders()
        """Convolutions of each set of pictures."""

    def get_latent(self, obs: TensorDict, masks: Tensor | None = None, hidden_state: Any = None) -> Tensor:
        terms = self._terms(obs)
        vectors = self.obs_normalizer(joined_vectors(self.network, terms)).clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS)
        return torch.cat((vectors, encoded_pictures(self.network, self.encoders, terms)), dim=-1)

    def update_normalization(self, obs: TensorDict) -> None:
        if self.obs_normalization:
            self.obs_normalizer.update(joined_vectors(self.network, self._terms(obs)))  # pyright: ignore[reportCallIssue]

    def _terms(self, obs: TensorDict) -> dict[str, Tensor]:
        return {name: obs[self._prefix + name] for name in self._names}

    @property
    def _names(self) -> list[str]:
        pictures = [picture.term for encoder in self.network.encoders for picture in encoder.pictures]
        return [*pictures, *(part.name for part in self.network.vectors)]

    def _get_obs_dim(self, obs: TensorDict, obs_groups: dict[str, list[str]], obs_set: str) -> tuple[list[str], int]:
        return obs_groups[obs_set], self.network.vector_size

    def _get_latent_dim(self) -> int:
        return self.obs_dim + self.network.features


class PartlyKnown(EmpiricalNormalization):
    """Statistics of observations of which some stay, for a policy's layers were learned with them.

    Others, of what the policy did not see, follow from what is shown from now on.

    Args:
        mean: (size,) at first.
        std: (size,) at first, with ``eps`` in it.
        known: components that stay as they are.
        weight: how many observations those at first count for.
    """

    count: Tensor
    """() observations so far, those at first included."""
    _mean: Tensor
    _var: Tensor
    _std: Tensor

    def __init__(self, mean: Tensor, std: Tensor, known: Sequence[int], weight: int) -> None:
        super().__init__(len(mean))
        self.count.fill_(weight)
        self._known = list(known)
        self._mean.copy_(mean)
        self._std.copy_((std - self.eps).clamp_min(0.0))
        self._var.copy_(self._std.square())

    def update(self, x: Tensor) -> None:
        known = self._mean[:, self._known], self._var[:, self._known], self._std[:, self._known]
        super().update(x)
        self._mean[:, self._known], self._var[:, self._known], self._std[:, self._known] = known


# A learned policy as the start of a training in an environment that shows more than it saw, such as a walker's on
# terrain that it now sees.

LAST_ACTION = "last_action"
# At first, of what the environment shows now and the policy did not see: robots that begin on level ground see the
# same everywhere, and will see more than that.
_LEAST_STD = 0.2


def started_from(policy: Policy, environment: Environment) -> ActorNetwork:
    """Return a network that acts in the environment as the policy acts, and may learn from further observations.

    Terms of the observation are matched by their names. What is new weighs nothing, and is normalised by what the
    environment shows now, on which a training that goes on improves. Where joints' targets are
    ``offset + scale * command``, commands are of the environment's own scale, and so is the last action among what is
    seen.

    Raises:
        ConfigurationError: the policy was learned for another robot, action or rate; it saw what the environment does
            not show, or something other than one tensor; or its network is no perceptron.
    """
    description, layout, module = policy.description, environment.observation[POLICY], policy.module
    if not isinstance(policy.network, Perceptron) or not isinstance(module, NormalizedActor) or not layout.concatenated:
        raise ConfigurationError("a training begins with a policy whose network is a perceptron that sees one tensor")
    if policy.network.squashed:
        raise ConfigurationError(
            "a training by PPO clips its actions, and begins with no policy of SAC or TD3, whose actions tanh bounds"
        )
    description.check_action(environment)
    columns = columns_seen(policy, layout)
    shown = one_tensor(environment.observe(), POLICY)
    mean, std = shown.mean(0).cpu(), shown.std(0, unbiased=False).clamp_min(_LEAST_STD).cpu()
    mean[columns], std[columns] = module.mean.cpu(), module.std.cpu()
    ratio, shift = _rescaled(policy, environment)
    if LAST_ACTION in layout.columns:
        last = layout.columns[LAST_ACTION]
        mean[last], std[last] = mean[last] * ratio + shift, std[last] * ratio
    weights = {name: value.detach().cpu().clone() for name, value in module.state_dict().items()}
    first = torch.zeros(len(weights["layers.0.weight"]), layout.size)
    first[:, columns] = weights["layers.0.weight"]
    end = f"layers.{2 * len(policy.network.hidden_sizes)}"
    weights[f"{end}.weight"] *= ratio[:, None]
    weights[f"{end}.bias"] = weights[f"{end}.bias"] * ratio + shift
    started = policy.network.build(layout.size, description.action_size)
    started.load_state_dict({**weights, "layers.0.weight": first, "mean": mean, "std": std})
    return ActorNetwork(policy.network, started.requires_grad_(False).eval())


def columns_seen(policy: Policy, layout: GroupLayout) -> list[int]:
    """Return the columns at which the environment shows the components that the policy saw, in their order.

    Raises:
        ConfigurationError: the policy saw what the environment does not show.
    """
    columns: list[int] = []
    for part in policy.description.observation_parts:
        found = layout.columns.get(part.name)
        if found is None or found.stop - found.start != part.size:
            raise ConfigurationError(f"the policy to begin with saw {part}, which the environment does not show so")
        columns += range(found.start, found.stop)
    return columns


def _rescaled(policy: Policy, environment: Environment) -> tuple[Tensor, Tensor]:
    """Ratio (A,) and shift (A,) that turn the policy's command into one by which the environment does the same."""
    ratio, shift = torch.ones(policy.description.action_size), torch.zeros(policy.description.action_size)
    if policy.manifest is None:
        return ratio, shift
    begin = 0
    for part, generator in zip(policy.description.action_parts, environment.actions.generators, strict=True):
        place = slice(begin, begin + part.size)
        begin += part.size
        learned = policy.manifest.action_terms.get(part.name)
        if learned is None or learned.scale is None or learned.offset is None or generator.affine is None:
            continue
        offset, scale = (value.cpu() for value in generator.affine)
        ratio[place] = torch.tensor(learned.scale) / scale
        shift[place] = (torch.tensor(learned.offset) - offset) / scale
    return ratio, shift


# A policy's first steps after the task's expert, before it learns by itself -------------------------------------------
# Why: Rajeswaran et al., Learning Complex Dexterous Manipulation with Deep Reinforcement Learning and Demonstrations
# (2018), where imitation comes first and a policy gradient after.

# Moments in a gradient step.
_BATCH = 4096


def imitate_expert(environment: Environment, network: nn.Module, normalizer: nn.Module, settings: PpoSettings) -> float:
    """Fit what the network does to what the expert did where episodes begin on its way (:class:`ExpertStarts`).

    A last action among what the policy sees is taken from other moments: an expert mostly does what it did before, and
    who learns that from it never begins anything, such as to close a gripper (de Haan et al., Causal Confusion in
    Imitation Learning, 2019).

    Args:
        environment: whose expert it is.
        network: from normalised observations (K, O) to the means of actions (K, A).
        normalizer: of observations; takes those on the expert's way into its statistics.
        settings: number of gradient steps, and the learning rate.

    Returns:
        the mean squared error of the last gradient step.

    Raises:
        ConfigurationError: no episodes begin on the expert's way, or the policy sees more than one tensor.
    """
    starts = environment.starts
    if starts is None or not starts.seen.numel():
        raise ConfigurationError(
            f"imitation_steps={settings.imitation_steps} needs what an expert saw and did: set expert_starts of the "
            "task above zero, and let the policy see one tensor, or set imitation_steps=0"
        )
    seen, done = starts.seen, starts.done
    last = environment.observation[POLICY].columns.get("last_action")
    if settings.normalize_observations:
        normalizer.update(seen)  # pyright: ignore[reportCallIssue]
    optimizer = torch.optim.Adam(network.parameters(), settings.learning_rate)
    generator = torch.Generator(seen.device).manual_seed(0)
    loss = torch.zeros((), device=seen.device)
    for _ in range(settings.imitation_steps):
        rows = torch.randint(len(seen), (min(_BATCH, len(seen)),), generator=generator, device=seen.device)
        shown = seen[rows]
        if last is not None:
            shown[:, last] = shown[:, last].roll(1, 0)  # rows are drawn at random
        loss = (network(normalizer(shown)) - done[rows]).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return float(loss.detach())


MOST_STD = 1.0
"""Most that the deviation of actions grows to, where it does not begin wider."""

# Iterations that what the environment showed at first counts for in the statistics of what a policy to begin with had
# not seen.
_START_WEIGHT = 5


class RslRlEnvironment(VecEnv):
    """An environment as RSL-RL expects it. ``extras`` marks time-outs, for bootstrapping."""

    def __init__(self, environment: Environment, seed: int | None = None) -> None:
        self.environment = environment
        """ORBIT's environment behind the interface."""
        self.num_envs = environment.num_envs
        """Number N of environments."""
        self.num_actions = environment.action_size
        """Components A of an action."""
        self.max_episode_length = environment.max_episode_steps
        """Steps until the time limit."""
        self.device = environment.device
        """Device of all tensors."""
        self.cfg = {"task": type(environment.task).__name__}
        """Name of the task, for RSL-RL's loggers."""
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
                # Those that began on the expert's way say little about the progress of learning.
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
    """Runner that leaves checkpoints to the training, and whose processes may learn on CPUs."""

    def _configure_multi_gpu(self) -> None:
        meet(torch.device(self.device))
        self.gpu_world_size, self.is_distributed = met(), met() > 1
        self.gpu_global_rank, self.gpu_local_rank = rank(), int(os.environ.get("LOCAL_RANK", "0"))
        places = {"global_rank": self.gpu_global_rank, "local_rank": self.gpu_local_rank, "world_size": met()}
        self.cfg["multi_gpu"] = places if self.is_distributed else None

    def save(self, path: str, infos: dict[str, Any] | None = None) -> None:
        """No-op: checkpoints are written by the training."""


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
        "check_for_nan": False,  # it would wait for the device at every step; the engine reports divergence
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
            "use_clipped_value_loss": settings.clip_value,
            "optimizer": "adam",
            "rnd_cfg": None,
            "symmetry_cfg": None,
        },
    }
