"""Audit of a task: order of its agents' returns, limits that its expert keeps, where episodes start, and chance."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from orbit_conformance.task_starts import Coverage, sample_starts
from orbit_core.envs import Environment, Task, make
from orbit_core.envs.actors import scripted_actor
from orbit_core.envs.task_checks import TaskCheck
from orbit_core.interfaces import Robot
from orbit_core.interfaces.layout import joint_limits
from orbit_core.rollout.estimates import Estimate, mean
from orbit_core.rollout.stepping import EpisodeCounter, Episodes, StepObserver, roll_out

EXPERT, TRIVIAL = "expert", ("random", "zero", "hold")
MOST_BEYOND = 0.01
"""Largest share of an expert's samples beyond a limit: contacts throw a joint about for a moment."""
_ROUNDING = 1e-3
"""Relative excess over a limit that counts as rounding."""
LEAST_AREA = 0.02
"""m^2 that the starts of the widest-spread thing cover at least."""
LEAST_YAW = 0.25
"""Share of a whole turn that the starts of the thing turned most cover at least."""
MOST_TRIVIAL = 0.05
"""Highest success rate of an agent that looks at nothing."""


@dataclass(frozen=True)
class AgentResult:
    """Success rate and mean return of an agent's episodes."""

    success: Estimate
    episode_return: Estimate


@dataclass(frozen=True)
class LimitUse:
    """Use of the joints' limits, sampled once per step of the environment over all joints that have such a limit."""

    beyond: float = 0.0
    """Share of samples beyond the limit."""
    peak: float = 0.0
    """Largest sample over its limit."""


class Status(Enum):
    """Outcome of a check."""

    HOLDS = "holds"
    DECLARED = "declared"
    """It does not hold, as the task declares."""
    FAILS = "fails"
    STALE = "stale"
    """It holds, though the task declares that it does not."""
    ABSENT = "not applicable"


@dataclass(frozen=True)
class Verdict:
    """Outcome of one check of a task."""

    check: TaskCheck
    status: Status
    figure: str
    """Measured value, for people."""
    reason: str = ""
    """Declared by the task, or why the check does not apply."""


@dataclass(frozen=True)
class TaskAudit:
    """Measurements of a task on a backend, with a verdict per check."""

    task: str
    backend: str
    episodes: int
    agents: Mapping[str, AgentResult]
    velocity: LimitUse
    effort: LimitUse
    starts: tuple[Coverage, ...]
    """Things whose place or yaw differs between starts, the widest first."""
    start_samples: int
    seconds: float
    """Wall time of the audit."""
    verdicts: tuple[Verdict, ...] = ()

    @property
    def faults(self) -> tuple[Verdict, ...]:
        """Verdicts that fail or are stale."""
        return tuple(verdict for verdict in self.verdicts if verdict.status in (Status.FAILS, Status.STALE))


def audit_task(
    task: str | Task,
    backend: str | None = None,
    *,
    episodes: int = 16,
    start_samples: int = 1024,
    seed: int = 0,
    device: str = "cpu",
    **fields: Any,
) -> TaskAudit:
    """Run a task's agents and sample its starts.

    Args:
        task: name of a registered task, or one that is configured.
        backend: name of an installed backend; the default one if None.
        episodes: of each agent, one in each environment.
        start_samples: number of starts to sample, rounded up to whole resets of all environments.
        seed: of the environments and agents.
        device: where tensors live.
        fields: of the task, by name.

    Raises:
        UnknownNameError: there is no such task, field or backend.
        UnsupportedCapabilityError: the backend lacks what the task needs.
    """
    begin = time.perf_counter()
    environment = make(task, episodes, backend, device, seed, **fields)
    try:
        has_expert = environment.task.has_expert()
        limits = _LimitMeter(environment)
        agents = {
            name: _run(environment, name, seed, limits if name == EXPERT else None)
            for name in ((EXPERT,) if has_expert else ()) + TRIVIAL
        }
        resets = max(1, math.ceil(start_samples / episodes)) if start_samples else 0
        audit = TaskAudit(
            task=task if isinstance(task, str) else type(task).__name__,
            backend=environment.world.backend,
            episodes=episodes,
            agents=agents,
            velocity=limits.use(limits.speeds),
            effort=limits.use(limits.efforts),
            starts=sample_starts(environment, resets),
            start_samples=resets * episodes,
            seconds=time.perf_counter() - begin,
        )
        return _judged(audit, environment)
    finally:
        environment.close()


class _LimitMeter(StepObserver):
    """Samples of the speeds and efforts of all robots' joints, over their limits."""

    def __init__(self, environment: Environment) -> None:
        self._task = environment.task
        self._joints = [
            (robot, _finite_limits(robot, "velocity_limit"), _finite_limits(robot, "effort_limit"))
            for robot in environment.world.robots.values()
        ]
        self.counter: EpisodeCounter | None = None
        self.speeds: list[Tensor] = []
        self.efforts: list[Tensor] = []

    def after_step(self, action: Tensor, info: Mapping[str, Any]) -> None:
        """Sample the joints of episodes that still count and go on; where one ended, the next has begun."""
        assert self.counter is not None
        rows = self.counter.running & (self._task.episode_step > 0)
        for robot, speed_limits, effort_limits in self._joints:
            self.speeds.append((robot.joint_velocities.abs() / speed_limits)[rows].flatten())
            self.efforts.append((robot.joint_efforts.abs() / effort_limits)[rows].flatten())

    def use(self, samples: list[Tensor]) -> LimitUse:
        """Summarise samples, leaving out joints without a limit, which are NaN."""
        values = torch.cat(samples) if samples else torch.zeros(0)
        values = values[values.isfinite()]
        if not len(values):
            return LimitUse()
        return LimitUse(float((values > 1.0 + _ROUNDING).float().mean()), float(values.max()))


def _finite_limits(robot: Robot, name: Literal["velocity_limit", "effort_limit"]) -> Tensor:
    """Return the limits (J,) of a robot's joints, NaN where a joint has none."""
    limits = joint_limits(robot.spec, name)
    usable = np.isfinite(limits) & (limits > 0.0)
    return torch.as_tensor(np.where(usable, limits, np.nan), dtype=torch.float32, device=robot.joint_positions.device)


def _run(environment: Environment, agent: str, seed: int, limits: _LimitMeter | None) -> AgentResult:
    """Run one episode of an agent in each environment; all agents meet the same starts."""
    environment.reset(seed=seed)
    counter = EpisodeCounter(environment.num_envs, environment.num_envs, environment.device)
    observers: tuple[StepObserver, ...] = (counter,)
    if limits is not None:
        limits.counter = counter
        observers = (counter, limits)
    roll_out(environment, scripted_actor(agent, environment, seed), observers, lambda: counter.complete)
    episodes: Episodes = counter.episodes()
    return AgentResult(episodes.success_rate, mean(episodes.returns.tolist()))


def _judged(audit: TaskAudit, environment: Environment) -> TaskAudit:
    """Return the audit with its verdicts."""
    declared = {exception.check: exception.reason for exception in environment.task.exceptions}
    verdicts = list[Verdict]()
    for check in TaskCheck:
        held, figure = _measured(check, audit, bool(environment.reward_terms))
        if held is None:
            verdicts.append(Verdict(check, Status.ABSENT, "", figure))
        elif check in declared:
            # Some engines enforce velocity limits whatever the expert does.
            stale = held and check is not TaskCheck.VELOCITY_LIMITS
            verdicts.append(Verdict(check, Status.STALE if stale else Status.DECLARED, figure, declared[check]))
        else:
            verdicts.append(Verdict(check, Status.HOLDS if held else Status.FAILS, figure))
    return replace(audit, verdicts=tuple(verdicts))


def _measured(check: TaskCheck, audit: TaskAudit, has_rewards: bool) -> tuple[bool | None, str]:
    """Whether a check holds, None where it does not apply, with its figure or the reason."""
    agents = audit.agents
    if check is TaskCheck.TRIVIAL_AGENTS:
        most = max(TRIVIAL, key=lambda name: agents[name].success.value)
        rate = agents[most].success.value
        return rate <= MOST_TRIVIAL, f"{most} {100.0 * rate:.0f} %"
    if check is TaskCheck.START_AREA:
        widest = max(audit.starts, key=lambda start: start.area, default=Coverage("nothing", 0.0, 0.0))
        return widest.area >= LEAST_AREA, f"{widest.area:.3g} m² ({widest.name})"
    if check is TaskCheck.START_YAW:
        widest = max(audit.starts, key=lambda start: start.yaw, default=Coverage("nothing", 0.0, 0.0))
        return widest.yaw >= LEAST_YAW, f"{100.0 * widest.yaw:.0f} % ({widest.name})"
    if EXPERT not in agents:
        return None, "no expert"
    if check in (TaskCheck.VELOCITY_LIMITS, TaskCheck.EFFORT_LIMITS):
        use = audit.velocity if check is TaskCheck.VELOCITY_LIMITS else audit.effort
        return use.beyond <= MOST_BEYOND, f"{100.0 * use.beyond:.2g} % beyond, at most {use.peak:.2f}"
    if not has_rewards:
        return None, "no rewards"
    other = "zero" if check is TaskCheck.EXPERT_BEATS_ZERO else "random"
    own, others = agents[EXPERT].episode_return.value, agents[other].episode_return.value
    return own > others, f"{own:.3g} against {others:.3g}"
