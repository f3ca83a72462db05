"""Units of what the suite measures, which ``orbit info`` shows declared gaps in."""

from __future__ import annotations

from orbit_conformance.robots.checks import CHECKS
from orbit_conformance.scenarios import SCENARIOS


def units() -> dict[tuple[str, str], str]:
    """Return the unit of each metric, by the names of its scenario or check and of the metric."""
    return {(asked.name, metric.name): metric.unit for asked in (*SCENARIOS, *CHECKS) for metric in asked.metrics}
