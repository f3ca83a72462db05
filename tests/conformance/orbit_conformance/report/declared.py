"""Tables of capabilities that backends declare less than exact and gaps that they declare, with measured errors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from orbit_conformance.results import Result, ScenarioInfo, load
from orbit_conformance.scenario import Metric, Scenario
from orbit_conformance.scenarios import SCENARIOS
from orbit_core.interfaces import Backend, Capability, Gap, Level
from orbit_core.interfaces.matter import NATIVE

_LEVELS = {Level.APPROXIMATE: "approximate", Level.UNSUPPORTED: "**no**"}


def declarations_of(plugins: Sequence[Backend], folder: Path) -> str:
    """Return Markdown on what these backends declare, with the measures of the report in the folder.

    Raises:
        AssetError: the folder holds no report.
    """
    result = load(folder)
    sections = [_about(result, plugins), *(_section(plugin, result) for plugin in plugins)]
    return "\n\n".join(sections) + "\n"


def _about(result: Result, plugins: Sequence[Backend]) -> str:
    """Describe the report, and where declarations or scenarios have changed since it was made."""
    told = {info.name for info in result.header.scenarios}
    versions = (f"{name} {version}" for info in result.header.backends for name, version in info.versions.items())
    used = ", ".join(dict.fromkeys(versions))
    lines = [f"The report is of {result.finished[:10]}: {len(told)} scenarios with {used}."]
    reported = {info.name for info in result.header.backends}
    if absent := [plugin.name for plugin in plugins if plugin.name not in reported]:
        lines.append(f"It has no runs of {', '.join(absent)}: figures in reasons are those of the plugin's authors.")
    if missing := [scenario.name for scenario in SCENARIOS if scenario.name not in told]:
        lines.append(f"Scenarios that are not in it yet: {', '.join(missing)}.")
    if apart := [line for plugin in plugins for line in _apart(plugin, result)]:
        lines.append(f"Measured in it beyond what is declared today: {', '.join(apart)}.")
    return "\n".join(lines)


def _apart(plugin: Backend, result: Result) -> Iterator[str]:
    """Metrics that the report has beyond their tolerance, or beyond the limit of a declared gap."""
    limits = {(gap.scenario, gap.metric): gap.limit for gap in plugin.gaps()}
    for scenario in SCENARIOS:
        for metric in scenario.metrics:
            error = _measured(result, plugin.name, scenario, metric)
            limit = limits.get((scenario.name, metric.name), metric.tolerance)
            if error is not None and not error <= limit:
                yield f"{plugin.name} {scenario.name} {metric.name} ({_number(error)})"


def _measured(result: Result, name: str, scenario: Scenario, metric: Metric) -> float | None:
    """The error at the nominal time step; None if it is not in the report."""
    nominal = result.nominal(ScenarioInfo.of(scenario), name, NATIVE if scenario.of_matter else "")
    return nominal.scenario.errors.get(metric.name) if nominal and nominal.scenario else None


def _section(plugin: Backend, result: Result) -> str:
    capabilities = plugin.capabilities()
    short = [c for c in Capability if capabilities[c].level is not Level.EXACT]
    lines = [
        f"## What {plugin.name} does not do exactly\n",
        "| capability | | why |",
        "|---|---|---|",
        *(f"| {c.value} | {_LEVELS[capabilities[c].level]} | {capabilities[c].reason} |" for c in short),
    ]
    if gaps := [gap for gap in plugin.gaps() if not gap.robots]:
        lines += [
            "\n| scenario | metric | tolerance | measured | declared limit | unit | why |",
            "|---|---|---|---|---|---|---|",
            *(_row(plugin, gap, result) for gap in gaps),
        ]
    if of_robots := [gap for gap in plugin.gaps() if gap.robots]:
        lines += [
            "\n| check | metric | robots | declared limit | why |",
            "|---|---|---|---|---|",
            *(
                f"| {gap.scenario} | {gap.metric} | {', '.join(gap.robots)} | {_number(gap.limit)} | {gap.reason} |"
                for gap in of_robots
            ),
        ]
    return "\n".join(lines)


def _row(plugin: Backend, gap: Gap, result: Result) -> str:
    scenario = next(scenario for scenario in SCENARIOS if scenario.name == gap.scenario)
    metric = scenario.metric(gap.metric)
    error = _measured(result, plugin.name, scenario, metric)
    numbers = (metric.tolerance, math.nan if error is None else error, gap.limit)
    cells = (gap.scenario, gap.metric, *map(_number, numbers), metric.unit or "1", gap.reason)
    return f"| {' | '.join(cells)} |"


def _number(value: float) -> str:
    if math.isnan(value):
        return "–"
    return "diverges" if math.isinf(value) else f"{value:.2g}"
