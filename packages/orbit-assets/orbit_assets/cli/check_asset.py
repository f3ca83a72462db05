"""``orbit check-asset``: report what is wrong, missing or changed in a robot's or an object's file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from rich.table import Table
from rich.text import Text
from tyro.conf import Positional, arg

from orbit_assets.audit.audit import AssetReport, audit_file
from orbit_assets.audit.checks import Body, Finding, Severity
from orbit_assets.cli.reading import ReadSettings, remedies_in_flags
from orbit_core.cli.output import console, new_table, write_json
from orbit_core.cli.settings import check_output, parse_words


def findings_table(findings: Sequence[Finding]) -> Table:
    """Build a table of an audit's findings, the gravest first."""
    table = new_table("", "where", "what")
    for level in Severity:
        for finding in findings:
            if finding.severity is level:
                table.add_row(level.value, Text(finding.element), Text(finding.text))
    return table


@dataclass(frozen=True, kw_only=True)
class CheckAssetSettings(ReadSettings):
    """Check a URDF, MJCF or USD file: masses, inertias, limits and shapes, and what the reader changed. Exits with 1
    where the simulation would be wrong."""

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """The file."""
    json: Path | None = None
    """Write the findings there."""
    overwrite: bool = False
    """Replace the JSON file."""


def main(words: Sequence[str]) -> int:
    """Audit the file, print what was found, and say by the exit code whether it has faults."""
    settings = parse_words(CheckAssetSettings, words, "orbit check-asset")
    check_output(settings.json, ".json", settings.overwrite)
    with remedies_in_flags():
        report = audit_file(settings.file, settings.options())
    write_json(settings.json, values_of(report))
    out = console()
    body = report.articulation
    out.print(Text.assemble((str(settings.file), "bold"), f": {body.name}, {body.mass:.6g} kg"))
    out.print(_bodies_table(report.bodies))
    out.print(findings_table(report.findings))
    out.print(_compared(report))
    counts = {level: sum(finding.severity is level for finding in report.findings) for level in Severity}
    out.print(", ".join(f"{count} {level.value}{'' if count == 1 else 's'}" for level, count in counts.items()))
    return 1 if report.faults else 0


def values_of(report: AssetReport) -> dict[str, Any]:
    """Return everything in the report, for a JSON file."""
    return {
        "file": str(report.path),
        "name": report.articulation.name,
        "mass": report.articulation.mass,
        "links": [asdict(body) for body in report.bodies],
        "joints": list(report.articulation.joint_names),
        "findings": [{**asdict(finding), "severity": finding.severity.value} for finding in report.findings],
        "comparison": asdict(report.comparison) if report.comparison else None,
    }


def _bodies_table(bodies: Sequence[Body]) -> Table:
    table = new_table("link", "mass (kg)", "principal moments (kg m²)", "size (m)", "kg/m³", "colliding / seen (m³)")
    for body in bodies:
        size = " x ".join(f"{length:.3g}" for length in body.size) if body.size else "no shape"
        moments = ", ".join(f"{moment:.3g}" for moment in body.moments)
        volumes = f"{body.collision_volume:.3g} / {body.visual_volume:.3g}"
        density = f"{body.density:.0f}" if body.density is not None else ""
        table.add_row(body.name, f"{body.mass:.4g}", moments, size, density, volumes)
    return table


def _compared(report: AssetReport) -> str:
    found = report.comparison
    if found is None:
        return "not compared with another reader"
    return (
        f"against {found.reader}, over {found.links} links and {found.joints} joints: "
        f"masses within {found.mass:.1e} kg, kinematics within {found.kinematics:.1e} m, "
        f"mass matrices within {found.mass_matrix:.1e}"
    )
