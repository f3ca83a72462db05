"""Distillation: a student learns to do, from what it sees, what a teacher does that sees more."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor

from orbit_core.envs.actors import Teacher
from orbit_core.envs.environment import Environment, Observation
from orbit_core.interfaces import ConfigurationError
from orbit_learn.distill_settings import DistillSettings
from orbit_learn.loop import LoopTrainer
from orbit_learn.networks import ActorNetwork
from orbit_learn.policy import load_policy
from orbit_learn.pretrained import policy_path
from orbit_learn.replay_buffer import ReplayBuffer
from orbit_learn.student import RunningMoments, build_actor, copied_actor, network_for

EXPERT = "expert"
"""Name of the teacher that is the task's own expert."""
_MOST_GRADIENT = 0.1
_OUTLIER = 0.5
"""Errors of an action beyond which the loss grows no longer as their square: Huber, Robust Estimation of a Location
Parameter (1964)."""


class DistillTrainer(LoopTrainer[DistillSettings]):
    """The teacher tells what it would do at every step; student and teacher lead whole episodes, by chance.

    The success that is reported is that of the episodes which the student led. The steps that are remembered are no
    part of checkpoints, for they fill gigabytes: before it learns, a training that begins or resumes gathers the steps
    of one episode.

    Raises:
        ConfigurationError: there is no teacher, no observation group shows what it was learned with, or episodes begin
            on the way of the expert that teaches.
    """

    name: ClassVar[str] = "distill"
    settings_type: ClassVar[type[Any]] = DistillSettings

    def __init__(self, environment: Environment, settings: DistillSettings, folder: Path | str, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        if not settings.teacher:
            raise ConfigurationError(
                "a distillation needs a teacher: name a kept policy ('orbit list policies'), a policy's file, or expert"
            )
        device, layout = environment.device, environment.observation["policy"]
        self._wanted = _teacher_of(environment, settings.teacher)
        self._network = network_for(layout, settings.hidden_sizes)
        self._student = build_actor(self._network, layout, environment.action_size)
        self._student.to(device).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self._moments = RunningMoments(len(self._student.mean), device)
        self._optimizer = torch.optim.Adam(self._student.parameters(), lr=settings.learning_rate)
        self._seen, _ = environment.reset(seed)
        # Episodes that all began together would fill the memory with one time of the episode after another.
        environment.task.episode_step.random_(environment.max_episode_steps)
        self._buffer = ReplayBuffer(settings.buffer_size, self._seen["policy"], environment.action_size)
        self._student_leads = torch.zeros(environment.num_envs, dtype=torch.bool, device=device)
        """(N,) whose episode the student leads."""
        self._draw_leaders(torch.ones_like(self._student_leads), 0)
        self._loss = torch.zeros((), device=device)

    def iterate(self, iteration: int) -> None:
        ahead = 0 if self._buffer.size else self.environment.max_episode_steps
        self.steps_ahead += ahead * self.environment.num_envs
        with torch.no_grad():
            for _ in range(ahead + self.settings.steps_per_iteration):
                self._collect(iteration)
        self._student.mean.copy_(self._moments.mean)
        self._student.std.copy_(self._moments.std)
        progress = iteration / self.settings.iterations
        for group in self._optimizer.param_groups:
            group["lr"] = self.settings.learning_rate * 0.5 * (1.0 + math.cos(math.pi * min(1.0, progress)))
        self._loss.zero_()
        for _ in range(self.settings.updates_per_iteration):
            self._update()

    def loss(self) -> float:
        return float(self._loss) / self.settings.updates_per_iteration

    def state(self) -> Any:
        """Weights, the optimiser and the statistics of what was seen."""
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
        """One step of all environments."""
        environment, seen = self.environment, self._seen["policy"]
        wanted = self._wanted(self._seen)
        done = self._student(seen)
        self._buffer.add(seen, wanted)
        self._moments.add(self._student.vectors(seen))  # pyright: ignore[reportArgumentType] - as its group gives it
        action = torch.where(self._student_leads[:, None], done, wanted)
        self._seen, _, terminated, truncated, info = environment.step(action)
        self.tally.add(info, environment.num_envs, self._student_leads)
        self._draw_leaders(terminated | truncated, iteration)

    def _draw_leaders(self, began: Tensor, iteration: int) -> None:
        """Draw who leads, in the environments whose episodes began (N,) bool."""
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
            # Before clipping, so that what lies outside of [-1, 1] is drawn back.
            done = self._student.unclipped(observation)  # pyright: ignore[reportArgumentType] - as its group gives it
        loss = F.smooth_l1_loss(done.float(), wanted, beta=_OUTLIER)  # a few strange states must not lead the others
        self._optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self._student.parameters(), _MOST_GRADIENT)
        self._optimizer.step()
        self._loss += loss.detach()


def _teacher_of(environment: Environment, name: str) -> Callable[[Observation], Tensor]:
    """From what is shown to the actions (N, A) of the task's expert, or of the policy of that name."""
    if name == EXPERT:
        if environment.starts is not None:
            raise ConfigurationError(
                "an expert begins each episode with its first phase, also one that begins on its way: to let it teach, "
                "set expert_starts=0"
            )
        expert = environment.task.expert(environment.world)
        if isinstance(expert, Teacher):
            expert.teaches = True
        return lambda seen: expert.compute({})["action"]
    teacher = load_policy(policy_path(name), environment.device)
    group = teacher.description.find_group(environment)
    return lambda seen: teacher.module(seen[group])


def _shifted(observation: Mapping[str, Tensor], most: int) -> dict[str, Tensor]:
    """Pictures shifted by up to ``most`` pixels each way, their borders repeated; those of one step all alike."""
    first = next(iter(observation.values()))
    shifts = torch.randint(-most, most + 1, (2, len(first), 1), device=first.device)
    return {name: _shift(value, shifts) if value.dim() == 4 else value for name, value in observation.items()}


def _shift(pictures: Tensor, shifts: Tensor) -> Tensor:
    """Pictures (N, H, W, C) moved by ``shifts`` (2, N, 1) rows and columns."""
    rows, columns = (
        (torch.arange(extent, device=pictures.device) + shift).clamp(0, extent - 1)
        for extent, shift in zip(pictures.shape[1:3], shifts, strict=True)
    )
    each = torch.arange(len(pictures), device=pictures.device)[:, None, None]
    return pictures[each, rows[:, :, None], columns[:, None, :]]
