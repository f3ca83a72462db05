"""The table of an audit's findings that commands show."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from orbit_assets.audit.findings import Finding, Severity
from orbit_core.cli.output import new_table


def findings_table(findings: Sequence[Finding]) -> Table:
    """Return what an audit found as a table, the gravest first."""
    table = new_table("", "where", "what")
    for level in Severity:
        for finding in findings:
            if finding.severity is level:
                table.add_row(level.value, Text(finding.element), Text(finding.text))
    return table
