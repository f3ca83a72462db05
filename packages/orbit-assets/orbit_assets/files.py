"""ORBIT's own asset files, and any asset file read by its suffix."""

from __future__ import annotations

from pathlib import Path

from orbit_assets.naming import names_file
from orbit_assets.options import ReadOptions
from orbit_core.interfaces.errors import AssetError, UnknownNameError
from orbit_core.scene import Articulation

_SUFFIXES = (".urdf", ".xacro", ".xml", ".mjcf", ".usd", ".usda", ".usdc", ".usdz", ".sdf")


def asset_folder() -> Path:
    """ORBIT's own asset files: ``assets`` of the checkout, or the copy inside the installed package."""
    installed = Path(__file__).parent / "files"
    return installed if installed.is_dir() else Path(__file__).parents[3] / "assets"


def asset_file(name: str) -> Path:
    """The path of one of ORBIT's own asset files, such as ``"table.usda"``.

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
    """The articulation that a URDF, xacro, MJCF, USD or SDFormat file describes, validated.

    ``merge`` takes fixed joints out, as every scene needs it; a converter keeps them. ``options`` says which files the
    model may open, how large it may be, and what is done with what ORBIT lacks or no body can have.

    Raises:
        AssetError: the file is missing, of another format, malformed, or describes nothing that can be simulated.
    """
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
