"""Search for tolerances that are looser than the best engine warrants."""

from __future__ import annotations

import math
from dataclasses import dataclass

from orbit_conformance.results import Result, ScenarioInfo

# Largest ratio of a tolerance to the best engine's error that needs no reason.
FACTOR = 3.0


@dataclass(frozen=True)
class LooseTolerance:
    """A tolerance that is looser than the best engine warrants, for no stated reason."""

    scenario: str
    """Name of the scenario."""
    metric: str
    """Name of the metric."""
    unit: str
    """SI unit of the metric."""
    tolerance: float
    """Largest error that passes."""
    best: float
    """The smallest error of any backend at the nominal time step."""
    best_backend: str
    """Backend that has it."""

    def __str__(self) -> str:
        return (
            f"{self.scenario}: {self.metric} may be {self.tolerance:g} {self.unit}, but {self.best_backend} reaches "
            f"{self.best:.3g}: tighten the tolerance to {FACTOR * self.best:.2g}, or say in looser_because why not"
        )


def loose_tolerances(result: Result) -> list[LooseTolerance]:
    """The loose tolerances of all scenarios of a result, held against the best of its backends."""
    found: list[LooseTolerance] = []
    for info in result.header.scenarios:
        for metric in info.metrics:
            errors = _errors(result, info, metric.name)
            # A metric with a stated reason may be as loose as it says.
            if not errors or metric.looser_because:
                continue
            best, backend = min(errors)
            if metric.tolerance > FACTOR * best:
                found.append(LooseTolerance(info.name, metric.name, metric.unit, metric.tolerance, best, backend))
    return found


def _errors(result: Result, info: ScenarioInfo, metric: str) -> list[tuple[float, str]]:
    """Finite errors at the nominal time step with their backends."""
    found: list[tuple[float, str]] = []
    for backend in result.header.settings.backends:
        for matter in result.matters(info.name):
            record = result.nominal(info, backend, matter)
            error = record.scenario.errors.get(metric, math.nan) if record and record.scenario else math.nan
            if math.isfinite(error):
                found.append((error, f"{matter} on {backend}" if matter else backend))
    return found
