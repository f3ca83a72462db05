"""Corrections of a policy: it leads until a random step of an episode, then a teacher leads on and is learned from."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.envs.environment import Observation
from orbit_core.envs.observation_layout import POLICY
from orbit_learn.cloning.demonstrations import Demonstrations
from orbit_learn.memory import Remembering, Seen, map_seen

if TYPE_CHECKING:
    from torch import nn

    from orbit_core.envs.environment import Environment


def gather_corrections(
    environment: Environment, teacher: Callable[[Observation], Tensor], student: nn.Module | None, seed: int
) -> Demonstrations:
    """Run an episode in every environment, and return what the teacher did in the states that the student led to.

    The student leads until a step that is drawn for each episode, the teacher from there on: Ross, Gordon and Bagnell,
    A Reduction of Imitation Learning and Structured Prediction to No-Regret Online Learning (2011), with the roll-in of
    Ross and Bagnell, Reinforcement and Imitation Learning via Interactive No-Regret Learning (2014). Only the teacher's
    steps are kept, because a plan of several actions is a sequence that one of the two took.

    Args:
        environment: that is stepped.
        teacher: returns the actions (N, A) for an observation; asked at every step, so that it follows the episode.
        student: acts first; None lets the teacher lead from the beginning.
        seed: of the episodes and of the steps at which the teacher takes over.
    """
    seen, _ = environment.reset(seed)
    count, steps, device = environment.num_envs, environment.max_episode_steps, environment.device
    drawn = torch.randint(steps, (count,), generator=torch.Generator().manual_seed(seed)).to(device)
    takes_over = torch.zeros_like(drawn) if student is None else drawn
    acting = None if student is None else Remembering(student, count, device)
    begun = torch.ones(count, dtype=torch.bool, device=device)
    first = begun.clone()
    observations: list[Seen] = []
    actions, kept = [], []
    for step in range(steps):
        shown = seen[POLICY]
        wanted = teacher(seen).clamp(-1.0, 1.0)
        leads = takes_over <= step
        observations.append(map_seen(torch.clone, shown))
        actions.append(wanted.clone())
        # An environment whose first episode ended early plays on, and is not learned from.
        kept.append(leads & first)
        action = wanted if acting is None else torch.where(leads[:, None], wanted, acting.act(shown, begun))
        seen, _, terminated, truncated, _ = environment.step(action)
        begun = terminated | truncated
        first &= ~begun
    return _flattened(observations, torch.stack(actions), torch.stack(kept))


def _flattened(observations: list[Seen], actions: Tensor, kept: Tensor) -> Demonstrations:
    """Return the kept steps, one environment's after another's, on the CPU.

    Args:
        observations: of each step, a row for each environment.
        actions: (T, N, A).
        kept: (T, N) bool; a stretch in each environment.
    """
    environments, steps = kept.T.nonzero(as_tuple=True)
    lengths = kept.sum(0)
    ends = (lengths.cumsum(0) - 1).repeat_interleave(lengths)
    first = observations[0]
    if isinstance(first, Tensor):
        observation = torch.stack(observations)[steps, environments].cpu()  # pyright: ignore[reportArgumentType]
    else:
        observation = {
            name: torch.stack([each[name] for each in observations])[steps, environments].cpu()  # pyright: ignore
            for name in first
        }
    return Demonstrations(observation, actions[steps, environments].cpu(), ends.cpu())
