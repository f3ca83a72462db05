"""Whether what a backend declares can be true at all, found before anything runs."""

from __future__ import annotations

from orbit_core.conformance.scenarios import SCENARIOS
from orbit_core.conformance.verdict import lacking
from orbit_core.interfaces import Backend, ConfigurationError, Gap, Level, UnknownNameError


def check_declarations(backend: Backend) -> None:
    """Refuse declared gaps that nothing would ever be held against, and capabilities that they contradict.

    Raises:
        UnknownNameError: a gap names no scenario, or no metric of its scenario; tells the nearest.
        ConfigurationError: two gaps are of one metric, one has no reason, a limit is no more than the tolerance, the
            backend lacks what a gap's scenario needs, or what that scenario measures is declared exact.
    """
    scenarios = {scenario.name: scenario for scenario in SCENARIOS}
    seen: set[tuple[str, str]] = set()
    for gap in backend.gaps():
        where = f"the gaps of backend '{backend.name}'"
        if gap.scenario not in scenarios:
            raise UnknownNameError("scenario", gap.scenario, scenarios, where)
        metrics = {metric.name: metric for metric in scenarios[gap.scenario].metrics}
        if gap.metric not in metrics:
            raise UnknownNameError("metric", gap.metric, metrics, f"{where}, scenario '{gap.scenario}'")
        if (gap.scenario, gap.metric) in seen:
            raise ConfigurationError(f"{where} name metric '{gap.metric}' of '{gap.scenario}' twice: keep one")
        seen.add((gap.scenario, gap.metric))
        _check_limit(gap, metrics[gap.metric].tolerance, where)
        if reason := lacking(backend, scenarios[gap.scenario]):
            raise ConfigurationError(f"{where} name scenario '{gap.scenario}', which does not run on it: {reason}")
        for capability in scenarios[gap.scenario].judges:
            if backend.capabilities()[capability].level is Level.EXACT:
                raise ConfigurationError(
                    f"backend '{backend.name}' declares '{capability.value}' exact, and metric '{gap.metric}' of "
                    f"'{gap.scenario}', which measures that, a gap: declare it approximate, with how it differs"
                )


def _check_limit(gap: Gap, tolerance: float, where: str) -> None:
    what = f"{where}, metric '{gap.metric}' of '{gap.scenario}':"
    if not gap.limit > tolerance:
        raise ConfigurationError(f"{what} the limit must be above the tolerance of {tolerance:g}, not {gap.limit:g}")
    if not gap.reason.strip():
        raise ConfigurationError(f"{what} a gap needs a reason")
