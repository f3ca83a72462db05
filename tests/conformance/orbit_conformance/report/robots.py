"""Tables of robots by checks, one for each backend, and the gaps that are declared of robots."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from orbit_conformance.jobs import Kind
from orbit_conformance.results import Record, Result
from orbit_conformance.robots.check import ROBOT_GAPS, CheckResult, RobotCheck
from orbit_conformance.robots.checks import CHECKS
from orbit_conformance.verdict import Status
from orbit_core.interfaces import Gap


@dataclass(frozen=True)
class RobotCell:
    """A robot's standing in one check."""

    status: Status | None
    """None where the robot is not put to the check."""
    reason: str
    """Reason for anything but a pass."""
    errors: tuple[tuple[str, str, str], ...]
    """Metric, error and tolerance."""
    figures: tuple[tuple[str, str], ...]
    """Further measured values, name and value."""

    @property
    def style(self) -> str:
        """The style class of the status's colour."""
        return self.status.name.lower() if self.status else "absent"

    @property
    def label(self) -> str:
        """The first error that misses its tolerance, else the first one."""
        return next((error for _, error, _ in self.errors), "")


@dataclass(frozen=True)
class RobotLine:
    """One robot on one backend."""

    name: str
    """Name of the robot."""
    about: str
    """Joints and mass."""
    cells: tuple[RobotCell, ...]
    """Standing in each check, in the page's order."""


@dataclass(frozen=True)
class RobotTable:
    """All robots on one backend."""

    backend: str
    """Name of the backend."""
    lines: tuple[RobotLine, ...]
    """Robots in order."""


@dataclass(frozen=True)
class RobotSection:
    """Everything that the report shows of robots."""

    checks: tuple[RobotCheck, ...]
    """Checks in the order of columns."""
    tables: tuple[RobotTable, ...]
    """One table for each backend."""
    gaps: tuple[tuple[str, Gap], ...]
    """Backend, or "all", and what it declares."""


def robot_section(result: Result) -> RobotSection | None:
    """The tables of a run's robots; None where the run has none."""
    records = result.of(Kind.ROBOT)
    if not records:
        return None
    tables = (
        RobotTable(backend, tuple(_line(record) for record in records if record.job.backend == backend))
        for backend in result.header.settings.backends
    )
    # Gaps of robots that this run left out would look as if they were measured.
    robots = {record.job.name for record in records}
    declared = [(info.name, gap) for info in result.header.backends for gap in info.gaps if robots & {*gap.robots}]
    everywhere = [("all", gap) for gap in ROBOT_GAPS if robots & {*gap.robots}]
    return RobotSection(CHECKS, tuple(tables), (*everywhere, *declared))


def _line(record: Record) -> RobotLine:
    found = record.robot
    if found is None:
        broken = RobotCell(record.status, record.why, (), ())
        return RobotLine(record.job.name, "", (broken,) * len(CHECKS))
    about = f"{found.mass:.3g} kg, {found.joints} joints"
    return RobotLine(
        record.job.name, about, tuple(_cell(check, found.check(check.name), found.spared) for check in CHECKS)
    )


def _cell(check: RobotCheck, found: CheckResult | None, spared: Mapping[str, str]) -> RobotCell:
    if found is None:
        return RobotCell(None, spared.get(check.name, "not run"), (), ())
    errors = sorted(_errors(check, found), key=lambda row: row[0])
    figures = ((words, f"{value:.3g}") for words, value in found.figures.items())
    return RobotCell(found.status, found.reason, tuple(row[1:] for row in errors), tuple(figures))


def _errors(check: RobotCheck, found: CheckResult) -> Iterator[tuple[bool, str, str, str]]:
    """Yield for each metric whether it is within its tolerance, its name, its error and its tolerance."""
    for metric in check.metrics:
        if metric.name in found.errors:
            error = found.errors[metric.name]
            told, allowed = (f"{value:.2g} {metric.unit}".strip() for value in (error, metric.tolerance))
            yield error <= metric.tolerance, metric.name, told, allowed
