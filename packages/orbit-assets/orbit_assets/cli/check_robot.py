"""``orbit check-robot``: report what a catalogue entry or a composition lacks, and what is implausible in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from rich.table import Table
from rich.text import Text
from tyro.conf import Positional, arg

from orbit_assets.audit.checks import Severity
from orbit_assets.audit.robots.report import JointRow, RobotReport, audit_robot
from orbit_assets.cli.check_asset import findings_table
from orbit_core.cli.output import console, new_table, print_heading, print_line, write_json
from orbit_core.cli.settings import check_output, parse_words
from orbit_core.interfaces.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class CheckRobotSettings:
    """Check a robot of the catalogue, or a composition such as ur10+robotiq_2f85, before its first run: limits,
    armature, gains, home, frames, stance, masses, licence. Exits with 1 where it could not be simulated or used."""

    robot: Annotated[Positional[str], arg(metavar="ROBOT")]
    """The robot's name, or its parts' with plus signs between."""
    time_step: float = 0.005
    """Physics step in seconds at which the gains must be stable."""
    json: Path | None = None
    """Write the findings there."""
    overwrite: bool = False
    """Replace the JSON file."""


def main(words: Sequence[str]) -> int:
    """Audit the robot, print what was found, and say by the exit code whether it has faults."""
    settings = parse_words(CheckRobotSettings, words, "orbit check-robot")
    check_output(settings.json, ".json", settings.overwrite)
    if not 0.0 < settings.time_step < 1.0:
        raise ConfigurationError(f"time_step must be between 0 and 1 s, not {settings.time_step:g}")
    report = audit_robot(settings.robot, settings.time_step)
    write_json(settings.json, values_of(report))
    out = console()
    print_heading(out, report.entry.name, report.entry.description)
    for label, value in _figures(report):
        print_line(out, label, value)
    if report.joints:
        out.print(_joints_table(report.joints))
    out.print(findings_table(report.findings))
    counts = {level: sum(finding.severity is level for finding in report.findings) for level in Severity}
    out.print(", ".join(f"{count} {level.value}{'' if count == 1 else 's'}" for level, count in counts.items()))
    return 1 if report.faults else 0


def values_of(report: RobotReport) -> dict[str, Any]:
    """Return everything in the report, for a JSON file; infinite limits as text, which JSON has no number for."""
    return {
        "robot": report.entry.name,
        "mass": report.spec.articulation.mass,
        "categories": [category.value for category in report.spec.categories],
        "joints": [{key: _plain(value) for key, value in asdict(row).items()} for row in report.joints],
        "hands": [asdict(hand) for hand in report.hands],
        "stance": asdict(report.stance) if report.stance else None,
        "findings": [{**asdict(finding), "severity": finding.severity.value} for finding in report.findings],
    }


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, float) and value in (float("inf"), float("-inf")) else value


def _figures(report: RobotReport) -> list[tuple[str, str]]:
    spec = report.spec
    figures = [
        ("licence", report.entry.licence or "none"),
        ("source", report.entry.source or "none"),
        ("categories", ", ".join(category.value for category in spec.categories) or "none"),
        ("mass", f"{spec.articulation.mass:.4g} kg in {len(spec.articulation.links)} links"),
    ]
    for hand in report.hands:
        opened = (
            "meets nothing along y when open"
            if hand.meets_nothing_open
            else f"opens to {1e3 * hand.opening:.1f} mm along y"
        )
        closed = "nor when closed" if hand.meets_nothing_closed else f"closes to {1e3 * hand.closing:.1f} mm"
        told = f"{opened}, {closed}"
        figures.append((f"gripper at {hand.frame}", told))
    if stance := report.stance:
        told = (
            f"{1e3 * stance.clearance:.1f} mm above the ground, feet level to {1e3 * stance.uneven:.1f} mm, centre of "
            f"mass {1e3 * stance.margin:.0f} mm inside its support"
        )
        figures.append(("stance at home", told))
    return figures


def _joints_table(rows: Sequence[JointRow]) -> Table:
    table = new_table(
        "joint", "effort limit", "velocity limit", "armature", "stiffness", "damping", "Hz", "damping ratio", "load"
    )
    for row in rows:
        numbers = (row.effort_limit, row.velocity_limit, row.armature, row.stiffness, row.damping)
        found = row.response
        response = (
            (f"{found.slowest:.2g}-{found.fastest:.2g}", f"{found.least_damped:.2g}-{found.most_damped:.2g}")
            if found
            else ("", "")
        )
        table.add_row(Text(row.name), *(f"{number:.3g}" for number in numbers), *response, f"{row.load:.3g}")
    return table
