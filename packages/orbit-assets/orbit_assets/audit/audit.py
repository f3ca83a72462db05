"""Audit of an asset file: read, measured, checked, and compared with other readers of its format."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from orbit_assets.audit.checks import Body, Finding, Severity, check_body, check_joints, check_touching, measure_body
from orbit_assets.audit.mjcf_reference import MujocoReference
from orbit_assets.audit.reference import Comparison, PinocchioReference, Reference, compare, pinocchio_installed
from orbit_assets.files import load_articulation
from orbit_assets.options import ReadOptions, Repair
from orbit_core.files import as_path
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation

MASS_TOLERANCE = 1e-9
"""kg between a link's mass here and in another reader."""
KINEMATICS_TOLERANCE = 1e-6
"""m, or of a rotation matrix, between poses of links."""
INERTIA_TOLERANCE = 1e-5
"""Of a mass matrix's entry, relative."""


@dataclass(frozen=True, eq=False)
class AssetReport:
    """Result of an audit. The description is without fixed joints, as every world simulates it."""

    path: Path
    """File that was audited."""
    articulation: Articulation
    """Description that was read from it."""
    bodies: tuple[Body, ...]
    """Mass properties and sizes of the links."""
    findings: tuple[Finding, ...]
    """Faults, warnings and notes."""
    comparison: Comparison | None
    """With another reader of the format; ``None`` where none is installed or it refuses the file."""

    @property
    def faults(self) -> tuple[Finding, ...]:
        """Findings that would make a simulation wrong."""
        return tuple(finding for finding in self.findings if finding.severity is Severity.FAULT)


def audit_file(path: Path | str, options: ReadOptions = ReadOptions()) -> AssetReport:
    """Read a URDF, MJCF or USD file and check what was read.

    Raises:
        AssetError: the file cannot be read.
    """
    path = as_path(path)
    # Masses are compared on the merged description: other readers merge fixed joints too.
    articulation = merge_fixed_links(load_articulation(path, merge=False, options=options))
    # Measured on the merged links, which engines simulate.
    bodies = tuple(measure_body(link) for link in articulation.links)
    findings = [
        *(found for link, body in zip(articulation.links, bodies, strict=True) for found in check_body(link, body)),
        *check_joints(articulation),
        *check_touching(articulation),
        *(Finding(Severity.NOTE, "model", note) for note in articulation.notes),
    ]
    comparison: Comparison | None = None
    try:
        if (reference := reference_of(path, articulation.root.name, options)) is not None:
            comparison = compare(articulation, reference)
            findings += _differences(comparison, repaired=options.repair is not Repair.NONE)
    # A reader that refuses the file is no fault of the description: the rest of the report stands.
    except AssetError as error:
        findings.append(Finding(Severity.NOTE, "model", f"not compared: {error}"))
    return AssetReport(path, articulation, bodies, tuple(findings), comparison)


def reference_of(path: Path, root: str, options: ReadOptions = ReadOptions()) -> Reference | None:
    """Return another reader's model of the file; None for formats that no other reader knows.

    Args:
        path: a URDF, which Pinocchio reads where it is installed; the reader of MJCF files reads MJCF, and else URDF.
        root: the description's root link.
        options: those that the description was read with.

    Raises:
        AssetError: the other reader refuses the file.
    """
    suffix = path.suffix.lower()
    if suffix == ".urdf" and pinocchio_installed():
        return PinocchioReference(path, options)
    if suffix in (".xml", ".mjcf", ".urdf"):
        return MujocoReference(path, root, options)
    return None


def _differences(comparison: Comparison, repaired: bool) -> Iterator[Finding]:
    """Yield the differences beyond tolerance. Inertias that were repaired differ from the file's, as they should."""
    figures = (
        ("a link's mass", comparison.mass, MASS_TOLERANCE, "kg", Severity.FAULT),
        ("a link's position", comparison.kinematics, KINEMATICS_TOLERANCE, "m", Severity.FAULT),
        ("a link's orientation", comparison.rotation, KINEMATICS_TOLERANCE, "of its matrix", Severity.FAULT),
        (
            "the mass matrix",
            comparison.mass_matrix,
            INERTIA_TOLERANCE,
            "relative",
            Severity.NOTE if repaired else Severity.FAULT,
        ),
    )
    # Written as a negation so that NaN, which compares as False, is reported too.
    for what, value, tolerance, unit, severity in figures:
        if not value <= tolerance:
            text = f"{what} differs from what {comparison.reader} reads by {value:.3g} {unit}"
            yield Finding(severity, "model", text)
