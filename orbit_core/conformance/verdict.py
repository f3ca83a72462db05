"""What a scenario's errors say of a backend that has declared what it can do."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

from orbit_core.conformance.scenario import Scenario, Trial
from orbit_core.interfaces import Backend, Capability, Gap, SimulationError, UnsupportedCapabilityError


class Status(Enum):
    """How a backend stands in a scenario."""

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
        """Whether the backend is as it declares."""
        return self in (Status.PASS, Status.GAP, Status.UNSUPPORTED)


@dataclass(frozen=True)
class Verdict:
    """A backend's standing in a scenario, the reason for anything but a pass, and the errors behind it."""

    status: Status
    reason: str = ""
    errors: Mapping[str, float] = field(default_factory=dict)


def lacking(backend: Backend, scenario: Scenario) -> str:
    """Which needs of the scenario the backend declares unsupported, and why; empty if none."""
    missing: list[Capability] = [need for need in scenario.needs if not backend.capabilities().has(need)]
    return "; ".join(f"no {need.value}: {backend.capabilities()[need].reason}" for need in missing)


def judge(backend: Backend, scenario: Scenario, errors: Mapping[str, float]) -> Verdict:
    """Hold the errors at the nominal time step against tolerances and declared gaps."""
    gaps = {gap.metric: gap for gap in backend.gaps() if gap.scenario == scenario.name}
    findings = [_judge_metric(metric.tolerance, errors[metric.name], gaps.get(metric.name), metric.name)
                for metric in scenario.metrics]  # fmt: skip
    for status in (Status.FAIL, Status.STALE, Status.GAP):
        reasons = [reason for found, reason in findings if found is status]
        if reasons:
            return Verdict(status, "; ".join(reasons), errors)
    return Verdict(Status.PASS, errors=errors)


def _judge_metric(tolerance: float, error: float, gap: Gap | None, name: str) -> tuple[Status, str]:
    within = math.isfinite(error) and error <= tolerance
    if gap is None:
        return (Status.PASS, "") if within else (Status.FAIL, f"{name} is {error:.3g}, above {tolerance:.3g}")
    if within:
        return Status.STALE, f"{name} is {error:.3g}, within {tolerance:.3g}: take the declared gap back"
    if error <= gap.limit:
        return Status.GAP, f"{name} is {error:.3g}, above {tolerance:.3g}: {gap.reason}"
    return Status.FAIL, f"{name} is {error:.3g}, beyond the declared {gap.limit:.3g}"


def _diverged(backend: Backend, scenario: Scenario, error: SimulationError) -> Verdict:
    """An engine that says itself that it diverged: no metric has a finite error."""
    verdict = judge(backend, scenario, {metric.name: math.inf for metric in scenario.metrics})
    return replace(verdict, reason=f"{error}; {verdict.reason}")


def run_scenario(scenario: Scenario, backend: Backend, trial: Trial) -> Verdict:
    """Run a scenario at the trial's time step and judge it; the trial is closed after."""
    reason = lacking(backend, scenario)
    if reason:
        return Verdict(Status.UNSUPPORTED, reason)
    with trial:
        try:
            errors = scenario.run(trial)
        except UnsupportedCapabilityError as error:
            return Verdict(Status.UNSUPPORTED, str(error))
        except SimulationError as error:
            return _diverged(backend, scenario, error)
    return judge(backend, scenario, errors)
