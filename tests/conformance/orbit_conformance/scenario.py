"""A scenario: a small experiment with a known answer, run on any backend at any time step."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from orbit_core.backends import matter_solver
from orbit_core.interfaces import Capability, World
from orbit_core.interfaces.capabilities import MATTER
from orbit_core.interfaces.matter import NATIVE, MatterSolver
from orbit_core.scene import Scene
from orbit_core.world import simulate

SINGLE = "states are told in single precision, and engines that reckon in it round at each step"
FIRST_ORDER = "integrators of first order err in proportion to the time step; the best one divides the step"
"""Reasons for a :attr:`Metric.looser_because`."""


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One error of a scenario, zero for a perfect engine."""

    name: str
    """Name in snake case, unique in the scenario."""
    unit: str
    """SI unit; empty for a ratio."""
    tolerance: float
    """Largest error that passes at the scenario's nominal time step."""
    meaning: str
    """What is measured against which truth, in words or a formula."""
    looser_because: str = ""
    """Why the tolerance may be more than three times what the best engine reaches."""


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """An experiment, the truth that it is held against, and how far from it an engine may be.

    ``run`` builds worlds with ``trial.world(scene)``, advances them with ``trial.step``, and returns the error of every
    metric. What an engine may lack is named in ``needs``, beyond what the scenes themselves require.
    """

    name: str
    """Name in snake case."""
    group: str
    """The heading under which reports show it."""
    question: str
    """The question that the scenario asks of an engine, in one sentence."""
    truth: str
    """The closed form, or the converged reference, that answers it."""
    source: str
    """Where the truth comes from: a textbook with its section, a paper."""
    metrics: tuple[Metric, ...]
    """Errors that ``run`` returns, with their tolerances."""
    run: Callable[[Trial], Mapping[str, float]]
    needs: tuple[Capability, ...] = ()
    judges: tuple[Capability, ...] = ()
    """What it measures: a backend that misses one of its metrics does not do these exactly. How an engine integrates
    free motion, and whether things stay at rest, is no capability: the declared gap alone tells of it."""
    time_step: float = 0.005
    """Nominal time step in seconds, at which the tolerances hold."""
    time_steps: tuple[float, ...] = (0.01, 0.005, 0.0025, 0.00125)
    """Time steps in seconds of the sweep that shows accuracy against speed; empty where the step plays no part."""
    substeps: tuple[float, ...] = (0.0025, 0.00125, 0.000625, 0.0003125)
    """Steps in seconds of the matter solver within the nominal time step: the sweep of a scenario of matter that a
    solver simulates, in the place of ``time_steps``."""
    slow: bool = False
    """Whether some engine takes minutes: quick runs and the tests leave it out."""

    @property
    def of_matter(self) -> bool:
        """True if something in it bends or flows, so that it is run with every matter solver."""
        # Needs say it already; a separate flag could contradict them.
        return any(need in MATTER for need in self.needs)

    def metric(self, name: str) -> Metric:
        """The metric of that name."""
        return next(metric for metric in self.metrics if metric.name == name)


@dataclass(frozen=True)
class Trace:
    """Measured curve with its truth, for the report's plots."""

    name: str
    """Title of the plot."""
    unit: str
    """SI unit of both curves."""
    times: list[float]
    """Seconds."""
    measured: list[float]
    """Values of the engine."""
    truth: list[float]
    """Values of the closed form or the reference."""


@dataclass
class Trial:
    """One run of a scenario on one backend at one time step: makes its worlds, times them, keeps its curves."""

    backend: str
    """Name of the backend."""
    time_step: float
    """Seconds of a physics step."""
    device: str = "cpu"
    """Torch device of the worlds."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the backend by field name."""
    seed: int = 0
    """Seed of the worlds' random streams."""
    matter: str = NATIVE
    """What simulates deformables: the name of a matter solver, or ``"native"`` for the engine's own."""
    substep: float = 0.0
    """Seconds of the solver's steps; the solver's choice if zero."""
    traces: list[Trace] = field(default_factory=list)
    """Curves for the report."""
    simulated_seconds: float = 0.0
    """Simulated time, summed over all environments."""
    wall_seconds: float = 0.0
    """Wall time spent in stepping."""
    _worlds: list[World] = field(default_factory=list)
    _stepped: list[World] = field(default_factory=list)

    @property
    def solver(self) -> MatterSolver | None:
        """The matter solver; None where the engine itself simulates deformables."""
        return None if self.matter == NATIVE else matter_solver(self.matter)

    def world(self, scene: Scene, num_envs: int = 1) -> World:
        """A world of the scene, at this trial's time step; closed with the trial."""
        scene = dataclasses.replace(scene, physics_dt=self.time_step)
        solver = self.solver if scene.deformables else None
        own = solver.settings_at(self.substep) if solver and self.substep else None
        common = (num_envs, self.backend, self.settings, self.device, self.seed)
        world = simulate(scene, *common, matter=self.matter, matter_settings=own)
        self._worlds.append(world)
        world.reset()
        return world

    def steps(self, seconds: float) -> int:
        """The number of physics steps in a stretch of time."""
        return round(seconds / self.time_step)

    def step(self, world: World, steps: int = 1) -> None:
        """Advance a world by physics steps, on the clock; without a world's first step, in which engines compile."""
        if world not in self._stepped:
            self._stepped.append(world)
            world.step(1)
            steps -= 1
        if not steps:
            return
        begin = time.perf_counter()
        world.step(steps)
        world.engine.joint_positions.sum().item()  # a device is done when it answers
        self.wall_seconds += time.perf_counter() - begin
        self.simulated_seconds += steps * self.time_step * world.num_envs

    def advance(self, world: World, seconds: float, every: float = 0.0) -> Iterator[float]:
        """Step a world through a stretch of time: gives the time at its beginning, and again after each ``every``.

        ``every`` is a multiple of the time step, or zero for each step.
        """
        stride = max(1, self.steps(every))
        for count in range(self.steps(seconds) // stride + 1):
            if count:
                self.step(world, stride)
            yield count * stride * self.time_step

    def trace(
        self, name: str, unit: str, times: Sequence[float], measured: Sequence[float], truth: Sequence[float]
    ) -> None:
        """Record a curve for the report."""
        self.traces.append(Trace(name, unit, *(torch.as_tensor(c).tolist() for c in (times, measured, truth))))

    def close(self) -> None:
        """Close the trial's worlds."""
        while self._worlds:
            self._worlds.pop().close()
        self._stepped.clear()

    def __enter__(self) -> Trial:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
