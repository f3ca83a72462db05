"""Check of a written file against the articulation that it holds, by reading it back."""

from __future__ import annotations

import math
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from orbit_assets.files import load_articulation
from orbit_assets.mjcf.model import PARSER
from orbit_assets.options import ReadOptions
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.validation import link_poses
from orbit_core.scene import Articulation
from orbit_core.scene.inertias import raised_moments

_RELATIVE = 1e-3
"""Tolerance of masses, and of principal moments by the largest."""
_APART = 1e-4
"""Metres by which a centre of mass may be off, per metre from the root where that is more."""


def check_written(articulation: Articulation, path: Path, options: ReadOptions) -> tuple[str, ...]:
    """Read a written file back and compare joints, masses, centres of mass and moments with the articulation's.

    Returns:
        A sentence if the file's format has no reader installed, else nothing.

    Raises:
        AssetError: the file does not read, with the reader's reason, or holds something else; names the file.
    """
    if path.suffix.lower() in (".xml", ".mjcf") and find_spec(PARSER) is None:
        return (f"{path} is not read back, which needs the package {PARSER}: {install_extra('mjcf')}",)
    try:
        got = load_articulation(path, merge=False, options=options)
    except AssetError as error:
        raise AssetError(f"'{path}' was written but cannot be read: {error}") from None
    if problem := _difference(articulation, got):
        raise AssetError(
            f"'{path}' was written but holds something else: {problem}; report it as a fault of the writer"
        )
    return ()


def _difference(asked: Articulation, got: Articulation) -> str | None:
    if odd := set(asked.joint_names) ^ set(got.joint_names):
        return f"joints {', '.join(sorted(odd))} are not in both"
    if not math.isclose(asked.mass, got.mass, rel_tol=_RELATIVE, abs_tol=1e-12):
        return f"its mass is {got.mass:.6g} kg instead of {asked.mass:.6g}"
    links = {link.name: link for link in got.links}
    asked_poses, got_poses = link_poses(asked, {}), link_poses(got, {})
    for link in asked.links:
        back = links.get(link.name)
        if back is None or link.mass <= 0:
            continue
        if not math.isclose(back.mass, link.mass, rel_tol=_RELATIVE):
            return f"link '{link.name}' weighs {back.mass:.6g} kg instead of {link.mass:.6g}"
        here = asked_poses[link.name].transform(link.center_of_mass)
        off = float(np.linalg.norm(got_poses[link.name].transform(back.center_of_mass) - here))
        if off > _APART * max(1.0, float(np.linalg.norm(here))):
            return f"the centre of mass of link '{link.name}' is {off:.3g} m off"
        moments, others = raised_moments(np.linalg.eigvalsh(link.inertia)), np.linalg.eigvalsh(back.inertia)
        if moments[2] > 0 and np.abs(others - moments).max() > _RELATIVE * moments[2]:
            return f"link '{link.name}' has principal moments {others} kg m^2 instead of {moments}"
    return None
