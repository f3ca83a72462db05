"""Verdict on a backend from a scenario's errors and the backend's declarations."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
import numpy.typing as npt

from orbit_conformance.recording import Recording
from orbit_conformance.scenario import Metric, Scenario, Trace, Trial
from orbit_core.interfaces import Backend, ConfigurationError, Gap, SimulationError, UnsupportedCapabilityError
from orbit_core.interfaces.capabilities import MATTER
from orbit_core.interfaces.matter import MatterSolver

# Distance over time between two recorded runs of a task ---------------------------------------------------------------

# The most instants of a divergence that are kept, evenly spaced.
_POINTS = 101


@dataclass(frozen=True)
class Divergence:
    """Distance of one thing between two runs of a task, over environments in which both episodes still run."""

    thing: str
    """End effector, object or key point that is tracked."""
    times: list[float]
    """Seconds since the episode began."""
    lower_quartile: list[float]
    """Distance in metres that a quarter of the environments stay below."""
    median: list[float]
    """Distance in metres that half of the environments stay below."""
    upper_quartile: list[float]
    """Distance in metres that three quarters stay below."""


def divergence(recording: Recording, reference: Recording) -> list[Divergence]:
    """Distance over time between two runs of one task, for each thing that both have tracked.

    Raises:
        ConfigurationError: the runs are of different tasks, seeds or fields.
    """
    for name in ("task", "seed", "fields", "step_dt"):
        ours, theirs = getattr(recording, name), getattr(reference, name)
        if ours != theirs:
            raise ConfigurationError(f"recordings of different runs: {name} is {ours!r} here and {theirs!r} there")
    shared = [name for name in recording.tracks if name in reference.tracks]
    return [_divergence(name, recording.tracks[name], reference.tracks[name], recording.step_dt) for name in shared]


def _divergence(
    name: str, ours: npt.NDArray[np.float32], theirs: npt.NDArray[np.float32], step_dt: float
) -> Divergence:
    # Episodes end at different steps; after that there is nothing to compare.
    steps, count = min(len(ours), len(theirs)), min(ours.shape[1], theirs.shape[1])
    distances = np.linalg.norm(ours[:steps, :count, :3] - theirs[:steps, :count, :3], axis=2).astype(np.float64)
    rows = np.unique(np.linspace(0, steps - 1, min(_POINTS, steps)).round().astype(int))
    # Environments whose episode has ended are NaN.
    rows = rows[np.isfinite(distances[rows]).any(axis=1)]
    # A median, since one dropped cube would dominate a mean.
    lower, middle, upper = np.nanquantile(distances[rows], (0.25, 0.5, 0.75), axis=1)
    return Divergence(name, (rows * step_dt).tolist(), lower.tolist(), middle.tolist(), upper.tolist())


class Status(Enum):
    """Statuses of a backend in a scenario."""

    PASS = "pass"
    """Every metric within its tolerance."""
    GAP = "declared gap"
    """A metric misses its tolerance, as the backend declares."""
    UNSUPPORTED = "unsupported"
    """The backend declares that it lacks a capability."""
    FAIL = "fail"
    """A metric misses its tolerance, undeclared or beyond what is declared; or something broke."""
    STALE = "stale declaration"
    """A declared gap is none."""

    @property
    def acceptable(self) -> bool:
        """True if the backend is as it declares."""
        return self in (Status.PASS, Status.GAP, Status.UNSUPPORTED)


@dataclass(frozen=True)
class Verdict:
    """A backend's standing in a scenario, the reason for anything but a pass, and the errors behind it."""

    status: Status
    """Standing of the backend."""
    reason: str = ""
    """Reason for anything but a pass."""
    errors: Mapping[str, float] = field(default_factory=dict)
    """Errors by metric."""


def lacking(backend: Backend, scenario: Scenario, solver: MatterSolver | None = None) -> str:
    """Return the needs of the scenario that are declared unsupported, with reasons; empty if none.

    Args:
        backend: what simulates.
        scenario: what is asked for.
        solver: what simulates deformables; the backend if None.
    """
    owners = {need: solver if solver and need in MATTER else backend for need in scenario.needs}
    supports = {need: owner.capabilities() for need, owner in owners.items()}
    missing = {need: of[need].reason for need, of in supports.items() if not of.has(need)}
    return "; ".join(f"no {need.value}: {reason}" for need, reason in missing.items())


def judge(owner: Backend | MatterSolver, scenario: Scenario, errors: Mapping[str, float]) -> Verdict:
    """Hold the errors at the nominal time step against tolerances and the owner's declared gaps."""
    gaps = {gap.metric: gap for gap in owner.gaps() if gap.scenario == scenario.name}
    return judge_metrics(scenario.metrics, errors, gaps)


def judge_metrics(metrics: Iterable[Metric], errors: Mapping[str, float], gaps: Mapping[str, Gap]) -> Verdict:
    """Hold the error of each metric against its tolerance, and the declared gap of that metric's name."""
    findings = [_judge_metric(metric, errors[metric.name], gaps.get(metric.name)) for metric in metrics]
    # The worst status decides, and only its reasons are given.
    for status in (Status.FAIL, Status.STALE, Status.GAP):
        reasons = [reason for found, reason in findings if found is status]
        if reasons:
            return Verdict(status, "; ".join(reasons), errors)
    return Verdict(Status.PASS, errors=errors)


def _judge_metric(metric: Metric, error: float, gap: Gap | None) -> tuple[Status, str]:
    def told(value: float) -> str:
        return f"{value:.3g} {metric.unit}".strip()

    # NaN compares false with everything, and must not pass.
    within = math.isfinite(error) and error <= metric.tolerance
    measured, tolerance = f"{metric.name} is {told(error)}", f"tolerance of {told(metric.tolerance)}"
    if gap is None:
        return (Status.PASS, "") if within else (Status.FAIL, f"{measured}, above the {tolerance}")
    if within:
        return Status.STALE, f"{measured}, within the {tolerance}: take the declared gap back"
    if error <= gap.limit:
        return Status.GAP, f"{measured}, above the {tolerance}: {gap.reason}"
    return Status.FAIL, f"{measured}, beyond the declared {told(gap.limit)} (the {tolerance})"


def farthest(traces: Iterable[Trace]) -> str:
    """Describe where each measured curve is farthest from the truth, and to which side; empty if all are on it."""
    found: list[str] = []
    for trace in traces:
        differences = [measured - true for measured, true in zip(trace.measured, trace.truth, strict=True)]
        where = max(range(len(differences)), key=lambda index: _size(differences[index]), default=None)
        if where is None or not differences[where]:
            continue
        measured, true = (f"{curve[where]:.4g} {trace.unit}".strip() for curve in (trace.measured, trace.truth))
        side = "above" if differences[where] > 0 else "below" if differences[where] < 0 else "beside"
        found.append(f"curve '{trace.name}' is farthest at {trace.times[where]:.4g} s: {measured}, {side} {true}")
    return "; ".join(found)


def _size(difference: float) -> float:
    """The absolute value of an error; one that is no number counts as infinite."""
    return math.inf if math.isnan(difference) else abs(difference)


def _refused(owner: Backend | MatterSolver, scenario: Scenario, error: Exception) -> Verdict:
    """The verdict where an engine reports that it diverged, or would at this step: no metric has a finite error."""
    verdict = judge(owner, scenario, {metric.name: math.inf for metric in scenario.metrics})
    return replace(verdict, reason=f"{error}; {verdict.reason}")


def run_scenario(scenario: Scenario, backend: Backend, trial: Trial) -> Verdict:
    """Run a scenario at the trial's time step and judge it; the trial is closed after.

    A scenario of matter that a solver simulates is held to the solver's declared gaps, every other to the backend's.
    """
    solver = trial.solver if scenario.of_matter else None
    owner = solver or backend
    if reason := lacking(backend, scenario, solver):
        return Verdict(Status.UNSUPPORTED, reason)
    with trial:
        try:
            errors = scenario.run(trial)
        except UnsupportedCapabilityError as error:
            return Verdict(Status.UNSUPPORTED, str(error))
        except (SimulationError, ConfigurationError) as error:
            return _refused(owner, scenario, error)
    verdict = judge(owner, scenario, errors)
    if verdict.status is Status.FAIL and (where := farthest(trial.traces)):
        return replace(verdict, reason=f"{verdict.reason}; {where}")
    return verdict
