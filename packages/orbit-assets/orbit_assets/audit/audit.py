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
    """What an audit found. The description is without fixed joints, as every world simulates it."""

    path: Path
    articulation: Articulation
    bodies: tuple[Body, ...]
    findings: tuple[Finding, ...]
    comparison: Comparison | None
    """With another reader of the format; ``None`` where none is installed or it refuses the file."""

    @property
    def faults(self) -> tuple[Finding, ...]:
        """Those findings that would make a simulation wrong."""
        return tuple(finding for finding in self.findings if finding.severity is Severity.FAULT)


def audit_file(path: Path | str, options: ReadOptions = ReadOptions()) -> AssetReport:
    """Read a URDF, MJCF or USD file and check what was read.

    Raises:
        AssetError: the file cannot be read.
    """
    path = as_path(path)
    articulation = merge_fixed_links(load_articulation(path, merge=False, options=options))
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
    except AssetError as error:
        findings.append(Finding(Severity.NOTE, "model", f"not compared: {error}"))
    return AssetReport(path, articulation, bodies, tuple(findings), comparison)


def reference_of(path: Path, root: str, options: ReadOptions = ReadOptions()) -> Reference | None:
    """Another reader's model of the file, of an MJCF or a URDF; Pinocchio's of a URDF where it is installed.

    ``None`` for other formats. ``root`` names the description's root link, and ``options`` are those it was read with.

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
    """Inertias that were mended differ from the file's, as they should."""
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
    for what, value, tolerance, unit, severity in figures:
        if not value <= tolerance:
            text = f"{what} differs from what {comparison.reader} reads by {value:.3g} {unit}"
            yield Finding(severity, "model", text)
