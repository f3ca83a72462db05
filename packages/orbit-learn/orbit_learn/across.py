"""One task on several engines, whose environments a trainer steps as one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate
from typing import Any

import torch
from torch import Tensor

from orbit_core.envs.captured_step import StepResult
from orbit_core.envs.environment import Environment
from orbit_core.envs.episode import EpisodeEnd, StepInfo
from orbit_core.envs.observation_layout import Observation, leaves_of, observation_of
from orbit_core.envs.policy_loop import PolicyLoop
from orbit_core.interfaces import ConfigurationError

# Seeds of engines are as far apart as those of torchrun's processes, and never one of theirs.
_BETWEEN_SEEDS = 1_000_000


class AcrossEngines:
    """Environments of several engines as one: rows of the first engine come first, then those of the next.

    It has what trainers with ``several_engines`` use of an :class:`~orbit_core.envs.environment.Environment`. Engines
    step one after the other.

    Args:
        parts: an environment on each engine, of the same task and device; closed with this one.

    Raises:
        ConfigurationError: observation, action, rate or device differ between engines; names the first that does.
    """

    def __init__(self, parts: Sequence[Environment]) -> None:
        self.parts = tuple(parts)
        first = self.parts[0]
        for part in self.parts[1:]:
            _check_alike(first, part)
        self.task = first.task
        """Task of the first engine, configured as that of all."""
        self.device = first.device
        """Device of all tensors."""
        self.step_dt = first.step_dt
        """Seconds of a step."""
        self.max_episode_steps = first.max_episode_steps
        """Steps until the time limit."""
        self.action_size = first.action_size
        """Components A of an action."""
        self.observation = first.observation
        """Layout of each group of the observation, by name; the same on all engines."""
        self.actions = first.actions
        """Action manager of the first engine, which describes the action of all."""
        ends = tuple(accumulate(part.num_envs for part in self.parts))
        self.num_envs = ends[-1]
        """Number N of environments on all engines."""
        self.rows = tuple(slice(end - part.num_envs, end) for end, part in zip(ends, self.parts, strict=True))
        """Rows of each engine's environments."""

    def reset(self, seed: int | None = None) -> tuple[Observation, dict[str, Any]]:
        """Begin new episodes in all environments; with a seed, each engine's streams restart from one of its own."""
        seen = [
            part.reset(None if seed is None else seed + _BETWEEN_SEEDS * place)[0]
            for place, part in enumerate(self.parts)
        ]
        return self._joined(seen), {}

    def spread_episodes(self) -> None:
        """Give every environment's episode a random age."""
        for part in self.parts:
            part.spread_episodes()

    def observe(self) -> Observation:
        """Return the observation of the present state."""
        return self._joined([part.observe() for part in self.parts])

    def step(self, action: Tensor) -> StepResult:
        """Take one step of all environments, (N, A), as :meth:`Environment.step` does."""
        results = [part.step(action[rows]) for part, rows in zip(self.parts, self.rows, strict=True)]
        seen, rewards, terminated, truncated, infos = zip(*results, strict=True)
        joined = self._joined(seen), torch.cat(rewards), torch.cat(terminated), torch.cat(truncated)
        return *joined, self._info(infos)

    def step_by(self, loop: PolicyLoop) -> None:
        """Take one step by a policy; nothing is recorded, because each engine would need a recording of its own."""
        result = self.step(loop.act(self.observe()))
        loop.keep(result)
        loop.take(result[0])

    def each(self, functions: Sequence[Callable[[Observation], Tensor]]) -> Callable[[Observation], Tensor]:
        """Return a function from observations to the values (N, ...) that each engine's own function gives its rows."""

        def together(seen: Observation) -> Tensor:
            leaves = leaves_of(seen)
            own = [observation_of(self.observation, [leaf[rows] for leaf in leaves]) for rows in self.rows]
            return torch.cat([function(rows) for function, rows in zip(functions, own, strict=True)])

        return together

    def close(self) -> None:
        """Free what the worlds hold."""
        for part in self.parts:
            part.close()

    def _joined(self, seen: Sequence[Observation]) -> Observation:
        leaves = zip(*(leaves_of(each) for each in seen), strict=True)
        return observation_of(self.observation, [torch.cat(each) for each in leaves])

    def _info(self, infos: Sequence[Mapping[str, EpisodeEnd]]) -> Mapping[str, EpisodeEnd]:
        """Join the infos of a step; on a GPU without waiting for the device."""
        if all(isinstance(info, StepInfo) for info in infos):
            found = [info for info in infos if isinstance(info, StepInfo)]
            everyone = self._ends([(info.everyone, rows) for info, rows in zip(found, self.rows, strict=True)])
            return StepInfo(torch.cat([info.done for info in found]), everyone)
        ends = [(info["final"], rows) for info, rows in zip(infos, self.rows, strict=True) if "final" in info]
        return {"final": self._ends(ends)} if ends else {}

    def _ends(self, ends: Sequence[tuple[EpisodeEnd, slice]]) -> EpisodeEnd:
        several = [end for end, _ in ends]
        return EpisodeEnd(
            env_ids=torch.cat([end.env_ids + rows.start for end, rows in ends]),
            observation=self._joined([end.observation for end in several]),
            success=torch.cat([end.success for end in several]),
            metrics=_by_name([end.metrics for end in several]),
            rewards=_by_name([end.rewards for end in several]),
            steps=torch.cat([end.steps for end in several]),
        )


def parts_of(environment: Environment | AcrossEngines) -> tuple[Environment, ...]:
    """Return the environments of each engine: several, or the given one."""
    return environment.parts if isinstance(environment, AcrossEngines) else (environment,)


def rows_of_engines(environment: Environment | AcrossEngines) -> dict[str, slice]:
    """Return the rows of each engine's environments by its name; empty where there is only one engine."""
    if not isinstance(environment, AcrossEngines):
        return {}
    names = [part.world.backend for part in environment.parts]
    return dict(zip(names, environment.rows, strict=True))


def _by_name(values: Sequence[Mapping[str, Tensor]]) -> dict[str, Tensor]:
    return {name: torch.cat([each[name] for each in values]) for name in values[0]}


def _check_alike(first: Environment, other: Environment) -> None:
    def shapes(part: Environment) -> dict[str, dict[str, tuple[int, ...]]]:
        return {
            name: {term: tuple(layout.shape) for term, layout in group.terms.items()}
            for name, group in part.observation.items()
        }

    facts = {
        "device": (str(first.device), str(other.device)),
        "observation": (shapes(first), shapes(other)),
        "action_size": (first.action_size, other.action_size),
        "step_dt": (first.step_dt, other.step_dt),
        "max_episode_steps": (first.max_episode_steps, other.max_episode_steps),
    }
    for name, (one, another) in facts.items():
        if one != another:
            raise ConfigurationError(
                f"a training across engines needs the same {name} on each: it is {one} on {first.world.backend}, and "
                f"{another} on {other.world.backend}"
            )
