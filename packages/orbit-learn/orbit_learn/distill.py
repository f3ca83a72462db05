"""Distillation: a student learns from its own observations to act like a teacher that observes more."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from orbit_core.envs.environment import Environment
from orbit_core.envs.observation_layout import GroupLayout
from orbit_core.interfaces import ConfigurationError
from orbit_learn.description import group_parts
from orbit_learn.networks import ActorNetwork, Network, NormalizedActor, Perceptron, PictureActor, convolutional
from orbit_learn.processes import average, met
from orbit_learn.teacher import teacher_of
from orbit_learn.trainer import LoopTrainer, set_half_cosine


@dataclass(frozen=True)
class DistillSettings:
    """Settings of imitating a teacher in the states that the student reaches.

    Ross, Gordon and Bagnell, A Reduction of Imitation Learning and Structured Prediction to No-Regret Online Learning
    (2011), known as DAgger. The learning rate falls to zero along half a cosine: Loshchilov and Hutter, SGDR (2017).
    """

    teacher: str = ""
    """Name of a kept policy, a policy's file, a training's folder, or ``expert``, the task's own."""
    iterations: int = 1000
    """Number of iterations, each of collecting steps and learning from them."""
    steps_per_iteration: int = 16
    """Environment steps that every environment contributes to an iteration."""
    hidden_sizes: tuple[int, ...] = (256, 128)
    """Units of the hidden layers behind the encoders of pictures."""
    teacher_led: float = 0.2
    """Share of the training during which the teacher leads some episodes: all at first, then ever fewer."""
    buffer_size: int = 200_000
    """Number of steps kept to learn from; with two cameras of 64 x 64 pixels, 41 kB each on the device."""
    updates_per_iteration: int = 32
    """Number of steps of gradient descent."""
    batch_size: int = 2048
    """Number of kept steps that each of them uses."""
    learning_rate: float = 1e-3
    """Learning rate at first."""
    shift: int = 0
    """Limit in pixels of random shifts of pictures while learning: Yarats et al., Mastering Visual Continuous
    Control: Improved Data-Augmented Reinforcement Learning (2021)."""
    mixed_precision: bool = False
    """Whether to compute gradients in bfloat16 where precision allows it."""

    def __post_init__(self) -> None:
        for name in ("iterations", "steps_per_iteration", "buffer_size", "updates_per_iteration", "batch_size"):
            if getattr(self, name) < 1:
                raise ConfigurationError(f"{name} of a distillation is 1 or more, not {getattr(self, name)}")
        if not 0.0 <= self.teacher_led <= 1.0:
            raise ConfigurationError(f"teacher_led of a distillation is a share in [0, 1], not {self.teacher_led}")
        if not self.hidden_sizes or min(self.hidden_sizes) < 1:
            raise ConfigurationError(
                f"hidden_sizes of a distillation are {self.hidden_sizes}: give each layer 1 or more"
            )
        if self.shift < 0 or self.learning_rate <= 0.0:
            raise ConfigurationError("shift of a distillation is not negative, and its learning_rate above zero")


# Types in which pictures are kept: depth to within half a millimetre in a metre, colours as they are.
_SHORT = {torch.float32: torch.float16}


class ReplayBuffer:
    """Ring of the last steps of all environments; none of its methods waits for the device.

    Args:
        capacity: number of steps of one environment; rounded down to whole steps of all.
        observation: example (N, ...): one tensor or a dictionary of terms.
        action_size: components of an action.
    """

    def __init__(self, capacity: int, observation: Tensor | Mapping[str, Tensor], action_size: int) -> None:
        terms = {"": observation} if isinstance(observation, Tensor) else dict(observation)
        first = next(iter(terms.values()))
        self._count, self._device = len(first), first.device
        rows = max(1, capacity // self._count) * self._count
        self._terms = {
            name: torch.zeros((rows, *value.shape[1:]), dtype=_kept_dtype(value), device=self._device)
            for name, value in terms.items()
        }
        self._dtypes = {name: value.dtype for name, value in terms.items()}
        self._actions = torch.zeros(rows, action_size, device=self._device)
        self._rows, self._next, self.size = rows, 0, 0
        """Steps held so far, at most the capacity."""

    def add(self, observation: Tensor | Mapping[str, Tensor], action: Tensor) -> None:
        """Copy one step of all environments."""
        terms = {"": observation} if isinstance(observation, Tensor) else observation
        rows = slice(self._next, self._next + self._count)
        for name, kept in self._terms.items():
            kept[rows] = terms[name]  # converts to the shorter type on the way
        self._actions[rows] = action
        self._next = (self._next + self._count) % self._rows
        self.size = min(self.size + self._count, self._rows)

    def sample(self, count: int) -> tuple[Tensor | dict[str, Tensor], Tensor]:
        """Return observations (count, ...) and actions (count, A) of randomly chosen kept steps."""
        # With repetition, which costs no permutation of the whole buffer.
        rows = torch.randint(self.size, (count,), device=self._device)
        terms = {name: kept[rows].to(self._dtypes[name]) for name, kept in self._terms.items()}
        return terms.get("", terms), self._actions[rows]


def _kept_dtype(value: Tensor) -> torch.dtype:
    return _SHORT.get(value.dtype, value.dtype) if value.dim() == 4 else value.dtype


# Added to standard deviations, so that components that never change in training do not become huge afterwards.
_LEAST_STD = 1e-2


def network_for(layout: GroupLayout, hidden_sizes: Sequence[int]) -> Network:
    """Return a perceptron for a concatenated group; for a dictionary with pictures, convolutions before it.

    Raises:
        ConfigurationError: the dictionary has pictures that are neither colour nor depth, or no pictures.
    """
    if layout.concatenated:
        return Perceptron(tuple(hidden_sizes))
    return convolutional(group_parts(layout), hidden_sizes)


def build_actor(network: Network, layout: GroupLayout, action_size: int) -> PictureActor | NormalizedActor:
    """Return the module of :func:`network_for`."""
    module = network.build(layout.size if layout.concatenated else 0, action_size)
    assert isinstance(module, PictureActor | NormalizedActor)
    return module


def copied_actor(network: Network, module: nn.Module) -> ActorNetwork:
    """Return a copy on the CPU without gradients."""
    copied = copy.deepcopy(module).cpu().to(memory_format=torch.contiguous_format)  # pyright: ignore[reportCallIssue]
    return ActorNetwork(network, copied.requires_grad_(False).eval())


class RunningMoments:
    """Mean and standard deviation of all rows so far, with equal weights.

    Chan, Golub and LeVeque, Updating Formulae and a Pairwise Algorithm for Computing Sample Variances (1979).
    """

    def __init__(self, size: int, device: torch.device) -> None:
        self.count = torch.zeros((), device=device)
        """() number of rows so far."""
        self.mean = torch.zeros(size, device=device)
        """(size,) of all rows so far."""
        # Sum (size,) of squared deviations from the mean.
        self._squares = torch.zeros(size, device=device)

    def add(self, rows: Tensor) -> None:
        """Add rows (M, size), and those of the other processes that learn the same policy, as many each."""
        mean = rows.mean(0)
        average([mean])
        squares = ((rows - mean) ** 2).sum(0)
        average([squares])
        count = len(rows) * met()
        total, change = self.count + count, mean - self.mean
        # Pairwise, so that the sum of squares keeps its precision over millions of rows.
        self._squares += squares * met() + change**2 * self.count * count / total
        self.mean += change * count / total
        self.count += count

    @property
    def std(self) -> Tensor:
        """Standard deviations (size,), never zero."""
        return (self._squares / self.count.clamp(min=1.0)).sqrt() + _LEAST_STD

    def state(self) -> dict[str, Tensor]:
        """Return the statistics, for a checkpoint."""
        return {"count": self.count, "mean": self.mean, "squares": self._squares}

    def load(self, state: dict[str, Tensor]) -> None:
        """Restore the result of :meth:`state`."""
        self.count.copy_(state["count"])
        self.mean.copy_(state["mean"])
        self._squares.copy_(state["squares"])


_MOST_GRADIENT = 0.1
# Error of an action beyond which the loss grows linearly instead of quadratically: Huber, Robust Estimation of a
# Location Parameter (1964).
_OUTLIER = 0.5


class DistillTrainer(LoopTrainer[DistillSettings]):
    """Trainer in which a teacher labels every step, and student and teacher lead whole episodes, by chance.

    The reported success is that of the episodes which the student led. Kept steps are not part of checkpoints, because
    they take gigabytes: a training that begins or resumes first gathers the steps of one episode.

    Raises:
        ConfigurationError: no teacher is given, no observation group fits it, or episodes begin on the way of the
            expert that teaches.
    """

    name: ClassVar[str] = "distill"
    several_engines: ClassVar[bool] = True
    settings_type: ClassVar[type[Any]] = DistillSettings
    options: ClassVar[tuple[str, ...]] = ("distillation", "teacher")

    def __init__(self, environment: Environment, settings: DistillSettings, folder: Path | str, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        if not settings.teacher:
            raise ConfigurationError(
                "a distillation needs a teacher: name a kept policy ('orbit list policies'), a policy's file, or expert"
            )
        device, layout = environment.device, environment.observation["policy"]
        self._wanted = teacher_of(environment, settings.teacher)
        self._network = network_for(layout, settings.hidden_sizes)
        self._student = build_actor(self._network, layout, environment.action_size)
        self._student.to(device).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        # Separate from the student's buffers, which change only between iterations, so that collecting is consistent.
        self._moments = RunningMoments(len(self._student.mean), device)
        self._optimizer = torch.optim.Adam(self._student.parameters(), lr=settings.learning_rate)
        self._seen, _ = environment.reset(seed)
        # If all episodes began together, the buffer would contain one time of the episode after the other.
        environment.spread_episodes()
        self._buffer = ReplayBuffer(settings.buffer_size, self._seen["policy"], environment.action_size)
        # Whether (N,) the student leads each environment's episode.
        self._student_leads = torch.zeros(environment.num_envs, dtype=torch.bool, device=device)
        # Leaders are drawn for whole episodes, so that the success of those that the student led can be measured.
        self._draw_leaders(torch.ones_like(self._student_leads), 0)
        self._loss = torch.zeros((), device=device)

    def iterate(self, iteration: int) -> None:
        # One whole episode, so that the first batches contain all times of it.
        ahead = 0 if self._buffer.size else self.environment.max_episode_steps
        self.steps_ahead += ahead * self.environment.num_envs
        with torch.no_grad():
            for _ in range(ahead + self.settings.steps_per_iteration):
                self._collect(iteration)
        self._student.mean.copy_(self._moments.mean)
        self._student.std.copy_(self._moments.std)
        set_half_cosine(self._optimizer, self.settings.learning_rate, iteration / self.settings.iterations)
        # Summed on the device: reading each loss would wait for it.
        self._loss.zero_()
        for _ in range(self.settings.updates_per_iteration):
            self._update()

    def loss(self) -> float:
        return float(self._loss) / self.settings.updates_per_iteration

    def state(self) -> Any:
        """Return weights, the optimiser's state and the observations' statistics."""
        return {
            "student": self._student.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "moments": self._moments.state(),
        }

    def load(self, state: Any) -> None:
        self._student.load_state_dict(state["student"])
        self._optimizer.load_state_dict(state["optimizer"])
        self._moments.load(state["moments"])

    def actor(self) -> ActorNetwork:
        return copied_actor(self._network, self._student)

    def _collect(self, iteration: int) -> None:
        """Take one step of all environments, and keep it with the teacher's actions."""
        environment, seen = self.environment, self._seen["policy"]
        wanted = self._wanted(self._seen)
        done = self._student(seen)
        # The teacher's action is kept in every state, also where the student leads: that is the idea of DAgger.
        self._buffer.add(seen, wanted)
        self._moments.add(self._student.vectors(seen))  # pyright: ignore[reportArgumentType] - as its group gives it
        action = torch.where(self._student_leads[:, None], done, wanted)
        self._seen, _, terminated, truncated, info = environment.step(action)
        self.tally.add(info, environment.num_envs, self._student_leads)
        self._draw_leaders(terminated | truncated, iteration)

    def _draw_leaders(self, began: Tensor, iteration: int) -> None:
        """Draw who leads, in the environments (N,) whose episodes ``began``."""
        while_led = self.settings.teacher_led * self.settings.iterations
        share = max(0.0, 1.0 - iteration / while_led) if while_led else 0.0
        drawn = torch.rand(len(began), device=began.device) >= share
        self._student_leads = torch.where(began, drawn, self._student_leads)

    def _update(self) -> None:
        observation, wanted = self._buffer.sample(self.settings.batch_size)
        if self.settings.shift and isinstance(observation, dict):
            observation = _shifted(observation, self.settings.shift)
        kind = self.environment.device.type
        with torch.autocast(kind, torch.bfloat16, enabled=self.settings.mixed_precision):
            # Before clipping: the gradient of a clipped action outside of [-1, 1] would be zero.
            done = self._student.unclipped(observation)  # pyright: ignore[reportArgumentType] - as its group gives it
        loss = F.smooth_l1_loss(done.float(), wanted, beta=_OUTLIER)  # a few strange states must not lead the others
        self._optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self._student.parameters(), _MOST_GRADIENT)
        self._optimizer.step()
        self._loss += loss.detach()


def _shifted(observation: Mapping[str, Tensor], most: int) -> dict[str, Tensor]:
    """Shift pictures by up to ``most`` pixels each way, with repeated borders; those of one step alike."""
    first = next(iter(observation.values()))
    # One shift for all cameras of a step, so that they still show one scene.
    shifts = torch.randint(-most, most + 1, (2, len(first), 1), device=first.device)
    return {name: _shift(value, shifts) if value.dim() == 4 else value for name, value in observation.items()}


def _shift(pictures: Tensor, shifts: Tensor) -> Tensor:
    """Move pictures (N, H, W, C) by ``shifts`` (2, N, 1) rows and columns."""
    rows, columns = (
        (torch.arange(extent, device=pictures.device) + shift).clamp(0, extent - 1)
        for extent, shift in zip(pictures.shape[1:3], shifts, strict=True)
    )
    each = torch.arange(len(pictures), device=pictures.device)[:, None, None]
    return pictures[each, rows[:, :, None], columns[:, None, :]]
