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

from orbit_core.dynamics.transforms import yaw_angle
from orbit_core.envs import Environment, Task, make
from orbit_core.envs.actors import scripted_actor
from orbit_core.envs.task import TaskCheck
from orbit_core.interfaces import Robot
from orbit_core.interfaces.layout import joint_limits
from orbit_core.rollout.estimates import Estimate, mean
from orbit_core.rollout.stepping import EpisodeCounter, Episodes, StepObserver, roll_out

# Coverage of a task's starts: the area and the yaw angles over which things begin an episode --------------------------

# m: least edge of the cells that are counted.
_CELL = 0.02
# Samples expected in each cell of the bounding rectangle: cells grow until it is reached.
_SAMPLES_PER_CELL = 4
# Sectors of a whole turn.
_SECTORS = 36


@dataclass(frozen=True)
class Coverage:
    """Area and angles over which one thing begins its episodes."""

    name: str
    """Name of the thing."""
    area: float
    """m^2 of the grid's cells, seen from above, that hold a start."""
    yaw: float
    """Share of 36 sectors of a whole turn that hold a start; 0 where it is never turned."""


def sample_starts(environment: Environment, resets: int) -> tuple[Coverage, ...]:
    """Reset all environments some times and measure what their starts cover.

    Returns:
        The coverage of each robot, object, deformable (by the middle of its points) and marker whose place or yaw
        differs, the widest first.
    """
    world = environment.world
    drawn: dict[str, list[Tensor]] = {}
    for _ in range(resets):
        environment.reset()
        for name, entity in {**world.robots, **world.objects}.items():
            drawn.setdefault(name, []).append(entity.root_pose.clone())
        for name, deformable in world.deformables.items():
            middle = deformable.positions.mean(dim=1)
            poses = torch.cat(
                (middle, torch.tensor([1.0, 0.0, 0.0, 0.0], device=middle.device).expand(len(middle), 4)), 1
            )
            drawn.setdefault(name, []).append(poses)
        for index, marker in enumerate(world.scene.markers):
            drawn.setdefault(f"marker {marker.name}", []).append(world.marker_poses[:, index].clone())
    found = [coverage(name, torch.cat(poses)) for name, poses in drawn.items()]
    return tuple(sorted((one for one in found if one.area or one.yaw), key=lambda one: (-one.area, -one.yaw)))


def coverage(name: str, poses: Tensor) -> Coverage:
    """Measure what poses (S, 7) cover, seen from above."""
    places = poses[:, :2].double()
    extent = places.amax(0) - places.amin(0)
    area = 0.0
    # Starts at one place cover nothing; their spread is rounding.
    if bool((extent > 1e-4).any()):
        edge = max(_CELL, math.sqrt(float(extent.prod()) * _SAMPLES_PER_CELL / len(poses)))
        cells = ((places - places.amin(0)) / edge).floor().long()
        # A line of starts covers no more than its own width, which a cell would round up.
        area = len(cells.unique(dim=0)) * float(extent.clamp_max(edge).prod())
    yaw = yaw_angle(poses[:, 3:])
    # Counted sectors instead of a range, so that two narrow fans are no full turn.
    sectors = ((yaw + math.pi) / (2.0 * math.pi) * _SECTORS).floor().clamp(0, _SECTORS - 1).unique()
    return Coverage(name, area, len(sectors) / _SECTORS if float(yaw.amax() - yaw.amin()) > 1e-3 else 0.0)


EXPERT, TRIVIAL = "expert", ("random", "zero", "hold")
# Largest share of an expert's samples beyond a limit: contacts throw a joint about for a moment.
MOST_BEYOND = 0.01
# Relative excess over a limit that counts as rounding.
_ROUNDING = 1e-3
# m^2 that the starts of the widest-spread thing cover at least.
LEAST_AREA = 0.02
# Share of a whole turn that the starts of the thing turned most cover at least.
LEAST_YAW = 0.25
# Highest success rate of an agent that looks at nothing.
MOST_TRIVIAL = 0.05


@dataclass(frozen=True)
class AgentResult:
    """Success rate and mean return of an agent's episodes."""

    success: Estimate
    """Success rate in [0, 1]."""
    episode_return: Estimate
    """Mean sum of an episode's rewards."""


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
    """The check is met."""
    DECLARED = "declared"
    """It does not hold, as the task declares."""
    FAILS = "fails"
    """The check is not met, and the task does not declare so."""
    STALE = "stale"
    """It holds, though the task declares that it does not."""
    ABSENT = "not applicable"


@dataclass(frozen=True)
class Verdict:
    """Outcome of one check of a task."""

    check: TaskCheck
    """Property that was measured."""
    status: Status
    """Outcome."""
    figure: str
    """Measured value, for people."""
    reason: str = ""
    """Declared by the task, or why the check does not apply."""


@dataclass(frozen=True)
class TaskAudit:
    """Measurements of a task on a backend, with a verdict per check."""

    task: str
    """Name of the task."""
    backend: str
    """Name of the backend."""
    episodes: int
    """Number of episodes of each agent."""
    agents: Mapping[str, AgentResult]
    """Results of expert, random, zero and trivial agents, by name."""
    velocity: LimitUse
    """Use of the joints' velocity limits by the expert."""
    effort: LimitUse
    """Use of the joints' effort limits by the expert."""
    starts: tuple[Coverage, ...]
    """Things whose place or yaw differs between starts, the widest first."""
    start_samples: int
    """Number of starts that were sampled."""
    seconds: float
    """Wall time of the audit."""
    verdicts: tuple[Verdict, ...] = ()
    """Verdicts of all checks."""

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
        self._state = environment.state
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
        rows = self.counter.running & (self._state.episode_step > 0)
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
    # One seed for all agents: differences between them are not those of their starts.
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
    declared = {exception.check: exception.reason for exception in environment.task.metadata.exceptions}
    verdicts = list[Verdict]()
    for check in TaskCheck:
        # Measured before declarations are looked at, so that a stale one is found.
        held, figure = _measured(check, audit, bool(environment.reward_terms))
        if held is None:
            verdicts.append(Verdict(check, Status.ABSENT, "", figure))
        elif check in declared:
            # Some engines enforce velocity limits, so that no expert can exceed them there.
            stale = held and check is not TaskCheck.VELOCITY_LIMITS
            verdicts.append(Verdict(check, Status.STALE if stale else Status.DECLARED, figure, declared[check]))
        else:
            verdicts.append(Verdict(check, Status.HOLDS if held else Status.FAILS, figure))
    return replace(audit, verdicts=tuple(verdicts))


def _measured(check: TaskCheck, audit: TaskAudit, has_rewards: bool) -> tuple[bool | None, str]:
    """Return True if a check holds, None where it does not apply, with its figure or the reason."""
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
    # Learned tasks have no expert to be compared with.
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
