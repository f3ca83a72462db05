"""ORBIT's own asset files, any asset file read by its suffix, and written files checked by reading them back."""

from __future__ import annotations

import math
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from orbit_assets.options import ReadOptions
from orbit_assets.source_text import names_file
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import AssetError, UnknownNameError
from orbit_core.preparation.validation import link_poses
from orbit_core.scene import Articulation
from orbit_core.scene.articulation import raised_moments

_SUFFIXES = (".urdf", ".xacro", ".xml", ".mjcf", ".usd", ".usda", ".usdc", ".usdz", ".sdf")


def asset_folder() -> Path:
    """Return the folder of ORBIT's own asset files: ``assets`` of the checkout, or the installed copy."""
    installed = Path(__file__).parent / "files"
    return installed if installed.is_dir() else Path(__file__).parents[3] / "assets"


def asset_file(name: str) -> Path:
    """Return the path of one of ORBIT's own asset files, such as ``"table.usda"``.

    Raises:
        UnknownNameError: there is no such file.
    """
    folder = asset_folder()
    path = folder / name
    if not path.is_file():
        known = (str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file())
        raise UnknownNameError("asset file", name, known, f"'{folder}'")
    return path


@names_file
def load_articulation(path: Path | str, *, merge: bool = True, options: ReadOptions = ReadOptions()) -> Articulation:
    """Read the articulation of a URDF, xacro, MJCF, USD or SDFormat file, and validate it.

    Args:
        path: the file.
        merge: remove fixed joints, as every scene needs it; a converter keeps them.
        options: files that the model may open, limits of size, and handling of unsupported elements and bad inertias.

    Raises:
        AssetError: the file is missing, of another format, malformed, or describes nothing that can be simulated.
    """
    # Imports in functions: each reader brings the library of its format, and only one is needed.
    from orbit_core.preparation.merge import merge_fixed_links
    from orbit_core.preparation.validation import validate

    articulation = validate(_read(Path(path), options))
    return merge_fixed_links(articulation) if merge else articulation


def _read(path: Path, options: ReadOptions) -> Articulation:
    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise AssetError(f"'{path}' has no suffix of a known format: give one of {', '.join(_SUFFIXES)}")
    if not path.is_file():
        raise AssetError(f"asset file '{path}' does not exist: correct the path")
    if suffix in (".urdf", ".xacro"):
        from orbit_assets.urdf import read_urdf

        return read_urdf(path, options=options)
    if suffix in (".xml", ".mjcf"):
        from orbit_assets.mjcf import read_mjcf

        return read_mjcf(path, options=options)
    if suffix == ".sdf":
        from orbit_assets.sdf import read_sdf

        return read_sdf(path, options=options)
    from orbit_assets.usd import read_usd

    return read_usd(path, options=options)


# Relative tolerance of masses, and of principal moments by the largest.
_RELATIVE = 1e-3
# Metres by which a centre of mass may be off, per metre from the root where that is more.
_APART = 1e-4


def check_written(articulation: Articulation, path: Path, options: ReadOptions) -> tuple[str, ...]:
    """Read a written file back and compare joints, masses, centres of mass and moments with the articulation's.

    Returns:
        A sentence if the file's format has no reader installed, else nothing.

    Raises:
        AssetError: the file does not read, with the reader's reason, or holds something else; names the file.
    """
    from orbit_assets.mjcf.model import PARSER  # late, as all readers here

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
        # Writers raise moments that no solid has: the same must be done before comparing.
        moments, others = raised_moments(np.linalg.eigvalsh(link.inertia)), np.linalg.eigvalsh(back.inertia)
        if moments[2] > 0 and np.abs(others - moments).max() > _RELATIVE * moments[2]:
            return f"link '{link.name}' has principal moments {others} kg m^2 instead of {moments}"
    return None
