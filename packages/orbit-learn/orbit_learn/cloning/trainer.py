"""Cloning of recorded demonstrations, judged by episodes that the policy plays."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import torch

from orbit_core.envs.environment import Environment
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_data.manifest.manifest import Manifest
from orbit_learn.cloning.corrections import gather_corrections
from orbit_learn.cloning.demonstrations import Demonstrations, joined, load_demonstrations
from orbit_learn.cloning.encoding import Encoding, encoding_for
from orbit_learn.cloning.networks import (
    ClonedDiffusion,
    ClonedNetwork,
    ClonedPerceptron,
    ClonedRecurrent,
    ClonedTransformer,
    Planner,
)
from orbit_learn.cloning.steps import GradientSteps
from orbit_learn.description import group_parts
from orbit_learn.distill import copied_actor
from orbit_learn.ends import EpisodeTally
from orbit_learn.memory import Remembering
from orbit_learn.networks import ActorNetwork
from orbit_learn.teacher import teacher_of
from orbit_learn.trainer import Progress, Trainer

_MODES = 5
# Added to the seed, for the episodes of corrections.
_CORRECTED = 10_000
# Added to the seed, for the episodes that a policy is judged by: by starts that no recording is likely to show.
_JUDGED = 20_000
ALGORITHMS = ("bc", "bc-gmm", "bc-rnn", "bc-rnn-gmm", "act", "diffusion")


@dataclass(frozen=True)
class ImitationSettings:
    """Cloning of demonstrations. The learning rate falls to zero along half a cosine (Loshchilov and Hutter, SGDR,
    2017)."""  # fmt: skip

    algorithm: str = "bc"
    """bc, bc-gmm (mixture of Gaussians), bc-rnn, bc-rnn-gmm, act (action chunking with transformers), diffusion."""
    dataset: tuple[str, ...] = ()
    """Paths of the demonstrations, one dataset or several of one kind."""
    teacher: str = ""
    """Who corrects the policy while it learns (DAgger): expert, the task's own, a kept policy, or a policy's file."""
    rounds: int = 4
    """With a teacher: how often the policy is corrected, each time in an episode of every environment."""
    iterations: int = 40
    """Iterations of ``updates_per_iteration`` gradient steps."""
    updates_per_iteration: int = 200
    """Gradient steps in an iteration."""
    batch_size: int = 0
    """Chunks in a gradient step; 0 for the algorithm's own: 64 for act, whose steps take long, and 256 for others."""
    learning_rate: float = 0.0
    """Step size of AdamW at the beginning; 0 for the algorithm's own: 3e-3 for bc and diffusion without pictures, else
    1e-3."""
    chunk: int = 16
    """Actions that are planned at a time."""
    executed: int = 8
    """Actions of a plan that are executed before the next one is made."""
    hidden_size: int = 256
    """Units of hidden layers; a transformer is a quarter as wide, a denoiser twice."""
    ensemble: float | None = None
    """For act: plan at every step and average plans for one moment with weights exp(-ensemble * age)."""
    only_successes: bool = False
    """Leave out episodes that failed; with noise on the actions they teach too."""
    evaluate_every: int = 10
    """Iterations between evaluations, each an episode in every environment; the last iteration is always evaluated."""
    device: str = ""
    """Torch device of the gradient steps, such as cuda; the environment's if left out."""
    recorded: bool = True
    """On a GPU, repeat gradient steps as one CUDA graph; false runs each of their operations from Python."""
    steps_per_iteration: int = 0
    """Environment steps of an iteration; demonstrations are recorded before."""

    def __post_init__(self) -> None:
        if self.algorithm not in ALGORITHMS:
            raise UnknownNameError("algorithm", self.algorithm, ALGORITHMS, "library imitation")
        if self.batch_size < 0:
            raise ConfigurationError(f"imitation setting 'batch_size' is at least 0, not {self.batch_size}")
        if not 0.0 <= self.learning_rate < math.inf:
            raise ConfigurationError(f"imitation setting 'learning_rate' is at least 0, not {self.learning_rate:g}")
        if self.ensemble is not None and self.algorithm != "act":
            raise ConfigurationError(
                f"imitation setting 'ensemble' averages plans of act, and not of {self.algorithm}: leave it out"
            )
        if self.rounds < 1:
            raise ConfigurationError(f"imitation setting 'rounds' is at least 1, not {self.rounds}")
        for name in ("updates_per_iteration", "hidden_size", "evaluate_every"):
            if not getattr(self, name) > 0:
                raise ConfigurationError(f"imitation setting '{name}' is positive, not {getattr(self, name)}")
        if not 0 < self.executed <= self.chunk:
            raise ConfigurationError(
                f"imitation setting 'executed' is 1 to chunk, which is {self.chunk}, not {self.executed}"
            )

    def first_learning_rate(self, pictures: bool) -> float:
        """Return the step size of AdamW at the beginning.

        Args:
            pictures: whether the policy sees pictures, whose convolutions need smaller steps than linear layers.
        """
        # Of bc on Lift, 8,000 updates end at a loss of 0.062 from 3e-3, of 0.083 from 1e-3; of diffusion, 1,600 updates
        # at errors of plans of 0.159 and 0.173. Others were not measured.
        return self.learning_rate or (3e-3 if self.algorithm in ("bc", "diffusion") and not pictures else 1e-3)

    @property
    def chunks_per_update(self) -> int:
        """Chunks in a gradient step."""
        return self.batch_size or (64 if self.algorithm == "act" else 256)


class ImitationTrainer(Trainer[ImitationSettings]):
    """Clones a dataset, and with a teacher has the policy corrected where it leads. The success that is reported is
    that of whole episodes which the policy played.

    Raises:
        ConfigurationError: there is neither dataset nor teacher, or one does not fit the environment.
    """

    name: ClassVar[str] = "imitation"
    settings_type: ClassVar[type[Any]] = ImitationSettings
    options: ClassVar[tuple[str, ...]] = ("imitation", "algorithm", "dataset", "teacher")

    def __init__(self, environment: Environment, settings: ImitationSettings, folder: Path | str, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        if not (settings.dataset or settings.teacher):
            raise ConfigurationError(
                "cloning needs demonstrations: give --dataset FILE ('orbit record' makes one), or --teacher expert"
            )
        torch.manual_seed(seed)
        layout = environment.observation["policy"]
        self._teacher = teacher_of(environment, settings.teacher) if settings.teacher else None
        loaded = [load_demonstrations(path, environment, settings.only_successes) for path in settings.dataset]
        if not loaded:
            assert self._teacher is not None
            loaded.append(gather_corrections(environment, self._teacher, None, seed))
        self._demonstrations = shown = joined(loaded)
        self._corrections: list[Demonstrations] = []
        """What was gathered in each round."""
        manifest = Manifest.of(environment, "", seed)
        encoding = encoding_for(manifest, "policy", group_parts(layout), layout.concatenated)
        self._network = _network(settings, encoding)
        planner = self._network.build(encoding.vector_size, environment.action_size)  # pyright: ignore
        assert isinstance(planner, Planner)
        # An even sample is enough for means and deviations, and fits into memory with any dataset.
        every = torch.arange(0, shown.steps, max(1, shown.steps // 65536))
        vectors = planner.encoder.vectors(shown.observed(every))
        planner.encoder.fit(vectors)
        planner.labels.fit(shown.windows(every, settings.chunk)[0], vectors)
        self._device = _device(settings.device) if settings.device else environment.device
        self._planner = planner.to(self._device)
        updates = settings.updates_per_iteration
        self._steps = GradientSteps(
            self._planner, settings.chunks_per_update, updates, settings.iterations * updates,
            settings.first_learning_rate(bool(encoding.pictures)), seed, settings.recorded,
        )  # fmt: skip
        self._steps.show(shown)
        self._iteration = 0
        self._loss = math.nan
        self._played = (math.nan, math.nan, 0)
        self._tally = EpisodeTally(environment.device)

    def learn(self, iterations: int, report: Callable[[Progress], None]) -> None:
        begin, first, env_steps = time.perf_counter(), self._iteration, 0
        last = first + iterations - 1
        for iteration in range(first, last + 1):
            if self._teacher is not None and iteration in self._rounds():
                env_steps += self._correct()
            self._loss = self._steps.run(iteration)
            self._iteration = iteration + 1
            if iteration == last or (iteration + 1) % self.settings.evaluate_every == 0:
                env_steps += self._evaluate()
            returns, success, episodes = self._played
            seconds = time.perf_counter() - begin
            progress = Progress(iteration, env_steps, seconds, returns, success, episodes)
            report(replace(progress, loss=self._loss, metrics=self._tally.metrics))

    def state(self) -> Any:
        # Corrections are of policies that are gone, so that another run could not gather them again.
        corrections = [(each.observation, each.actions, each.ends) for each in self._corrections]
        state = {"planner": self._planner.state_dict(), "optimizer": self._steps.state()}
        return {**state, "corrections": corrections}

    def restore(self, state: Any, iteration: int) -> None:
        self._planner.load_state_dict(state["planner"])
        self._corrections = [Demonstrations(*each) for each in state.get("corrections", ())]
        self._demonstrations = joined([self._demonstrations, *self._corrections])
        self._steps.show(self._demonstrations)
        self._steps.restore(state["optimizer"], iteration)
        self._iteration = iteration + 1

    def actor(self) -> ActorNetwork:
        return copied_actor(self._network, self._planner)  # pyright: ignore[reportArgumentType]

    def _rounds(self) -> set[int]:
        """Return the iterations that begin with a correction, spread evenly over the training."""
        count = self.settings.rounds
        return {self.settings.iterations * number // (count + 1) for number in range(1, count + 1)} - {0}

    def _correct(self) -> int:
        """Gather an episode of corrections in every environment; return the steps of all environments."""
        assert self._teacher is not None
        environment, number = self.environment, len(self._corrections)
        planner = copy.deepcopy(self._planner).to(environment.device).eval()
        # Other episodes in each round, and others than those that the policy is judged by.
        found = gather_corrections(environment, self._teacher, planner, self.seed + _CORRECTED + number)
        self._corrections.append(found)
        self._demonstrations = joined([self._demonstrations, found])
        self._steps.show(self._demonstrations)
        return environment.max_episode_steps * environment.num_envs

    def _evaluate(self) -> int:
        """Play an episode in every environment; return the steps of all environments."""
        environment = self.environment
        seen, _ = environment.reset(self.seed + _JUDGED)
        planner = copy.deepcopy(self._planner).to(environment.device)
        acting = Remembering(planner, environment.num_envs, environment.device)
        begun = torch.ones(environment.num_envs, dtype=torch.bool, device=environment.device)
        first = begun.clone()
        self._tally = EpisodeTally(environment.device)
        for _ in range(environment.max_episode_steps):
            action = acting.act(seen["policy"], begun)
            seen, _, terminated, truncated, info = environment.step(action)
            begun = terminated | truncated
            # An environment whose first episode ended early plays on uncounted.
            self._tally.add(info, environment.num_envs, first)
            first &= ~begun
        self._played = self._tally.read()
        return environment.max_episode_steps * environment.num_envs


def _device(name: str) -> torch.device:
    """Return a torch device that can hold a network.

    Raises:
        ConfigurationError: there is none of that name here.
    """
    try:
        return torch.zeros(0, device=name).device
    except (RuntimeError, AssertionError) as error:
        raise ConfigurationError(f"imitation setting 'device' is '{name}', which torch rejects: {error}") from None


def _network(settings: ImitationSettings, encoding: Encoding) -> ClonedNetwork:
    """Return the network of an algorithm.

    Raises:
        ConfigurationError: the algorithm has none of these sizes.
    """
    try:
        return _built(settings, encoding)
    except ValueError as error:
        raise ConfigurationError(
            f"imitation settings chunk={settings.chunk}, executed={settings.executed} and hidden_size="
            f"{settings.hidden_size} fit no network of {settings.algorithm}: {error}"
        ) from None


def _built(settings: ImitationSettings, encoding: Encoding) -> ClonedNetwork:
    shared: dict[str, Any] = {"encoding": encoding, "chunk": settings.chunk, "executed": settings.executed}
    modes = _MODES if settings.algorithm.endswith("gmm") else 1
    if settings.algorithm in ("bc", "bc-gmm"):
        return ClonedPerceptron(**shared, hidden_sizes=(settings.hidden_size,) * 2, modes=modes)
    if settings.algorithm in ("bc-rnn", "bc-rnn-gmm"):
        return ClonedRecurrent(**shared, hidden_size=settings.hidden_size, modes=modes)
    if settings.algorithm == "act":
        return ClonedTransformer(**shared, width=settings.hidden_size // 4, ensemble=settings.ensemble)
    return ClonedDiffusion(**shared, width=2 * settings.hidden_size)
