"""Check that a backend's declarations can be true, before anything runs."""

from __future__ import annotations

from orbit_assets.catalogue import robot_info
from orbit_conformance.robots.checks import CHECKS
from orbit_conformance.scenario import Scenario
from orbit_conformance.scenarios import SCENARIOS
from orbit_conformance.verdict import lacking
from orbit_core.interfaces import Backend, ConfigurationError, Gap, Level, UnknownNameError
from orbit_core.interfaces.capabilities import MATTER
from orbit_core.interfaces.matter import MatterSolver


def check_declarations(owner: Backend | MatterSolver) -> None:
    """Reject declared gaps of things that are never measured, and capabilities that gaps contradict.

    A backend's gaps in scenarios of matter concern its native matter; a matter solver's hold on every engine.

    Raises:
        UnknownNameError: a gap names no scenario and no check of robots, no metric of its scenario, or no robot; names
            the nearest.
        ConfigurationError: two gaps are of one metric, or of one of one robot, one has no reason, a limit is no more
            than the tolerance, one of a check names no robot, the owner lacks what a gap's scenario needs, or what that
            scenario measures is declared exact.
    """
    who = f"{'backend' if isinstance(owner, Backend) else 'matter solver'} '{owner.name}'"
    where = f"the gaps of {who}"
    # Gaps name scenarios and checks of robots alike.
    experiments = {experiment.name: experiment for experiment in (*SCENARIOS, *CHECKS)}
    seen: set[tuple[str, str, str]] = set()
    for gap in owner.gaps():
        if gap.scenario not in experiments:
            raise UnknownNameError("scenario", gap.scenario, experiments, where)
        experiment = experiments[gap.scenario]
        metrics = {metric.name: metric for metric in experiment.metrics}
        if gap.metric not in metrics:
            raise UnknownNameError("metric", gap.metric, metrics, f"{where}, scenario '{gap.scenario}'")
        of = {(gap.scenario, gap.metric, robot) for robot in gap.robots or ("",)}
        if of & seen:
            raise ConfigurationError(f"{where} name metric '{gap.metric}' of '{gap.scenario}' twice: keep one")
        seen |= of
        _check_limit(gap, metrics[gap.metric].tolerance, where)
        if not isinstance(experiment, Scenario):
            _check_robots(gap, where)
            continue
        if gap.robots:
            raise ConfigurationError(f"{where} name robots for '{gap.scenario}', which has none of the catalogue's")
        if reason := _not_run(owner, experiment):
            raise ConfigurationError(f"{where} name scenario '{gap.scenario}', which does not run on it: {reason}")
        for capability in experiment.judges:
            if owner.capabilities()[capability].level is Level.EXACT:
                raise ConfigurationError(
                    f"{who} declares '{capability.value}' exact, and metric '{gap.metric}' of '{gap.scenario}', which "
                    "measures that, a gap: declare it approximate, with how it differs"
                )


def _not_run(owner: Backend | MatterSolver, experiment: Scenario) -> str:
    """Return the reason for which the owner of a gap does not run its scenario; empty if it does."""
    if isinstance(owner, Backend):
        return lacking(owner, experiment)
    if not experiment.of_matter:
        return "it has no matter"
    return "; ".join(n.value for n in experiment.needs if n in MATTER and not owner.capabilities().has(n))


def _check_robots(gap: Gap, where: str) -> None:
    if not gap.robots:
        raise ConfigurationError(f"{where} name '{gap.scenario}', a check of robots, and no robot: say of which")
    for robot in gap.robots:
        robot_info(robot)


def _check_limit(gap: Gap, tolerance: float, where: str) -> None:
    what = f"{where}, metric '{gap.metric}' of '{gap.scenario}':"
    if not gap.limit > tolerance:
        raise ConfigurationError(f"{what} the limit must be above the tolerance of {tolerance:g}, not {gap.limit:g}")
    if not gap.reason.strip():
        raise ConfigurationError(f"{what} a gap needs a reason")
